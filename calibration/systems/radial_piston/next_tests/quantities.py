"""Single quantities that would part explanations, and the instrument that reads each.

With the rotor held the bench's own flow meter does; the others need an instrument that the bench may not have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.expected import Expected, directions
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.next_tests.planned import OF_THE_LIMIT
from calibration.systems.radial_piston.predict import gauge
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.systems.radial_piston.predict.standing import standing_flow
from model import layout as at
from model.effects.effect import State
from model.effects.laws import Chosen, members, readings_of

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

LOCKED_PA = 2e5
READINGS = 10.0  # averaged
STEP = 1e-3  # of a standard normal unknown, for derivatives
TORQUE_N_M, PRESSURE_PA = 0.01, 200.0  # 1 sd of the instruments listed
REFERENCES = {"flow": ("flow meter", 0.01), "speed": ("tachometer", 2e-4)}  # and of these, as shares


@dataclass(frozen=True)
class Quantity:
    """Something to be read once.

    `words`, `needs`: what to do; the instrument that it needs, empty where the bench has it.
    `sd`: of the reading [SI].
    `value`: of the motor's parameters, the instruments' errors and the effects [SI].
    """

    words: str
    needs: str
    sd: float
    value: Callable[[np.ndarray, dict[str, tuple[float, float]], Chosen], float]


def quantities(comparison: Comparison, best: Mode) -> list[Quantity]:
    """What could be read of a motor at its highest level, at standstill, and driven.

    `best`: the most probable explanation, for the state at the highest level.
    """
    problem = comparison.problem
    state = best.prediction.state
    limit = problem.motor.si("speed_limit")
    predicted = np.isfinite(best.prediction.speed)
    within = predicted & ~(problem.blocks.plateaus.speed > limit)  # nothing is asked for at a level that was too fast
    top = int(np.nanargmax(np.where(within if within.any() else predicted, state.pressure, np.nan)))
    here = State(**{name: np.atleast_1d(values[top]) for name, values in vars(state).items()})
    omega = np.minimum(here.omega, OF_THE_LIMIT * limit)  # a model that is off may predict more
    found = _inside(here, omega)
    if np.isfinite(best.prediction.flow[top]):
        found.append(_beside_a_reference("flow", best.prediction.flow[top : top + 1], here))
    if problem.noise["flow"] > 0.0:
        found.append(_locked(problem.noise["flow"], here))
    return [*found, _beside_a_reference("speed", best.prediction.speed[top : top + 1], here)]


def _inside(here: State, omega: np.ndarray) -> list[Quantity]:
    """Torque and pressures of the motor itself, at its highest level and at a speed [rad/s]."""
    zero = np.zeros(1)
    driven = replace(here, omega=omega, load=zero, mass_flow=zero, pressure=here.ambient)
    level = _level(here)
    return [
        Quantity(
            f"drive the shaft at {float(omega[0]) * at.RPM:.0f} rpm with the line vented",
            f"a drive with a torque transducer ({TORQUE_N_M:g} N m)",
            TORQUE_N_M,
            lambda p, e, c: float(p[at.F_OVERALL] * omega[0] + _sum(c, "torque", driven)),
        ),
        Quantity(
            f"read the line beside a reference {level}",
            f"a reference pressure gauge ({PRESSURE_PA:g} Pa)",
            PRESSURE_PA,
            lambda p, e, c: float(
                gauge.true_pressure(here.pressure, False, 0.0, e["pressure"], c)[0] - here.pressure[0]
            ),
        ),
        Quantity(
            f"read the pressure loss between the line and the cylinders {level}",
            f"a difference gauge ({PRESSURE_PA:g} Pa) with a tap at the ports",
            PRESSURE_PA,
            lambda p, e, c: _sum(c, "inlet_drop", here),
        ),
        Quantity(
            f"read the pressure behind the cylinders {level}",
            f"a difference gauge ({PRESSURE_PA:g} Pa) with a tap at the exhaust",
            PRESSURE_PA,
            lambda p, e, c: _sum(c, "outlet_rise", here),
        ),
    ]


def _beside_a_reference(channel: str, expected: np.ndarray, here: State) -> Quantity:
    """Flow or speed, read by a second instrument too; `expected`: of the bench's own [SI], shape (1,)."""
    name, share = REFERENCES[channel]
    return Quantity(
        f"read the {channel} beside a reference {_level(here)}",
        f"a reference {name} ({100.0 * share:g} %)",
        share * float(expected[0]),
        lambda p, e, c: float(_shown(c, e, channel, expected, here)[0] - expected[0]),
    )


def _locked(noise: float, here: State) -> Quantity:
    """What leaks past a rotor that is held; `noise`: of a flow reading [m3/s]."""
    line = np.array([LOCKED_PA])
    return Quantity(
        f"locked rotor: flow at {LOCKED_PA / 1e5:g} bar with the rotor held",
        "",
        noise / np.sqrt(READINGS),
        lambda p, e, c: float(standing_flow(line, here.time, here.gas_constant, p, e["flow"], c)[0]),
    )


def _level(here: State) -> str:
    return f"at {float(here.pressure[0]) / 1e5:.1f} bar"


def expected_quantity(one: Quantity, problem: Problem, rivals: Sequence[Mode]) -> list[Expected]:
    """What would be read under each rival, in standard deviations of the reading."""
    k = len(problem.nuisances)
    found = []
    for rival in rivals:

        def value(z: np.ndarray, names: tuple[str, ...] = rival.names) -> float:
            parameters, errors, *_ = problem.split(z[:k])
            return one.value(parameters, errors, problem.chosen(names, z[k:])) / one.sd

        open_ = directions(rival.covariance)
        here = value(rival.z)
        slopes = np.array([(value(rival.z + step) - here) / STEP for step in STEP * open_.T])
        found.append(Expected(np.array([here]), slopes[None, :], np.zeros((1, 1)), np.eye(1)))
    return found


def _sum(chosen: Chosen, law: str, state: State) -> float:
    """A torque, a pressure or a leak of a set at one state [SI]; what goes with the angle cancels over a turn."""
    total = 0.0
    for effect, values in members(chosen):
        one = getattr(effect, law)
        if one is not None and not effect.periodic:
            total += float(np.nan_to_num(one(values, state))[0])
    return total


def _shown(
    chosen: Chosen, errors: dict[str, tuple[float, float]], channel: str, true: np.ndarray, state: State
) -> np.ndarray:
    """What an instrument shows of a true value [SI]."""
    offset, scale = errors[channel]
    return readings_of(chosen, channel, true, state) * (1.0 + scale) + offset
