"""What the figures of a diagnosis's report show, computed from the diagnosis; nothing is drawn here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.diagnose import Diagnosis
from calibration.diagnosis.linear import FLOW, SPEED
from calibration.diagnosis.mode import Mode
from calibration.diagnosis.signatures import forces
from calibration.priors import PASCAL_PER_BAR
from model.layout import L_MIN, RPM

UNITS = {"flow": ("L/min", L_MIN), "speed": ("rpm", RPM)}
KINDS = {"flow": FLOW, "speed": SPEED}
FORCE_SD = 0.3  # prior of a free-form force: N m, or share of the middle flow
Q95 = 1.6448536269514722  # of a standard normal
SAME = 1e-9


@dataclass(frozen=True)
class Model:
    """A model beside the readings, arrays of shape (m,) as in the diagnosis's comparison.

    Attributes
    ----------
    name : str
        What it is.
    difference : ndarray
        Readings less what the model says [SI].
    white : ndarray
        The same in standard deviations of the noise [-].
    """

    name: str
    difference: np.ndarray
    white: np.ndarray


@dataclass(frozen=True)
class Coordinate:
    """What residuals are drawn against.

    Attributes
    ----------
    name, unit : str
        For the axis.
    values : ndarray, shape (n,)
        Of each plateau [own unit].
    """

    name: str
    unit: str
    values: np.ndarray


@dataclass(frozen=True)
class Curve:
    """A free-form force or flow with its uncertainty.

    Attributes
    ----------
    title, quantity, unit : str
        What it is, torque or flow, and its unit.
    along : Coordinate
        Where the pieces are [own unit].
    mean, sd : ndarray, shape (k,)
        Of each piece [own unit].
    spans : tuple of (float, float)
        Where it was found to stand out [unit of the coordinate].
    """

    title: str
    quantity: str
    unit: str
    along: Coordinate
    mean: np.ndarray
    sd: np.ndarray
    spans: tuple[tuple[float, float], ...]


def models(found: Diagnosis) -> list[Model]:
    """The base model and, where there is one, the model that the verdict rests on; both in the same noise.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    """
    shown = [of_mode(found, found.base, "base model")]
    if found.verdict.chosen is not None:
        chosen = found.verdict.chosen
        shown.append(of_mode(found, chosen.mode, f"with {' + '.join(chosen.names)}"))
    elif found.term is not None:
        shown.append(_with_term(found, found.term.column))
    return shown


def coordinates(found: Diagnosis) -> list[Coordinate]:
    """Speed, pressure and time of the plateaus; those that do not change are left out.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    """
    plateaus = found.comparison.problem.blocks.plateaus
    if not plateaus.size:
        return []
    along = [
        Coordinate("pressure reading", "bar", plateaus.pressure / PASCAL_PER_BAR),
        Coordinate("speed", "rpm", found.base.prediction.speed * RPM),
        Coordinate("time", "min", plateaus.time / 60.0),
    ]
    return [one for one in along if np.ptp(np.nan_to_num(one.values)) > SAME]


def channels(found: Diagnosis) -> list[str]:
    """The channels that plateaus were read of.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    """
    comparison = found.comparison
    return [name for name, kind in KINDS.items() if comparison.known[comparison.kind == kind].any()]


def noise(found: Diagnosis, channel: str) -> float:
    """Middle standard deviation of a channel's residual by all instruments' noise and rounding [L/min or rpm].

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    channel : str
        Of `channels`.
    """
    white = found.comparison.whitener(found.base.prediction, found.detection.u)
    sd = white.flow if channel == "flow" else np.hypot(white.speed, white.share)
    return float(np.nanmedian(sd)) * UNITS[channel][1]


def curves(found: Diagnosis) -> list[Curve]:
    """The torque and the flow that would close the balances, free in form, everything else free with its prior.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    """
    comparison, base = found.comparison, found.base
    free = [f for f in forces(comparison, base) if f.coordinate in ("speed", "time") and f.columns.shape[1] > 1]
    white = comparison.whitener(base.prediction, found.detection.u)
    good = (base.bad < 0.5).astype(float)
    J = white(base.D) * good[:, None]
    y = white(np.nan_to_num(comparison.read - comparison.raw(base.prediction)) + base.D @ base.z) * good
    middle = float(np.nanmedian(np.abs(comparison.problem.blocks.plateaus.flow))) if comparison.n else 0.0
    drawn = []
    for force in free:
        X = np.column_stack([J, FORCE_SD * white(force.columns) * good[:, None]])
        covariance = np.linalg.inv(X.T @ X + np.eye(X.shape[1]))
        k = J.shape[1]
        torque = force.balance == "torque"
        size = FORCE_SD * (1.0 if torque else middle * L_MIN)
        unit, factor = ("rpm", RPM) if force.coordinate == "speed" else ("min", 1.0 / 60.0)
        quantity = "torque" if torque else "flow"
        spans = tuple(
            (place.where[0] * factor, place.where[1] * factor)
            for place in found.places
            if place.coordinate == force.coordinate and place.channel == force.channel
        )
        drawn.append(
            Curve(
                f"{'braking torque' if torque else 'flow'} that the model lacks",
                quantity,
                "N m" if torque else "L/min",
                Coordinate(force.coordinate, unit, force.places.mean(axis=1) * factor),
                size * (covariance @ X.T @ y)[k:],
                size * np.sqrt(np.diag(covariance)[k:]),
                spans,
            )
        )
    return drawn


def of_mode(found: Diagnosis, mode: Mode, name: str) -> Model:
    """A model at its most probable point beside the readings.

    Parameters
    ----------
    found : Diagnosis
        The diagnosis.
    mode : Mode
        The model.
    name : str
        What it is called.
    """
    comparison = found.comparison
    difference = comparison.read - comparison.raw(mode.prediction)
    return Model(name, difference, comparison.whitener(mode.prediction, found.detection.u)(difference))


def _with_term(found: Diagnosis, column: np.ndarray) -> Model:
    """The base model with a law found from the data, its nuisances free, in the linear model."""
    comparison, base = found.comparison, found.base
    white = comparison.whitener(base.prediction, found.detection.u)
    open_ = comparison.read - comparison.raw(base.prediction) + base.D @ base.z - column
    good = (base.bad < 0.5).astype(float)
    J = white(base.D) * good[:, None]
    z = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ (white(np.nan_to_num(open_)) * good))
    difference = open_ - base.D @ z
    return Model("with the law found", difference, white(difference))
