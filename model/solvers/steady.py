"""The periodic state solved directly: steady speed, flow and torque for batches of parameters and pressures.

Three parts meet here: the adiabatic torque over a pulse and the ripple it makes (`pulse`), and what heat changes
in a cylinder's cycle (`gas.heat_cycle`). A few passes bring speed, gas state and heat to agree; the tests hold the
result against `model.solvers.transient`.

`slopes`: derivatives with pressure too, to 1 %: they carry the pressure's noise into speed and flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from model import layout as at
from model.gas.cylinder import gas_state
from model.motor import Motor
from model.solvers.recent import Recent
from model.solvers.steady_points import (
    FLOW_SLOPE,
    KNOWN_T,
    MASS_FLOW,
    N_KNOWN,
    N_OUT,
    NOT_CONVERGED,
    RIPPLE,
    ROLLER,
    RUNNING,
    SPEED_OUT,
    SPEED_SLOPE,
    STALLED,
    STATUS,
    TOLERANCE,
    TORQUE,
    VOLUME_FLOW,
    solve_batch,
    solve_each_row,
)

__all__ = [
    "FLOW_SLOPE",
    "KNOWN_T",
    "MASS_FLOW",
    "NOT_CONVERGED",
    "N_KNOWN",
    "N_OUT",
    "RIPPLE",
    "ROLLER",
    "RUNNING",
    "SPEED_OUT",
    "SPEED_SLOPE",
    "STALLED",
    "STATUS",
    "TOLERANCE",
    "TORQUE",
    "VOLUME_FLOW",
    "Steady",
    "gas_table",
    "solve",
    "solve_rows",
    "steady",
    "unpack",
]

SHARPER = 0.01  # share of that where a point starts from one close by: a search goes by their small differences
MOST_KEPT_ROWS = 100  # of a call whose result is kept: the calls of a search, not the batches of a fit
_recent = Recent(32)


@dataclass(frozen=True)
class Steady:
    """Steady states, each array of shape (n_sets, n_points).

    `speed_rad_s`: mean speed in time; 0 when the motor stalls.
    `mass_flow_kg_s`: mean flow through the inlet.
    `flow_m3_s`: the same as volume at P_in and T_in, what a flow meter in the line indicates.
    `gas_torque_nm`: mean torque of the gas, before roller friction.
    `roller_torque_nm`: mean torque lost in roller friction.
    `speed_slope`, `flow_slope`: derivatives with pressure [rad/s/Pa], [m3/s/Pa], to 1 %; zero when not asked for.
    `running`, array of bool: False where the motor stalls or no periodic state was found.
    `ripple_rad_s`: speed ripple within a pulse, peak to peak.
    """

    speed_rad_s: np.ndarray
    mass_flow_kg_s: np.ndarray
    flow_m3_s: np.ndarray
    gas_torque_nm: np.ndarray
    roller_torque_nm: np.ndarray
    speed_slope: np.ndarray
    flow_slope: np.ndarray
    running: np.ndarray
    ripple_rad_s: np.ndarray


def solve_rows(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    slopes: bool = False,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """Steady states of rows that each have a pressure and parameters of their own.

    `parameters`, shape (n, 27): parameter sets in SI units, one a row.
    `gas`, shape (n, 12): gas of each row, of `gas_table`.
    `known`, shape (n, 26): what a call before left of states close by, 0 where nothing is known: it saves passes.
        Renewed.
    Returns an array, shape (n, 9): columns as in `solve`.
    """
    a, b, c, d = (np.ascontiguousarray(one, dtype=np.float64) for one in (parameters, readings, pressures, gas))
    about = np.zeros((pressures.size, N_KNOWN)) if known is None else known.copy()
    tolerance = TOLERANCE if known is None else SHARPER * TOLERANCE

    def solved() -> np.ndarray:
        found = np.empty((pressures.size, N_OUT + N_KNOWN))
        out, after = np.empty((pressures.size, N_OUT)), about.copy()
        solve_each_row(a, b, c, d, slopes, tolerance, after, out)
        found[:, :N_OUT], found[:, N_OUT:] = out, after
        return found

    if pressures.size > MOST_KEPT_ROWS:
        found = solved()
    else:
        found = _recent((*(one.tobytes() for one in (a, b, c, d, about)), slopes, tolerance), solved)
    if known is not None:
        known[:] = found[:, N_OUT:]
    return np.ascontiguousarray(found[:, :N_OUT])


def solve(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool = False
) -> np.ndarray:
    """Steady states of many parameter sets in one compiled call on all cores.

    `parameters`, shape (n_sets, 27): parameter sets in SI units, in the order of `model.motor.QUANTITIES`.
    `pressures`, shape (n_sets, n_points): absolute inlet pressures [Pa].
    `gas`, shape (n_points, 12): gas of each point, of `gas_table`; shared by the sets, on which it depends too little
        to matter.
    Returns an array, shape (n_sets, n_points, 9): columns SPEED_OUT [rad/s], MASS_FLOW [kg/s], VOLUME_FLOW [m3/s],
    TORQUE and ROLLER [N m], SPEED_SLOPE [rad/s/Pa], FLOW_SLOPE [m3/s/Pa], STATUS (RUNNING, STALLED or NOT_CONVERGED),
    RIPPLE [rad/s]. Raises ValueError when the shapes do not fit.
    """
    n_sets, n_points = pressures.shape
    if parameters.shape[0] != n_sets or parameters.shape[1] != at.N_VECTOR or gas.shape != (n_points, at.N_GAS):
        raise ValueError(
            f"steady.solve: parameters {parameters.shape}, pressures {pressures.shape} and gas {gas.shape} do not fit"
        )
    out = np.empty((n_sets, n_points, N_OUT))
    solve_batch(
        np.ascontiguousarray(parameters, dtype=np.float64),
        np.ascontiguousarray(readings, dtype=np.float64),
        np.ascontiguousarray(pressures, dtype=np.float64),
        np.ascontiguousarray(gas, dtype=np.float64),
        slopes,
        out,
    )
    return out


def gas_table(motor: Motor, pressures: ArrayLike) -> np.ndarray:
    """Gas of each operating point, shape (n_points, 12), for `solve`."""
    parameters, readings = motor.vector(), motor.readings.vector()
    each = [gas_state(parameters, float(P), readings) for P in np.atleast_1d(pressures)]
    return np.array(each).reshape(len(each), at.N_GAS)


def steady(motor: Motor, pressures: ArrayLike, slopes: bool = False) -> Steady:
    """Steady states of one motor. Returns arrays of shape (1, n_points)."""
    P = np.atleast_1d(np.asarray(pressures, dtype=np.float64))
    return unpack(solve(motor.vector()[None, :], motor.readings.vector(), P[None, :], gas_table(motor, P), slopes))


def unpack(out: np.ndarray) -> Steady:
    """Name the columns of `solve`'s result.

    `out`, shape (n_sets, n_points, 9): what `solve` returned.
    """
    return Steady(
        speed_rad_s=out[..., SPEED_OUT],
        mass_flow_kg_s=out[..., MASS_FLOW],
        flow_m3_s=out[..., VOLUME_FLOW],
        gas_torque_nm=out[..., TORQUE],
        roller_torque_nm=out[..., ROLLER],
        speed_slope=out[..., SPEED_SLOPE],
        flow_slope=out[..., FLOW_SLOPE],
        running=out[..., STATUS] == RUNNING,
        ripple_rad_s=out[..., RIPPLE],
    )
