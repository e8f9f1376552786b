"""Small benches for the tests of the virtual bench, with instruments of their own, served in a thread."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from pathlib import Path

import serial

from rig.bench.bench import bench_of
from rig.virtual.launch import PORTS, ask
from rig.virtual.serve import VirtualServer

KELLER = """
format = "instrument/1"
family = "keller_30x"
title = "transmitter"
source = "test"
trust = "simulated"
[channels.pressure_bar_abs]
unit = "bar"
noise_sd = 0.0001
[channels.temperature_c]
unit = "degC"
"""
ADAM = """
format = "instrument/1"
family = "adam_4024"
title = "outputs"
source = "test"
trust = "simulated"
[channels.setpoint_bar_gauge]
unit = "bar"
[[ranges]]
code = 0x31
name = "4-20 mA"
low_counts = 0
high_counts = 4000
"""
FLOW = """
format = "instrument/1"
family = "modbus"
title = "flow meter"
source = "test"
trust = "simulated"
[channels.flow_sl_min]
unit = "SL/min"
address = 58
type = "u32"
scale = 0.001
[channels.flow_sl_min.reference]
kind = "standard_volume"
pressure_bar_abs = 1.01325
temperature_c = 0.0
[channels.pressure_bar_gauge]
unit = "bar"
address = 62
type = "f32"
word_order = "little"
"""
EDGES = """
format = "instrument/1"
family = "edge_counter"
title = "edges"
source = "test"
trust = "simulated"
teeth = 20
[channels.speed_rpm]
unit = "rpm"
"""
ALICAT = """
format = "instrument/1"
family = "alicat"
title = "controller"
source = "test"
trust = "simulated"
layout = ["pressure_bar_gauge", "setpoint"]
[channels.pressure_bar_gauge]
unit = "bar"
scale = 0.0689476
resolution = 0.0007
[setpoint]
unit = "bar gauge"
lowest = 0.0
highest = 3.0
tolerance = 0.001
scale = 0.0689476
"""
LUTRON = """
format = "instrument/1"
family = "lutron"
title = "tachometer"
source = "test"
trust = "simulated"
update_s = 0.5
[channels.speed_rpm]
unit = "rpm"
display = "1"
unit_codes = ["19"]
resolution = 0.1
"""
TEXT = """
format = "instrument/1"
family = "ascii"
title = "tachometer"
source = "test"
trust = "simulated"
query = "@D0\\r"
terminator = "\\r\\n"
pattern = '(?P<speed_rpm>[+-]?\\d+\\.\\d) RPM'
identity_query = "@PI\\r"
identity_pattern = 'ACT-3X (?P<serial>\\w+)'
[channels.speed_rpm]
unit = "rpm"
resolution = 0.1
"""
INSTRUMENTS = {
    "gauge": KELLER,
    "outputs": ADAM,
    "flow": FLOW,
    "edges": EDGES,
    "alicat": ALICAT,
    "lutron": LUTRON,
    "text": TEXT,
}
ROLES = """[roles]
pressure = "{pressure}"
flow = "flowmeter.flow_sl_min"
speed = "tach.speed_rpm"
[sweep]
levels_bar_abs = [2.0]
[lines.net]
kind = "tcp"
host = "virtual"
[devices.flowmeter]
instrument = "flow"
line = "net"
unit_id = 1
"""
HEAD = f"""
format = "bench/1"
title = "test"
[ambient]
pressure_bar_abs = 1.01325
temperature_c = 20.0
relative_humidity = 0.5
{ROLES}"""
MODBUS = (
    HEAD.format(pressure="gauge.pressure_bar_abs")
    + """
[lines.bus]
kind = "serial"
port = "virtual"
baud = 19200
paced = {paced}
[lines.usb]
kind = "serial"
port = "virtual"
paced = false
[devices.gauge]
instrument = "gauge"
line = "bus"
unit_id = 1
[devices.dac]
instrument = "outputs"
line = "bus"
unit_id = 2
channel = 0
span = [0.0, 5.0]
[devices.tach]
instrument = "edges"
line = "usb"
[virtual]
"""
)
WORDS = (
    HEAD.format(pressure="controller.pressure_bar_gauge")
    + """
[lines.bus]
kind = "serial"
port = "virtual"
baud = 19200
[lines.meter]
kind = "serial"
port = "virtual"
baud = 9600
[lines.words]
kind = "serial"
port = "virtual"
paced = false
[devices.controller]
instrument = "alicat"
line = "bus"
address = "B"
[devices.tach]
instrument = "lutron"
line = "meter"
[devices.words]
instrument = "text"
line = "words"
[virtual]
"""
)


def bench(text, more="", paced=True):
    """A bench of `MODBUS` or `WORDS`, with more of its [virtual] table."""
    sources = {f"instruments/{name}.toml": source.encode() for name, source in INSTRUMENTS.items()}
    whole = text.replace("{paced}", str(paced).lower()) + more
    return bench_of("test", {"bench.toml": whole.encode(), **sources}, "test.toml")


class Served:
    """A bench being served in a thread."""

    def __init__(self, server, ports):
        self.server, self.ports = server, ports
        self.clock = server.clock

    def ask(self, **request):
        return ask(self.ports, request)

    def serial(self, line, timeout=1.0, baud=19200):
        return serial.Serial(self.ports["lines"][line]["port"], baud, timeout=timeout)

    def socket(self, line, timeout=1.0):
        place = self.ports["lines"][line]
        return socket.create_connection((place["host"], place["tcp_port"]), timeout=timeout)

    def wait_until(self, done, real_s=60.0):
        """Ask for the state until something is true of it."""
        give_up = time.monotonic() + real_s
        while time.monotonic() < give_up:
            state = self.ask(do="state")
            if done(state):
                return state
            time.sleep(0.02)
        raise AssertionError(f"not within {real_s} s: { ({k: v for k, v in state.items() if k != 'history'}) }")


@contextlib.contextmanager
def serving(found, folder: Path, rate=20.0, seed=1, plant_of=None):
    """Serve a bench until the block ends."""
    server = VirtualServer(found, folder, rate, seed, plant_of)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    give_up = time.monotonic() + 60.0
    while not (folder / PORTS).exists():
        assert thread.is_alive() and time.monotonic() < give_up
        time.sleep(0.005)
    try:
        yield Served(server, server.ports())
    finally:
        server.loop.stop()
        thread.join(10.0)
    assert not thread.is_alive()


def everything(file, quiet_s=0.4, first_s=None):
    """What a line sends until it is quiet for some real time; the first byte may take longer."""
    data = b""
    while select.select([file], [], [], quiet_s if data or first_s is None else first_s)[0]:
        came = os.read(file.fileno(), 4096)
        if not came:
            break
        data += came
    return data
