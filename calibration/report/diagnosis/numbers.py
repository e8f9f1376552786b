"""What the figures of a diagnosis's report show, computed from the diagnosis; nothing is drawn here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.steps.correction import Correction, corrections
from calibration.diagnosis.steps.locate import METERS, Kind
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict import gauge
from calibration.systems.radial_piston.predict.kinds import FLOW, SPEED
from configs.units import BAR
from model.layout import L_MIN, RPM

UNITS = {"flow": ("L/min", L_MIN), "speed": ("rpm", RPM)}
KINDS = {"flow": FLOW, "speed": SPEED}
FAMILIAR = {
    "speed": ("rpm", RPM),
    "time": ("min", 1.0 / 60.0),
    "pressure": ("bar abs", 1.0 / BAR),
    "flow": ("L/min", L_MIN),
}
ERRORS = {"pressure": ("kPa", 1e-3), "flow": ("L/min", L_MIN), "speed": ("rpm", RPM)}  # of each channel's instrument
SAME = 1e-9


@dataclass(frozen=True)
class Model:
    """A model beside the readings, arrays of shape (m,) as in the diagnosis's comparison.

    `difference`: readings less what the model says [SI].
    """

    name: str
    difference: np.ndarray
    white: np.ndarray


@dataclass(frozen=True)
class Coordinate:
    """What residuals are drawn against. `values`, shape (n,): of each plateau [own unit]."""

    name: str
    unit: str
    values: np.ndarray


@dataclass(frozen=True)
class Curve:
    """A smooth torque, flow or error of an instrument with its uncertainty.

    `title`, `quantity`, `unit`: what it is: torque, flow or error, and its unit.
    `along`: where it is known [own unit].
    `mean`, `sd`, shape (k,): there [own unit].
    `spans`: where it was found to stand out [unit of the coordinate].
    """

    title: str
    quantity: str
    unit: str
    along: Coordinate
    mean: np.ndarray
    sd: np.ndarray
    spans: tuple[tuple[float, float], ...]


def models(found: Diagnosis) -> list[Model]:
    """The base model and, where there is one, the model that the verdict rests on; both in the same noise."""
    shown = [of_mode(found, found.base, "base model")]
    if found.verdict.chosen is not None:
        chosen = found.verdict.chosen
        shown.append(of_mode(found, chosen.mode, f"with {' + '.join(chosen.names)}"))
    elif found.correction is not None:  # what the held-out rows are predicted with
        shown.append(_with(found, found.correction.column, "with a smooth correction"))
    elif found.term is not None:
        shown.append(_with(found, found.term.column, "with the law found"))
    return shown


def of_motor(found: Diagnosis) -> Comparison:
    """The recording of a diagnosis of this motor; of several, each is told by itself."""
    return cast(Comparison, found.comparison)


def coordinates(found: Diagnosis) -> list[Coordinate]:
    """Speed, pressure and time of the plateaus; those that do not change are left out."""
    problem = of_motor(found).problem
    plateaus = problem.blocks.plateaus
    if not plateaus.size:
        return []
    line = gauge.absolute(plateaus.pressure, plateaus.is_gauge, problem.motor.si("ambient_pressure"))
    along = [
        Coordinate("pressure", "bar abs", line / BAR),
        Coordinate("speed", "rpm", found.base.prediction.speed * RPM),
        Coordinate("time", "min", plateaus.time / 60.0),
    ]
    return [one for one in along if np.ptp(np.nan_to_num(one.values)) > SAME]


def channels(found: Diagnosis) -> list[str]:
    """The channels that plateaus were read of."""
    comparison = of_motor(found)
    return [name for name, kind in KINDS.items() if comparison.known[comparison.kind == kind].any()]


def noise(found: Diagnosis, channel: str) -> float:
    """Middle standard deviation of a channel's residual by all instruments' noise and rounding [L/min or rpm]."""
    comparison = of_motor(found)
    white, n = comparison.whitener(found.base.prediction, found.detection.u), comparison.n
    sd = np.linalg.norm(white.plateaus, axis=1)[slice(0, n) if channel == "flow" else slice(n, 2 * n)]
    return float(np.nanmedian(sd)) * UNITS[channel][1]


def curves(found: Diagnosis) -> list[Curve]:
    """The torque and the flow that would close the balances, and the instruments' errors, smooth; one at a time.

    Everything else is free with its prior. Along speed, time and pressure, an error along its instrument's own range;
    that which an unresolved verdict predicts with comes first.
    """
    smooth = corrections(found.comparison, found.base, found.detection.u, meters=True)
    order = ["speed", "time", "pressure", "flow"]
    shown = sorted(
        smooth,
        key=lambda one: (
            not _is(one, found.correction),
            one.balance == "sensor",
            order.index(one.coordinate),
            one.balance != "torque",
        ),
    )
    return [_curve(found, one) for one in shown]


def _is(one: Correction, other: Correction | None) -> bool:
    return other is not None and (one.balance, one.coordinate) == (other.balance, other.coordinate)


def _curve(found: Diagnosis, one: Correction) -> Curve:
    title, quantity, shown, size = {
        "torque": ("braking torque that the model lacks", "torque", "N m", 1.0),
        "mass": ("flow that the model lacks", "flow", "L/min", L_MIN),
        "sensor": (f"what the {METERS[one.channel]} reads too much", "error", *ERRORS[one.channel]),
    }[one.balance]
    unit, factor = FAMILIAR[one.coordinate]
    spans = tuple(
        (place.where[0] * factor, place.where[1] * factor)
        for place in found.places
        if (place.coordinate, place.channel) == (one.coordinate, one.channel)
        and (place.kind is Kind.METER) == (one.balance == "sensor")
    )
    return Curve(
        title,
        quantity,
        shown,
        Coordinate(one.coordinate, unit, one.at * factor),
        size * one.mean,
        size * one.sd,
        spans,
    )


def of_mode(found: Diagnosis, mode: Mode, name: str) -> Model:
    """A model at its most probable point beside the readings."""
    comparison = found.comparison
    difference = comparison.read - comparison.raw(mode.prediction)
    return Model(name, difference, comparison.whitener(mode.prediction, found.detection.u)(difference))


def _with(found: Diagnosis, column: np.ndarray, name: str) -> Model:
    """The base model with a law found from the data, or a smooth correction; nuisances free, in the linear model."""
    comparison, base = found.comparison, found.base
    white = comparison.whitener(base.prediction, found.detection.u)
    open_ = comparison.read - comparison.raw(base.prediction) + base.D @ base.z - column
    good = (base.bad < 0.5).astype(float)
    J = white(base.D) * good[:, None]
    z = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ (white(np.nan_to_num(open_)) * good))
    difference = open_ - base.D @ z
    return Model(name, difference, white(difference))
