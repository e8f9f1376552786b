"""A bench for the tests of the sweep: two first-order lags, and an acquisition of them without threads or bytes."""

import math
from types import SimpleNamespace

import numpy as np

from rig.acquisition import Window
from rig.bench.bench import BenchFile
from rig.lines import LostError
from rig.readings import NS, Event, Exchange, Quality, Reading

AMBIENT = 1.013
ROLES = {"gauge.pressure_bar_abs": "pressure", "tach.speed_rpm": "speed", "meter.flow_l_min": "flow"}


class Lab:
    """Pressure follows the set-point within 0.3 s, speed the pressure within 0.1 s; read ten times a second."""

    def __init__(self):
        self.now_ns = 0
        self.stops, self.answer, self.set_ns, self.set_unsure = 0, None, None, ""
        self.set_bar = AMBIENT
        self.pressure, self.speed = AMBIENT, 0.0
        self.tau_pressure_s = 0.3
        self.noise = np.random.default_rng(4)
        self.scatter_rpm = 0.4
        self.drift_rpm_s = 0.0
        self.offset_bar = 0.0
        self.dead = set()
        self.readings = {"pressure": [], "speed": [], "flow": []}

    def step(self, seconds=0.05):
        self.now_ns += round(seconds * NS)
        self.pressure += (self.set_bar - self.pressure) * (1.0 - math.exp(-seconds / self.tau_pressure_s))
        target = max(0.0, 412.0 * (self.pressure - 1.04))
        self.speed += (target - self.speed) * (1.0 - math.exp(-seconds / 0.1))
        if self.now_ns % (NS // 10) == 0:
            self.read("pressure", "gauge.pressure_bar_abs", self.pressure + self.offset_bar, 0.001)
            self.read("speed", "tach.speed_rpm", self.speed and self.speed + self.drift(), self.scatter_rpm)
            self.read("flow", "meter.flow_l_min", 0.17 * self.speed, 0.2)

    def drift(self):
        return self.drift_rpm_s * self.now_ns / NS

    def read(self, role, name, value, scatter):
        device, _, channel = name.partition(".")
        standing = role == "speed" and value < 0.5
        shown = 0.0 if standing else float(value + scatter * self.noise.normal())
        quality, shown = (Quality.TIMEOUT, None) if role in self.dead else (Quality.OK, shown)
        t = self.now_ns
        self.readings[role].append(
            Reading(device, channel, shown, "", quality, t, t, t, censored=-int(standing and shown is not None))
        )

    def window(self, channel, start_ns, end_ns):
        role = ROLES.get(channel, channel)
        chosen = [r for r in self.readings[role] if r.usable and start_ns <= r.time_ns <= end_ns]
        return Window(
            np.array([r.time_ns / NS for r in chosen]),
            np.array([r.value for r in chosen], dtype=float),
            [r.quality for r in chosen],
            np.array([r.censored for r in chosen], dtype=int),
        )

    def last(self, channel):
        kept = self.readings[ROLES.get(channel, channel)]
        return kept[-1] if kept else None

    def since(self, channel, after_ns):
        return [reading for reading in self.readings[ROLES.get(channel, channel)] if reading.reply_ns > after_ns]


def bench_file(regulator=True, **sweep):
    """A bench file of three instruments and, where one is wanted, a regulator."""
    names = {"gauge": "a gauge", "tach": "a tach", "meter": "a meter"} | ({"dac": "a dac"} if regulator else {})
    roles = {"pressure": "gauge.pressure_bar_abs", "flow": "meter.flow_l_min", "speed": "tach.speed_rpm"}
    return BenchFile.model_validate(
        {
            "format": "bench/1",
            "title": "two lags",
            "ambient": {"pressure_bar_abs": AMBIENT, "temperature_c": 20.0, "relative_humidity": 0.5},
            "lubrication": "none",
            "lines": {"bus": {"kind": "tcp", "host": "nowhere"}},
            "devices": {name: {"instrument": title, "line": "bus"} for name, title in names.items()},
            "roles": roles | ({"regulator": "dac"} if regulator else {}),
            "safety": {"highest_pressure_bar_abs": 3.0},
            "sweep": {"levels_bar_abs": [1.3, 1.6], "order": "up", "dwell_s": 4.0, "zero_s": 2.0} | sweep,
        }
    )


def unused(*_):
    """What the lab does by itself."""
    raise AssertionError


def driver(**more):
    """A device that has the face of one."""
    return SimpleNamespace(device="", failing=False, open=unused, identify=unused, poll=unused, **more)


class LabBench:
    """The bench of a lab, as far as the sweep looks at it."""

    def __init__(self, teeth=None, update_s=0.0, unit="bar gauge", **more):
        self.name, self.file = "lags", bench_file(**more)
        self.motor = self.file.motor
        self.instruments = {
            name: SimpleNamespace(update_s=update_s if name == "tach" else 0.0, teeth=teeth)
            for name in self.file.devices
        }
        self.drivers = {
            "gauge": driver(channels={"pressure_bar_abs": None}),
            "tach": driver(channels={"speed_rpm": None}, **({"poll_edges": unused} if teeth else {})),
            "meter": driver(channels={"flow_l_min": None}),
            "dac": driver(channels={}, write=unused, set_failsafe=unused, unit=unit, lowest=0.0, highest=5.0),
        }

    def build(self, device):
        return self.drivers[device]

    regulator = build


class LabClock:
    """A clock that only goes on while somebody sleeps, and takes the lab along."""

    rate = 1.0

    def __init__(self, lab):
        self.lab = lab

    def now_ns(self):
        return self.lab.now_ns

    def sleep(self, seconds):
        for _ in range(max(1, round(seconds / 0.05))):
            self.lab.step()


class LabAcquisition:
    """What the runner needs of an acquisition; everything that it was told is kept."""

    def __init__(self, bench):
        self.bench, self.lab = bench, Lab()
        self.clock = LabClock(self.lab)
        self.commands, self.events, self.plateaus = [], [], []
        self.orders = []  # when set-points were written [s], and which
        self.dead_regulator = False
        self.unheard = 0  # how many set-points are taken, and the reply is lost
        self.answer_s = 0.0  # how long the regulator takes to answer
        self.busy_s = 0.0  # for so long another device holds the line before a set-point goes over it
        self.before = {}  # a function of this, called once at the event of that name

    def command(self, device, action, argument=None, wait_s=5.0, take_back=True):
        self.commands.append((device, action, argument))
        if action == "write":
            self.orders.append((self.lab.now_ns / NS, argument))
            if self.dead_regulator:
                raise LostError("line bus: nothing within 0.3 s")
            if self.busy_s:
                self.clock.sleep(self.busy_s)
            self.lab.set_bar = AMBIENT + argument
            if self.unheard:
                self.unheard -= 1
                self.clock.sleep(0.3)
                raise LostError("line bus: nothing within 0.3 s")
        asked = Event("tx", self.lab.now_ns)
        if action == "write" and self.answer_s:
            self.clock.sleep(self.answer_s)
        return Exchange("bus", device, action, argument, (asked, Event("rx", self.lab.now_ns)))

    def hurry(self, device):
        self.commands.append((device, "hurry", None))

    def relax(self, device):
        self.commands.append((device, "relax", None))

    def between(self, channel, start_ns, end_ns):
        return self.lab.window(channel, start_ns, end_ns)

    def last(self, channel):
        return self.lab.last(channel)

    def since(self, channel, after_ns):
        return self.lab.since(channel, after_ns)

    def event(self, kind, time_ns=None, **details):
        self.events.append((kind, details))
        name = details.get("state", kind)
        if name in self.before:
            self.before.pop(name)(self)

    def plateau(self, row):
        self.plateaus.append(row)

    @property
    def writes(self):
        return [argument for _, action, argument in self.commands if action == "write"]
