"""Priors: every unknown of a fit as a function of a standard normal number.

The sampler walks in ``z``, one coordinate an unknown, where every prior is N(0, 1): all unknowns have the same scale,
no bound can be stepped over, and what the recording does not inform stays at mean 0 and sd 1 for everyone to see.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from configs.units import BAR, ZERO_C
from model.motor import QUANTITIES, Motor
from rig.recording import Channel, Recording
from rig.recording.columns import NUMERIC

NOISE_FACTOR = 1.35  # one standard deviation (log-normal 0.3) of how far a declared noise figure may be off
NOISE_SD = math.log(NOISE_FACTOR)
TEMPERATURE_SD = 0.5  # K, of a recorded temperature whose recording states no uncertainty
PRESSURE_SD_BAR = 0.0015  # bar, of a recorded barometer that states none
CHANNELS = ("pressure", "flow", "speed")
SHAPE_FACTOR = 2.0  # one sd of the log-normal prior of a figure that shapes an effect's law


Kind = Literal["normal", "lognormal", "loguniform", "size", "halfsize"]


class Error(StrEnum):
    """What may be off in an instrument."""

    OFFSET = "offset"
    SCALE = "scale"
    NOISE = "noise_scale"
    DRIFT = "offset_drift"  # of the offset, since another day


class OfInstrument(NamedTuple):
    """Whose error an unknown is; of one ``file`` alone, where it names one."""

    channel: str
    error: Error
    file: str = ""


class OfEffect(NamedTuple):
    """The effect that an unknown is a parameter of."""

    effect: str
    parameter: str


class OfRun(NamedTuple):
    """The run in time, by its file, that has an unknown for itself, and what of it that is."""

    file: str
    what: str


def full_name(own: str, whose: str) -> str:
    """The name among the unknowns of several recordings of what one of them has for itself, or all share."""
    return f"{whose}: {own}" if whose else own


@dataclass(frozen=True)
class Unknown:
    """One coordinate of the fit.

    `own`: its name among the unknowns of one recording.
    `kind`: normal (``a`` + ``b`` z), lognormal (``a`` ``b``^z), loguniform (between ``a`` and ``b``), size (``a`` +
        ``b`` sinh z: Johnson's S_U law) or halfsize (such a law folded at ``a``, but rising with z, so that it has one
        peak).
    `of`: what it belongs to; None where that is the motor.
    `whose`: of several recordings the one that has it for itself, or the instrument's serial number; empty where all
        share it.
    """

    own: str
    unit: str
    kind: Kind
    a: float
    b: float
    why: str
    of: OfInstrument | OfEffect | OfRun | None = None
    whose: str = ""

    @property
    def name(self) -> str:
        """Its name among all unknowns, as people read it."""
        return full_name(self.own, self.whose)

    def value(self, z: np.ndarray) -> np.ndarray:
        """The unknown's value in its unit, same shape as ``z`` [-]."""
        if self.kind == "normal":
            return self.a + self.b * z
        if self.kind == "lognormal":
            return self.a * self.b**z
        if self.kind == "size":
            return self.a + self.b * np.sinh(z)
        if self.kind == "halfsize":
            return self.a - self.b * np.sinh(ndtri(0.5 * ndtr(-z)))
        return self.a * (self.b / self.a) ** ndtr(z)

    def factor(self, z: float) -> float:
        """What one unit of z multiplies the value by near ``z``; 1 where it adds [-]."""
        if self.kind in ("normal", "size", "halfsize"):
            return 1.0
        if self.kind == "lognormal":
            return self.b
        density = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        return float((self.b / self.a) ** density)

    def z(self, value: float) -> float:
        """The standard normal number of a value in the unknown's unit; the inverse of `value` [-]."""
        if self.kind == "normal":
            return (value - self.a) / self.b
        if self.kind == "lognormal":
            return float(np.log(value / self.a) / np.log(self.b))
        if self.kind == "size":
            return float(np.arcsinh((value - self.a) / self.b))
        if self.kind == "halfsize":
            return float(-ndtri(2.0 * ndtr(np.arcsinh((self.a - value) / self.b))))
        return float(ndtri(np.log(value / self.a) / np.log(self.b / self.a)))


def unknown_of_run(file: str, what: str, unit: str, kind: Kind, a: float, b: float, why: str) -> Unknown:
    """An unknown that a run in time has for itself; see `Unknown`."""
    return Unknown(f"{file}.{what}", unit, kind, a, b, why, OfRun(file, what))


def values_of(found: Sequence[Unknown], z: np.ndarray) -> np.ndarray:
    """Physical values of unknowns, shape (n, n_unknowns), each in its own unit; ``z`` likewise [-]."""
    return np.column_stack([unknown.value(z[:, i]) for i, unknown in enumerate(found)])


def factors_at(found: Sequence[Unknown], z: np.ndarray) -> np.ndarray:
    """What one unit of each coordinate multiplies its unknown by, near a point, shape (n_unknowns,); 1: it adds.

    `z`, shape (n_unknowns,): the point [-].
    """
    return np.array([unknown.factor(float(at)) for unknown, at in zip(found, z, strict=True)])


def unknowns(motor: Motor, recording: Recording) -> list[Unknown]:
    """All unknowns of a fit: the motor's parameters that carry a prior, then the errors of each instrument.

    `motor`: the motor, already moved to the recording's ambient by `at_ambient`.
    In a fixed order; an instrument's error whose prior has no width is left out.
    """
    found = [_of_motor(motor, recording, name) for name in QUANTITIES if motor[name].prior is not None]
    for channel in CHANNELS:
        column = column_of(recording, channel)
        if column is None:
            continue
        figures = recording.channels[column]
        found += off(channel, column, figures.bias_sd, NUMERIC[column].unit, figures.scale_sd)
        if figures.noise_sd > 0.0:
            found.append(noise_scale(channel, "a declared noise figure is uncertain by a factor 1.35"))
    return found


def off(channel: str, column: str, offset_sd: float, unit: str, scale_sd: float) -> list[Unknown]:
    """Offset [``unit``] and scale [-] of an instrument, where its recording declares that they may be off."""
    why, both = f"recording, channels.{column}", ((Error.OFFSET, offset_sd, unit), (Error.SCALE, scale_sd, "1"))
    return [
        Unknown(f"{channel}_{error}", unit, "normal", 0.0, sd, why, OfInstrument(channel, error))
        for error, sd, unit in both
        if sd > 0.0
    ]


def noise_scale(channel: str, why: str) -> Unknown:
    """How many times the declared noise of an instrument there is."""
    of = OfInstrument(channel, Error.NOISE)
    return Unknown(f"{channel}_{of.error}", "1", "lognormal", 1.0, NOISE_FACTOR, why, of)


def at_ambient(motor: Motor, recording: Recording) -> Motor:
    """The motor in the recording's ambient; what the recording leaves out keeps the motor's default.

    Returns the changed motor. Raises configs.ConfigError when the recorded ambient is outside the motor's bounds.
    """
    ambient = recording.ambient
    values: dict[str, float] = {}
    if ambient.pressure_bar_abs is not None:
        values["ambient_pressure"] = ambient.pressure_bar_abs * BAR
    if ambient.temperature_c is not None:
        values["ambient_temperature"] = values["inlet_temperature"] = ambient.temperature_c + ZERO_C
    if ambient.relative_humidity is not None:
        values["relative_humidity"] = ambient.relative_humidity
    return motor.with_values(values)


def column_of(recording: Recording, channel: str) -> str | None:
    """The recording's column of a channel (pressure, flow, speed), or None where it has none."""
    return next((column for column in recording.channels if NUMERIC[column].channel == channel), None)


def figures_of(recording: Recording, one: Unknown) -> Channel | None:
    """What is declared of the instrument whose error an unknown is; None where it is none of these."""
    column = column_of(recording, one.of.channel) if isinstance(one.of, OfInstrument) else None
    return None if column is None else recording.channels[column]


def drift_of(recording: Recording, one: Unknown) -> Unknown | None:
    """How far an instrument's offset may have drifted since another day; None where it is not said to."""
    figures = figures_of(recording, one)
    if not isinstance(one.of, OfInstrument) or one.of.error is not Error.OFFSET or figures is None:
        return None
    if not figures.serial or figures.drift_sd == 0.0:
        return None
    of, why = one.of._replace(error=Error.DRIFT), f"{one.why} drift_sd"
    return Unknown(f"{of.channel}_{of.error}", one.unit, "normal", 0.0, figures.drift_sd, why, of)


def draw(found: Sequence[Unknown], rng: np.random.Generator, n: int) -> np.ndarray:
    """Draws from the prior, shape (n, n_unknowns), as standard normal numbers [-]."""
    return rng.standard_normal((n, len(found)))


def _of_motor(motor: Motor, recording: Recording, name: str) -> Unknown:
    """A parameter's prior, or the recording's own knowledge of the ambient where it has some."""
    parameter, ambient = motor[name], recording.ambient
    prior = parameter.prior
    if prior is None:
        raise ValueError(f"{name} has no prior")
    unit, value = parameter.unit, parameter.value
    if name == "ambient_pressure" and ambient.pressure_bar_abs is not None:
        sd = ambient.pressure_sd_bar if ambient.pressure_sd_bar else PRESSURE_SD_BAR
        return Unknown(name, unit, "normal", value, sd * BAR, "recording, ambient")
    if name in ("ambient_temperature", "inlet_temperature") and ambient.temperature_c is not None:
        sd = ambient.temperature_sd_k if ambient.temperature_sd_k else TEMPERATURE_SD
        return Unknown(name, unit, "normal", value, sd, "recording, ambient")
    why = f"motor {motor.name}: {parameter.source}"
    if prior.sd is not None:
        return Unknown(name, unit, "normal", value, prior.sd, why)
    if prior.factor is not None:
        return Unknown(name, unit, "lognormal", value, prior.factor, why)
    if prior.low is None or prior.high is None:
        raise ValueError(f"{name}: an incomplete prior")
    return Unknown(name, unit, "loguniform", prior.low, prior.high, why)
