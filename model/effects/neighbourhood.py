"""Steady operating points close to one that is known, each at the price of a single pass.

With G(x; q) the state at which a pass from the state x arrives at parameters q, a solution is x0 = G(x0; q0). Close to
it the solution at q is, to first order, x0 + (1 - dG/dx)^-1 (G(x0; q) - G(x0; q0)). That is as good as a derivative
needs, and no better: what is compared with readings is solved in full.
"""

from __future__ import annotations

import numpy as np

from model import layout as at
from model.effects import laws, uneven
from model.effects.effect import State
from model.effects.steady import Points, given_state, hang_on_state, one_pass, solve
from model.solvers import steady as base

PROBE = 1e-4  # relative change of the speed, then of the mass flow, for dG/dx
AGREES = 1e-6  # relative: by so much the known solution may miss where its own pass arrives
FARTHEST = 0.01  # relative change of speed or mass flow above which a row is solved in full


class Neighbourhood:
    """Operating points close to a solution.

    `state`: the solution, of `model.effects.steady.solve`. Rows of it that stall, or that a pass does not lead back to,
        are solved in full each time.
    `gas`, shape (n, 12): gas of each row, of `model.solvers.steady.gas_table`; that of the whole neighbourhood.
    """

    def __init__(
        self,
        state: State,
        parameters: np.ndarray,
        readings: np.ndarray,
        pressures: np.ndarray,
        gas: np.ndarray,
        chosen: laws.Chosen,
        time: np.ndarray,
    ) -> None:
        self._readings, self._gas, self._time = readings, gas, time
        self._known = np.zeros(time.size, dtype=bool)
        self._cycle = np.zeros((time.size, base.N_KNOWN))
        if not hang_on_state(chosen):
            return  # to solve in full is a single pass too
        self._x = x = _vector(state)
        self._pass(x, parameters, pressures, chosen, self._cycle)
        self._arrived, known = self._pass(x, parameters, pressures, chosen)[:2]  # as all that are held against it
        G_x = np.zeros((time.size, 3, 3))  # what a pass arrives at does not hang on the load: its tangent is exact
        for k in (0, 1):
            moved = x.copy()
            moved[:, k] *= 1.0 + PROBE
            there, running = self._pass(moved, parameters, pressures, chosen)[:2]
            known &= running & (x[:, k] > 0.0)
            G_x[known, :, k] = (there - self._arrived)[known] / (PROBE * x[known, k, None])
        self._known = known & _within(self._arrived - x, x, AGREES)
        self._response = np.zeros_like(G_x)
        self._response[self._known] = np.linalg.inv(np.eye(3) - G_x[self._known])

    def points(self, parameters: np.ndarray, pressures: np.ndarray, chosen: laws.Chosen) -> Points:
        """Operating points at other parameters, to first order in what they differ by; slopes too.

        `chosen`: the same effects, with other values.
        """
        if not self._known.any():
            return self._in_full(np.arange(pressures.size), parameters, pressures, chosen)
        arrived, running, out, state = self._pass(self._x, parameters, pressures, chosen)
        change = np.einsum("nij,nj->ni", self._response, arrived - self._arrived)
        omega, mass_flow, load = (self._x + change).T
        state = state.changed(omega=omega, mass_flow=mass_flow, load=load)
        volume = self._gas[:, at.GAS_R] * state.temperature / pressures
        speed, flow = omega.copy(), mass_flow * volume
        share = uneven.share_of_speed(laws.with_factors(parameters, chosen), chosen, speed)
        if share is not None:
            flow -= (1.0 - share) * (flow - laws.leak(chosen, state) * volume)
            speed, running = share * speed, running & (share > 0.0)
        found = Points(speed, flow, out[:, base.SPEED_SLOPE], out[:, base.FLOW_SLOPE], running, state)
        rest = np.flatnonzero(~(self._known & running & _within(change, self._x, FARTHEST)))
        if rest.size:
            full = self._in_full(rest, parameters, pressures, chosen)
            for name in ("speed", "flow", "speed_slope", "flow_slope", "running"):
                getattr(found, name)[rest] = getattr(full, name)
            for name in ("omega", "mass_flow", "load"):
                getattr(found.state, name)[rest] = getattr(full.state, name)
        return found

    def _in_full(self, rows: np.ndarray, parameters: np.ndarray, pressures: np.ndarray, chosen: laws.Chosen) -> Points:
        gas, time, theirs = self._gas[rows], self._time[rows], laws.rows_of(chosen, rows)
        return solve(parameters[rows], self._readings, pressures[rows], gas, theirs, time, slopes=True)

    def _pass(
        self,
        x: np.ndarray,
        parameters: np.ndarray,
        pressures: np.ndarray,
        chosen: laws.Chosen,
        cycle: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, State]:
        """Where a pass arrives, whether it runs, the base solver's array, and the state.

        It starts from the solution's cycles, or from those given, which it renews.
        """
        cycle = self._cycle.copy() if cycle is None else cycle
        chosen = laws.switched_on(chosen)
        parameters = laws.with_factors(parameters, chosen)
        given = given_state(parameters, pressures, self._gas, self._time)
        out, state = one_pass(
            parameters,
            chosen,
            given.changed(omega=x[:, 0], mass_flow=x[:, 1], load=x[:, 2]),
            lambda rows: base.solve_rows(rows, self._readings, pressures, self._gas, slopes=True, known=cycle),
        )
        return _vector(state), out[:, base.STATUS] == base.RUNNING, out, state


def _vector(state: State) -> np.ndarray:
    """What of a state is found, and not given: speed [rad/s], mass flow [kg/s] and load [N m], shape (n, 3)."""
    return np.column_stack([state.omega, state.mass_flow, state.load])


def _within(change: np.ndarray, x: np.ndarray, share: float) -> np.ndarray:
    """Whether speed and mass flow change by no more than a share of themselves."""
    return np.all(np.abs(change[:, :2]) <= share * np.abs(x[:, :2]), axis=1)
