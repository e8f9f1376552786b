"""Whether a bench can resolve a run in time: the event's duration from the model, the samples that would fall in it.

A coast-down takes a tenth of a second or two. A display that is read five times a second shows nothing of it, and a
toothed wheel passes only so many teeth in half a turn. Better told before than found in the record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from configs.units import BAR, ZERO_C
from model.motor import Motor, read_motor
from model.operation import runs
from model.operation.performance import NotSettledError, OperatingPointError
from rig.bench.bench import Bench
from rig.bench.instrument import EdgeReader
from rig.plateaus.plan import SweepError
from rig.recording import DOWN_TO, LEAST_IN_A_RUN, UP_TO
from rig.sweep.ambient import Ambient
from rig.sweep.capturing import CaptureTask

FIRST_LOOK_S, LONGEST_LOOK_S = 1.0, 64.0
SAMPLE_S = 1e-3
CAPTURE_KINDS = ("coast-down", "spin-up", "zero", "plateaus")


class CaptureError(SweepError):
    """A run in time that the bench cannot resolve, or the motor not make. The text says what would do."""


@dataclass(frozen=True)
class Expected:
    """A run in time, by the model.

    `duration_s`: from the valve's move to 10 % of the speed before, or to 90 % of the speed it reaches [s].
    `speed_rpm`: the speed before, or that it reaches [rpm].
    """

    kind: str
    level_bar_abs: float
    duration_s: float
    speed_rpm: float
    turns: float


@dataclass(frozen=True)
class Rate:
    """How often the speed channel gives a new value.

    `update_s`: the instrument's own [s]; 0 where it has none.
    `teeth`: of the wheel, where each tooth is timed [-].
    """

    channel: str
    period_s: float
    update_s: float
    teeth: int | None = None

    def samples(self, expected: Expected) -> int:
        """How many would fall in the event [-]."""
        if self.teeth is not None:
            return math.floor(expected.turns * self.teeth)
        return math.floor(expected.duration_s / max(self.period_s, self.update_s))


def expected(motor: Motor, kind: str, level_bar_abs: float) -> Expected:
    """What the model says of a run in time.

    `level_bar_abs`: absolute pressure before or after [bar].
    Raises CaptureError when the motor does not start or run at that pressure, or the model does not reach it.
    """
    down = kind == "coast-down"
    length_s = FIRST_LOOK_S
    while length_s <= LONGEST_LOOK_S:
        try:
            run = (runs.coast_down if down else runs.spin_up)(motor, level_bar_abs * BAR, length_s, SAMPLE_S)
        except (OperatingPointError, NotSettledError) as error:
            raise CaptureError(f"{kind}: {error}") from error
        after = run.time_s >= 0.0
        time_s, speed, angle = run.time_s[after], run.speed_rad_s[after], run.angle_rad[after]
        reached = float(speed[0]) if down else float(np.mean(speed[-speed.size // 5 :]))
        there = speed <= DOWN_TO * reached if down else speed >= UP_TO * reached
        over = int(np.argmax(there))
        # a spin-up counts as seen only where the speed stands for most of the run
        if reached > 0.0 and bool(there.any()) and (down or time_s[over] < 0.5 * length_s):
            turns = float(angle[over] - angle[0]) / (2.0 * math.pi)
            return Expected(kind, level_bar_abs, float(time_s[over]), reached * 30.0 / math.pi, turns)
        length_s *= 2.0
    why = "the motor does not start there; take a higher level"
    if reached > 0.0:
        why = f"it takes more than {LONGEST_LOOK_S / 2:g} s by the model; is the inertia in the motor's file right?"
    raise CaptureError(f"{kind} at {level_bar_abs:g} bar abs: {why}")


def rate_of(bench: Bench) -> Rate:
    """How often the speed channel of a bench gives a value."""
    name = bench.file.roles.speed
    device = name.partition(".")[0]
    settings, driver = bench.instruments[device], bench.build(device)
    teeth = getattr(settings, "teeth", None) if isinstance(driver, EdgeReader) else None
    return Rate(name, bench.file.devices[device].period_s, settings.update_s, teeth)


def check(expected: Expected, rate: Rate) -> int:
    """How many samples would fall in the event.

    They are at least 20 [-]. Raises CaptureError when there would be fewer; the text says what would do.
    """
    count = rate.samples(expected)
    if count >= LEAST_IN_A_RUN:
        return count
    down = expected.kind == "coast-down"
    speeds = f"{expected.speed_rpm:.0f} rpm to {DOWN_TO:.0%}" if down else f"rest to {UP_TO:.0%} of its speed"
    raise CaptureError(
        f"{expected.kind} at {expected.level_bar_abs:g} bar abs: from {speeds} takes {expected.duration_s:.2g} s and "
        f"{expected.turns:.2g} turns by the model; {_resolution(rate)}, so that {count} samples would fall in it, and "
        f"{LEAST_IN_A_RUN} are needed. {_remedy(expected, rate)}"
    )


def capture_task(bench: Bench, ambient: Ambient, kind: str, level_bar_abs: float | None = None) -> CaptureTask:
    """A capture that the bench can resolve.

    `level_bar_abs`: absolute pressure [bar]; the bench file's when left out.
    Raises CaptureError when fewer than 20 samples would fall in it.
    """
    level = level_of(bench) if level_bar_abs is None else level_bar_abs
    event = expected(motor_of(bench, ambient), kind, level)
    check(event, rate_of(bench))
    return CaptureTask(kind, level, event.duration_s)


def level_of(bench: Bench) -> float:
    """The level that captures start from or end at [bar abs]."""
    table = bench.file.sweep
    return table.capture_level_bar_abs or max(table.levels_bar_abs)


def motor_of(bench: Bench, ambient: Ambient) -> Motor:
    """The bench's motor in the room as it is."""
    values = {
        "ambient_pressure": ambient.pressure_bar_abs * BAR,
        "ambient_temperature": ambient.temperature_c + ZERO_C,
        "inlet_temperature": ambient.temperature_c + ZERO_C,
        "relative_humidity": ambient.relative_humidity,
    }
    return read_motor(bench.motor).with_values(values).with_flywheel(bench.file.added_inertia_kg_m2)


def _resolution(rate: Rate) -> str:
    if rate.teeth is not None:
        return f"{rate.channel} times {rate.teeth} teeth a turn"
    if rate.update_s > rate.period_s:
        return f"{rate.channel} has a new value every {rate.update_s:g} s"
    return f"{rate.channel} is read every {rate.period_s:g} s"


def _remedy(expected: Expected, rate: Rate) -> str:
    """What would do: more teeth, a shorter period, or another instrument."""
    teeth = math.ceil(LEAST_IN_A_RUN / expected.turns)
    if rate.teeth is not None:
        return f"What would do: a wheel with {teeth} teeth or more, or a higher level"
    period_s = math.floor(1e4 * expected.duration_s / LEAST_IN_A_RUN) / 1e4
    counter = f"an edge counter on a wheel with {teeth} teeth or more"
    if rate.update_s > period_s:
        return f"What would do: {counter}; this instrument's own update of {rate.update_s:g} s is too slow"
    return f"What would do: period_s of {period_s:g} or less, if its line bears it, or {counter}"
