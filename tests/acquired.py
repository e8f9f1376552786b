"""Acquisitions of a bench that is served, with a sink that keeps everything in memory."""

from __future__ import annotations

import contextlib
import functools

from rig.acquisition import Acquisition
from rig.virtual.launch import port_for
from tests.waiting import wait_for


class Kept:
    """A sink that keeps everything in memory."""

    def __init__(self):
        self.exchanges, self.events = [], []

    def exchange(self, exchange):
        self.exchanges.append(exchange)

    def event(self, kind, time_ns, **details):
        self.events.append((kind, details))

    def readings(self, name):
        return [reading for exchange in self.exchanges for reading in exchange.readings if reading.name == name]

    def good(self, name, count):
        """The values of a channel, once so many came."""

        def values():
            found = [one.value for one in self.readings(name) if one.good]
            return found if len(found) >= count else None

        return wait_for(values)


def ports_of(served):
    """The ports of a bench that is served."""
    return functools.partial(port_for, served.ports)


@contextlib.contextmanager
def acquisitions():
    """Gives what starts the acquisition of a bench that is served; in the end all are stopped."""
    started = []

    def start(served, found, **options):
        sink = Kept()
        acquisition = Acquisition(found, served.clock, ports_of(served), **options)
        started.append(acquisition)
        acquisition.connect()
        acquisition.begin(sink)
        return acquisition, sink

    yield start
    for acquisition in started:
        acquisition.stop()
