"""Which parameter matters: the change of speed and flow per 1 % of each, and per standard deviation of its prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from configs.units import BAR
from model import layout as at
from model.gas.cylinder import gas_state
from model.motor import QUANTITIES, Motor, Prior
from model.operation.performance import OperatingPointError, check_pressures
from model.solvers.steady import Steady, solve, unpack

RELATIVE_STEP = 1e-3  # of the central difference
PERCENT = 1e-2
GAS_PARAMETERS = ("ambient_pressure", "ambient_temperature", "inlet_temperature", "relative_humidity")
Pair = tuple[float, float]


@dataclass(frozen=True)
class Sensitivity:
    """What one parameter does, at each pressure; NaN where the motor would stall.

    Attributes
    ----------
    name, unit : str
        The parameter and the unit of ``value``.
    value : float
        Where the change is taken.
    prior_step : str
        One standard deviation of the prior in words, in the parameter's unit; empty for a parameter held fixed.
    speed_rpm_per_percent, flow_l_min_per_percent : ndarray, shape (n_points,)
        Derivative times 1 % of the value.
    speed_rpm_per_prior_sd, flow_l_min_per_prior_sd : ndarray, shape (n_points,), or None
        Half the change from one standard deviation below to one above, on the prior's own (logarithmic) scale.
    """

    name: str
    unit: str
    value: float
    prior_step: str
    speed_rpm_per_percent: np.ndarray
    flow_l_min_per_percent: np.ndarray
    speed_rpm_per_prior_sd: np.ndarray | None
    flow_l_min_per_prior_sd: np.ndarray | None


def sensitivities(motor: Motor, pressures: Sequence[float]) -> list[Sensitivity]:
    """The effect of every parameter that enters an equation, the strongest on speed per 1 % first.

    They are ranked by the largest change of speed per 1 % at any of the pressures. Raises OperatingPointError when a
    pressure is out of reach or the motor stalls at one.
    """
    check_pressures(motor, pressures)
    names = list(QUANTITIES)[: at.N_SOLVER_PARAMETERS]
    steps = {name: _percent_pair(motor, name) for name in names}
    priors = {name: _prior_pair(motor, name) for name in names if motor[name].prior is not None}
    variants = [(name, value) for pairs in (steps, priors) for name, pair in pairs.items() for value in pair]
    base, *results = _solve(motor, [("f_overall", motor["f_overall"].value), *variants], pressures)
    if np.isnan(base).any():
        stalled = ", ".join(f"{P / BAR:g}" for P, speed in zip(pressures, base[0], strict=True) if np.isnan(speed))
        raise OperatingPointError(f"the motor stalls at {stalled} bar; nothing changes with a parameter there")
    changes = [high - low for low, high in zip(results[0::2], results[1::2], strict=True)]
    per_step = dict(zip(steps, changes[: len(steps)], strict=True))
    per_prior = dict(zip(priors, changes[len(steps) :], strict=True))
    found = []
    for name in names:
        span = (steps[name][1] - steps[name][0]) / motor[name].value if motor[name].value else math.inf
        speed, flow = per_step[name] * PERCENT / span
        by_prior = 0.5 * per_prior[name] if name in priors else (None, None)
        found.append(
            Sensitivity(
                name, motor[name].unit, motor[name].value, _in_words(motor, name), speed, flow, by_prior[0], by_prior[1]
            )
        )
    return sorted(found, key=lambda one: -float(np.nan_to_num(np.abs(one.speed_rpm_per_percent)).max()))


def _percent_pair(motor: Motor, name: str) -> Pair:
    """The values of the central difference, kept within the parameter's bounds."""
    value = motor[name].value
    return _bounded(motor, name, value * (1.0 - RELATIVE_STEP), value * (1.0 + RELATIVE_STEP))


def _prior_pair(motor: Motor, name: str) -> Pair:
    """One standard deviation of the prior below and above the value."""
    value, prior = motor[name].value, motor[name].prior
    assert prior is not None  # noqa: S101
    if prior.kind == "normal":
        return _bounded(motor, name, value - prior.sd, value + prior.sd)  # type: ignore[operator]
    ratio = math.exp(_log_sd(prior))
    return _bounded(motor, name, value / ratio, value * ratio)


def _log_sd(prior: Prior) -> float:
    """Standard deviation of the logarithm [-]."""
    if prior.kind == "lognormal":
        return math.log(prior.factor)  # type: ignore[arg-type]
    return math.log(prior.high / prior.low) / math.sqrt(12.0)  # type: ignore[operator]


def _bounded(motor: Motor, name: str, low: float, high: float) -> Pair:
    quantity = motor.quantity(name)
    return max(low, quantity.low), min(high, quantity.high)


def _in_words(motor: Motor, name: str) -> str:
    prior = motor[name].prior
    if prior is None:
        return ""
    if prior.kind == "normal":
        return f"± {prior.sd:g}"
    return f"×÷ {math.exp(_log_sd(prior)):.3g}"


def _solve(motor: Motor, variants: list[tuple[str, float]], pressures: Sequence[float]) -> list[np.ndarray]:
    """Speed [rpm] and flow [L/min] of each variant, shape (2, n_points); NaN where it does not run.

    All that share the motor's gas go in one batch; the few that change the gas are solved with their own.
    """
    rows = np.tile(motor.vector(), (len(variants), 1))
    for row, (name, value) in zip(rows, variants, strict=True):
        row[list(QUANTITIES).index(name)] = value * QUANTITIES[name].to_si
    own_gas = [i for i, (name, _) in enumerate(variants) if name in GAS_PARAMETERS]
    shared = [i for i in range(len(variants)) if i not in own_gas]
    found: dict[int, np.ndarray] = {}
    for group in (shared, *([i] for i in own_gas)):
        out = _solve_group(motor, rows[group], pressures)
        for i, speed, flow, running in zip(group, out.speed_rad_s, out.flow_m3_s, out.running, strict=True):
            found[i] = np.where(running, [speed * at.RPM, flow * at.L_MIN], np.nan)
    return [found[i] for i in range(len(variants))]


def _solve_group(motor: Motor, rows: np.ndarray, pressures: Sequence[float]) -> Steady:
    """Parameter sets that have the gas of the first one in common."""
    readings = motor.readings.vector()
    try:
        gas = np.array([gas_state(rows[0], float(P), readings) for P in pressures])
    except ValueError as error:
        raise OperatingPointError(f"motor {motor.name}: {error}; check the temperatures and the humidity") from error
    return unpack(solve(rows, readings, np.tile(np.asarray(pressures, dtype=np.float64), (len(rows), 1)), gas))
