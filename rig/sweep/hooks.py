"""Who else has a part in a sweep: the guard, the limits, the operator, and whoever watches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from configs.units import BAR, RAD_S
from rig.bench.bench import Bench
from rig.interlock import SafetyError
from rig.interlock.guard import HIGHEST_PA, Guard
from rig.interlock.step import Point, Verdict
from rig.plateaus.plateau import Plateau
from rig.sweep.ambient import Ambient
from rig.sweep.capture import motor_of
from rig.sweep.orders import Doubt, Predict, Trip

DEFAULT_GAUGE_SD_BAR = 0.02  # of a gauge whose file does not say


class Progress(Protocol):
    """Where a run tells how far it is."""

    def say(self, text: str, warning: bool = False) -> None:
        """Tell the person something."""

    def advance(self, done: int, total: int, text: str) -> None:
        """How far it is."""


class Person(Protocol):
    """The person at a hand valve."""

    def ask(self, text: str) -> None:
        """Put a question, and do not wait."""

    def answer(self) -> str | None:
        """What was answered to the last question; None until then."""


class Silent:
    """Nobody watches, and nobody answers: `Progress` and `Person`."""

    def say(self, text: str, warning: bool = False) -> None:
        """Nothing."""

    def advance(self, done: int, total: int, text: str) -> None:
        """Nothing."""

    def ask(self, text: str) -> None:
        """Nothing."""

    def answer(self) -> str | None:
        """Never."""
        return None


# From an absolute pressure [bar] and the plateaus so far: the lowest and the highest speed to be believed [rpm].
Expect = Callable[[float, Sequence[Plateau]], tuple[float, float] | None]


def _nothing_odd(plateaus: Sequence[Plateau]) -> str:
    """No doubt about the speeds."""
    return ""


@dataclass(frozen=True)
class Hooks:
    """What a run is given.

    `predict`: the guard; `guarded` makes one.
    `stops`: how often the operator has asked to stop, such as ``lambda: stop.asked``.
    `expect`: the speeds that a typed one is held against; `expecting` makes one.
    `doubt`: why the speeds of the latest plateaus cannot be so; `doubting` makes one.
    """

    predict: Predict
    trip: Trip
    stops: Callable[[], int]
    progress: Progress
    person: Person
    on_plateau: Callable[[Plateau], None]
    expect: Expect
    doubt: Doubt = _nothing_odd


def gauge_sd_of(bench: Bench) -> float:
    """1-sigma bias of the pressure gauge [bar]."""
    _, gauge = bench.channel("pressure")
    return DEFAULT_GAUGE_SD_BAR if gauge.bias_sd is None else gauge.bias_sd


def guard_of(bench: Bench, ambient: Ambient) -> Guard:
    """What predicts the speed of a level. Raises SafetyError: the bench's limit of the pressure is beyond the model."""
    limit_bar, end_bar = bench.file.safety.highest_pressure_bar_abs, HIGHEST_PA / BAR
    if limit_bar > end_bar:
        raise SafetyError(
            f"{bench.name}: safety.highest_pressure_bar_abs = {limit_bar:g} is above {end_bar:g} bar abs, where the "
            "model that predicts speeds ends; give a lower one"
        )
    motor = motor_of(bench, ambient)
    return Guard(motor, min(bench.file.safety.highest_speed_rpm, motor["speed_limit"].value), gauge_sd_of(bench) * BAR)


def guarded(guard: Guard, ambient_bar: float, is_gauge: bool) -> Predict:
    """The guard as the machine asks it."""

    def predict(level_bar_abs: float, plateaus: Sequence[Plateau]) -> Verdict:
        points = points_of(plateaus, ambient_bar if is_gauge else 0.0)
        return guard.verdict(level_bar_abs * BAR, points)

    return predict


def expecting(guard: Guard, ambient_bar: float, is_gauge: bool) -> Expect:
    """The speeds that the guard holds for possible, for readings that a person types."""

    def expect(bar_abs: float, plateaus: Sequence[Plateau]) -> tuple[float, float] | None:
        try:
            expected = guard.predict(bar_abs * BAR, points_of(plateaus, ambient_bar if is_gauge else 0.0))
        except SafetyError:  # no pressure that the model reaches: other checks are for that
            return None
        return expected.lower99_rpm, expected.upper99_rpm

    return expect


def doubting(guard: Guard, ambient_bar: float, is_gauge: bool) -> Doubt:
    """What the guard holds for impossible, as the machine asks it."""
    return lambda plateaus: guard.doubt(points_of(plateaus, ambient_bar if is_gauge else 0.0))


def points_of(plateaus: Sequence[Plateau], added_bar: float) -> list[Point]:
    """The plateaus that tell the guard something: those with a pressure and a speed on the scale, or at rest.

    `added_bar`: from the channel's zero to absolute [bar].
    """
    points = []
    for plateau in plateaus:
        pressure, speed = plateau.means.get("pressure"), plateau.means.get("speed")
        if pressure is None or speed is None or pressure.mean is None or speed.mean is None or pressure.censored:
            continue
        if speed.censored > 0 or (speed.censored < 0 and speed.mean > 0.0):
            continue
        point = Point(
            (pressure.mean + added_bar) * BAR,
            max(speed.mean, 0.0) * RAD_S,
            (speed.se or 0.0) * RAD_S,
            (pressure.se or 0.0) * BAR,
        )
        points.append(point)
    return points
