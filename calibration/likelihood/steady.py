"""The joint likelihood of speed and flow, with the pressure an uncertain input.

A plateau's true pressure p is unknown; the gauge shows p (1 + scale) + offset + noise, rounded. Around the reading the
model is a straight line in p, so p is integrated out in closed form: speed and flow of a row are jointly normal with
the covariance

    diag(s_n^2, s_q^2) + s_p^2 d d^T,     d = (dn/dp, dq/dp),

where rounding to a resolution adds resolution^2 / 12. Offsets and scales are shared by the whole recording and are
sampled. Each of the three readings of a row may be bad, with probability `BAD` and a wide error; the eight cases are
summed, so a single bad reading is named and drags nothing. A reading off the instrument's scale, or a speed of 0,
enters as censored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from calibration.data.measurement import BELOW, MISSING, OBSERVED, Measurement, Rows
from calibration.systems.radial_piston import effect_states
from calibration.systems.radial_piston.with_effects import Effects
from calibration.unknowns.priors import PASCAL_PER_BAR, Unknown, column_of
from model.effects.laws import Chosen
from model.layout import L_MIN, RPM
from model.motor import QUANTITIES, Motor
from model.solvers import steady
from rig.recording import Recording

BAD = 0.01  # probability that a single reading is bad, before looking
FEW_ROWS = 3  # with fewer no reading is looked on as bad: there is nothing to tell it by
BAD_WIDTH = 10.0  # a bad reading's sd, in sds of a good one ...
BAD_SHARE = 0.1  # ... plus this share of the reading
LOG_2_PI = math.log(2.0 * math.pi)
ERRORS = ("offset", "scale", "noise_scale")


@dataclass(frozen=True)
class Figures:
    """Noise and resolution of the three instruments: bar, L/min, rpm; zeros where a channel is absent."""

    noise_sd: np.ndarray
    resolution: np.ndarray


class Likelihood:
    """Log posterior of a batch of parameter vectors, in the standard normal numbers of `calibration.unknowns.priors`.

    Parameters
    ----------
    bad : float, optional
        Probability that a reading is bad [-]; `BAD`, or 0 with fewer than `FEW_ROWS` rows, when left out.
    """

    def __init__(
        self,
        motor: Motor,
        recording: Recording,
        measured: Measurement,
        found: list[Unknown],
        bad: float | None = None,
        effects: Effects | None = None,
    ) -> None:
        self.unknowns = found
        self.measured = measured
        self.effects = effects
        self._first_of_effects = len(found) - (len(effects.unknowns()) if effects else 0)
        self._base = motor.vector()
        self._readings = motor.readings.vector()
        self._position = {name: i for i, name in enumerate(QUANTITIES)}
        self._bounds = [(i, QUANTITIES[u.name]) for i, u in enumerate(found) if u.name in QUANTITIES]
        rows = measured.steady
        P_a = motor.si("ambient_pressure") / PASCAL_PER_BAR
        nominal = (rows.pressure + np.where(rows.is_gauge, P_a, 0.0)) * PASCAL_PER_BAR
        self._gas = steady.gas_table(motor, nominal)
        columns = [column_of(recording, channel) for channel in ("pressure", "flow", "speed")]
        channels = [recording.channels[column] if column else None for column in columns]
        self._figures = Figures(
            np.array([channel.noise_sd if channel else 0.0 for channel in channels]),
            np.array([channel.resolution if channel else 0.0 for channel in channels]),
        )
        self._steady = _arrays(rows)
        self._zero = _arrays(measured.zero)
        self._bad = bad if bad is not None else (BAD if len(rows) >= FEW_ROWS else 0.0)
        self.not_converged = 0

    def values(self, z: np.ndarray) -> np.ndarray:
        """Physical values of the unknowns, shape (n, n_unknowns), each in its own unit; ``z`` likewise [-]."""
        return np.column_stack([unknown.value(z[:, i]) for i, unknown in enumerate(self.unknowns)])

    def factors(self, z: np.ndarray) -> np.ndarray:
        """What one unit of each coordinate multiplies its unknown by, near a point, shape (n_unknowns,); 1: it adds.

        Parameters
        ----------
        z : ndarray, shape (n_unknowns,)
            The point [-].
        """
        return np.array([unknown.factor(float(at)) for unknown, at in zip(self.unknowns, z, strict=True)])

    def log_prob(self, z: np.ndarray) -> np.ndarray:
        """Log posterior density up to a constant, shape (n,) [-].

        Parameters
        ----------
        z : ndarray, shape (n, n_unknowns)
            Points [-].
        """
        return -0.5 * np.sum(z * z, axis=1) + self.log_likelihood(z)

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Log likelihood, shape (n,), -inf where a parameter leaves its physical bounds [-].

        Parameters
        ----------
        z : ndarray, shape (n, n_unknowns)
            Points [-].
        """
        parameters, errors, inside = self._split(z)
        result = np.full(len(z), -np.inf)
        if inside.any():
            out = self.predict(parameters[inside], errors[inside], self.chosen(z[inside]))
            found = np.empty(out.shape[0])
            _sum_rows(
                out, errors[inside], self._figures.noise_sd, self._figures.resolution, self._bad, *self._steady, found
            )
            _add_zero_rows(
                parameters[inside, self._position["ambient_pressure"]] / PASCAL_PER_BAR,
                errors[inside],
                self._figures.noise_sd,
                self._figures.resolution,
                *self._zero,
                found,
            )
            failed = np.any(out[..., steady.STATUS] == steady.NOT_CONVERGED, axis=1) | ~np.isfinite(found)
            self.not_converged += int(failed.sum())
            result[inside] = np.where(failed, -np.inf, found)
        return result

    def bad_probability(self, z: np.ndarray) -> np.ndarray:
        """Probability that each reading is bad, averaged over points, shape (n_rows, 3): pressure, flow, speed [-].

        Parameters
        ----------
        z : ndarray, shape (n, n_unknowns)
            Draws from the posterior [-].
        """
        parameters, errors, _ = self._split(z)
        out = self.predict(parameters, errors, self.chosen(z))
        found = np.zeros((len(self.measured.steady), 3))
        _bad_rows(out, errors, self._figures.noise_sd, self._figures.resolution, self._bad, *self._steady, found)
        return found / len(z)

    def predict(self, parameters: np.ndarray, errors: np.ndarray, chosen: Sequence[Chosen] = ()) -> np.ndarray:
        """Steady states at each row's pressure reading, corrected for offset and scale; `steady.solve`'s array.

        Parameters
        ----------
        parameters : ndarray, shape (n, n_parameters)
            Parameter sets [SI].
        errors : ndarray, shape (n, 3, 3)
            Offset [bar, L/min, rpm], scale [-] and noise scale [-] of pressure, flow and speed.
        chosen : sequence of mapping
            The effects of each set, of `chosen`; nothing where the fit has none.
        """
        rows = self.measured.steady
        time = self.effects.time if self.effects else None
        return self.states(parameters, errors, chosen, rows.pressure, rows.is_gauge, self._gas, time)

    def states(
        self,
        parameters: np.ndarray,
        errors: np.ndarray,
        chosen: Sequence[Chosen],
        pressure_bar: np.ndarray,
        is_gauge: np.ndarray,
        gas: np.ndarray,
        time: np.ndarray | None,
    ) -> np.ndarray:
        """Steady states where the pressure gauge reads this; `steady.solve`'s array.

        Parameters
        ----------
        parameters : ndarray, shape (n, n_parameters)
            Parameter sets [SI].
        errors : ndarray, shape (n, 3, 3)
            As in `predict`.
        pressure_bar : ndarray, shape (n_rows,)
            What the gauge reads [bar].
        is_gauge : ndarray of bool, shape (n_rows,)
            The pressure is counted from the ambient's.
        gas : ndarray, shape (n_rows, 12)
            Of `steady.gas_table`.
        time : ndarray, shape (n_rows,), or None
            On the recording's clock [s]; effects alone ask for it.
        """
        true = (pressure_bar - errors[:, 0, 0:1]) / (1.0 + errors[:, 0, 1:2])
        above = np.where(is_gauge, parameters[:, self._position["ambient_pressure"]][:, None], 0)
        if self.effects is not None and time is not None:
            shown = true * PASCAL_PER_BAR
            return effect_states.solve(self.effects.way, parameters, self._readings, shown, above, gas, chosen, time)
        P = true * PASCAL_PER_BAR + above
        return steady.solve(parameters, self._readings, np.clip(P, 2e4, 2e6), gas, slopes=True)

    def chosen(self, z: np.ndarray) -> Sequence[Chosen]:
        """The effects at each point with their values; nothing where the fit has none.

        Parameters
        ----------
        z : ndarray, shape (n, n_unknowns)
            Points [-].
        """
        return self.effects.chosen(self.values(z)[:, self._first_of_effects :]) if self.effects else ()

    def split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameter sets [SI], shape (n, n_parameters), and instrument errors, shape (n, 3, 3), of points ``z`` [-].

        Parameters
        ----------
        z : ndarray, shape (n, n_unknowns)
            Points [-].
        """
        parameters, errors, _ = self._split(z)
        return parameters, errors

    def _split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        values = self.values(z)
        parameters = np.repeat(self._base[None, :], len(z), axis=0)
        errors = np.zeros((len(z), 3, 3))
        errors[:, :, 2] = 1.0
        inside = np.ones(len(z), dtype=bool)
        for i, quantity in self._bounds:
            inside &= (values[:, i] >= quantity.low) & (values[:, i] <= quantity.high)
        if self.effects is not None:
            inside &= self.effects.inside(values[:, self._first_of_effects :])
        for i, unknown in enumerate(self.unknowns[: self._first_of_effects]):
            if unknown.name in self._position:
                parameters[:, self._position[unknown.name]] = values[:, i] * QUANTITIES[unknown.name].to_si
            else:
                channel, _, error = unknown.name.partition("_")
                errors[:, ("pressure", "flow", "speed").index(channel), ERRORS.index(error)] = values[:, i]
        return parameters, errors, inside


def _arrays(rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings (n, 3), states (n, 3), is_gauge (n,) and noise scale (n,), contiguous for the compiled loops."""
    readings = np.column_stack([rows.pressure, rows.flow, rows.speed])
    states = np.column_stack([rows.pressure_state, rows.flow_state, rows.speed_state])
    return (
        np.ascontiguousarray(readings, dtype=np.float64),
        np.ascontiguousarray(states, dtype=np.int64),
        np.ascontiguousarray(rows.is_gauge, dtype=np.bool_),
        np.ascontiguousarray(rows.noise_scale, dtype=np.float64),
    )


@njit(cache=True)
def _log_tail(x: float) -> float:
    """Logarithm of the standard normal probability below x."""
    p = 0.5 * math.erfc(-x / math.sqrt(2.0))
    return math.log(p) if p > 1e-290 else -0.5 * x * x - math.log(-x) - 0.5 * LOG_2_PI


@njit(cache=True)
def _log_censored(state: int, difference: float, sd: float) -> float:
    """Log probability that a censored reading lies beyond its limit; ``difference`` is limit less prediction."""
    return _log_tail((difference if state == BELOW else -difference) / sd)


@njit(cache=True)
def _log_row(
    dq: float, dn: float, q_state: int, n_state: int, var_q: float, var_n: float, cov: float, det: float
) -> float:
    """Log density of one row's flow and speed, either missing or censored; ``det`` is their covariance's."""
    if q_state == OBSERVED and n_state == OBSERVED:
        square = (var_n * dq * dq - 2.0 * cov * dq * dn + var_q * dn * dn) / det
        return -0.5 * (square + math.log(det)) - LOG_2_PI
    if q_state == OBSERVED:
        found = -0.5 * (dq * dq / var_q + math.log(var_q) + LOG_2_PI)
        if n_state != MISSING:
            found += _log_censored(n_state, dn - cov / var_q * dq, math.sqrt(det / var_q))
        return found
    if n_state == OBSERVED:
        found = -0.5 * (dn * dn / var_n + math.log(var_n) + LOG_2_PI)
        if q_state != MISSING:
            found += _log_censored(q_state, dq - cov / var_n * dn, math.sqrt(det / var_n))
        return found
    # Both off scale: their correlation, which only the pressure's small noise makes, is left aside.
    found = 0.0
    if q_state != MISSING:
        found += _log_censored(q_state, dq, math.sqrt(var_q))
    if n_state != MISSING:
        found += _log_censored(n_state, dn, math.sqrt(var_n))
    return found


@njit(cache=True)
def _cases(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    scale: float,
    case: np.ndarray,
) -> float:
    """Log weight of each of a row's eight cases (bit 0, 1, 2: pressure, flow, speed is bad), and their log sum."""
    slope_q = out[steady.FLOW_SLOPE] * L_MIN * PASCAL_PER_BAR * (1.0 + errors[1, 1])
    slope_n = out[steady.SPEED_SLOPE] * RPM * PASCAL_PER_BAR * (1.0 + errors[2, 1])
    q = out[steady.VOLUME_FLOW] * L_MIN * (1.0 + errors[1, 1]) + errors[1, 0]
    n = out[steady.SPEED_OUT] * RPM * (1.0 + errors[2, 1]) + errors[2, 0]
    good = np.empty(3)
    bad = np.empty(3)
    for i in range(3):
        good[i] = (noise_sd[i] * scale * errors[i, 2]) ** 2 + resolution[i] ** 2 / 12.0
        bad[i] = (BAD_WIDTH * math.sqrt(good[i]) + BAD_SHARE * abs(reading[i])) ** 2
    top = -math.inf
    for k in range(8):
        p_bad, q_bad, n_bad = k & 1, (k >> 1) & 1, (k >> 2) & 1
        if (k > 0 and bad_share == 0.0) or (q_bad and state[1] == MISSING) or (n_bad and state[2] == MISSING):
            case[k] = -math.inf
            continue
        count = p_bad + q_bad + n_bad
        var_p = (bad[0] if p_bad else good[0]) / (1.0 + errors[0, 1]) ** 2
        own_q = bad[1] if q_bad else good[1]
        own_n = bad[2] if n_bad else good[2]
        var_q = own_q + var_p * slope_q * slope_q
        var_n = own_n + var_p * slope_n * slope_n
        cov = var_p * slope_q * slope_n
        # Not var_q var_n - cov^2: where the pressure's error is all there is, nothing would be left of that.
        det = own_q * own_n + var_p * (own_q * slope_n * slope_n + own_n * slope_q * slope_q)
        case[k] = _log_row(reading[1] - q, reading[2] - n, state[1], state[2], var_q, var_n, cov, det)
        if bad_share > 0.0:
            case[k] += count * math.log(bad_share) + (3 - count) * math.log(1.0 - bad_share)
        top = max(top, case[k])
    total = 0.0
    for k in range(8):
        total += math.exp(case[k] - top)
    return top + math.log(total)


@njit(cache=True, parallel=True)
def _sum_rows(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    is_gauge: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """Log likelihood of the steady rows, one entry a parameter set."""
    for s in prange(out.shape[0]):
        case = np.empty(8)
        total = 0.0
        for r in range(out.shape[1]):
            total += _cases(
                out[s, r], errors[s], noise_sd, resolution, bad_share, reading[r], state[r], noise_scale[r], case
            )
        found[s] = total


@njit(cache=True)
def _bad_rows(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    is_gauge: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """Adds, row by row, the probability that each reading is bad, summed over the parameter sets."""
    case = np.empty(8)
    for s in range(out.shape[0]):
        for r in range(out.shape[1]):
            total = _cases(
                out[s, r], errors[s], noise_sd, resolution, bad_share, reading[r], state[r], noise_scale[r], case
            )
            for k in range(1, 8):
                weight = math.exp(case[k] - total)
                for i in range(3):
                    if (k >> i) & 1:
                        found[r, i] += weight


@njit(cache=True)
def _add_zero_rows(
    ambient: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    reading: np.ndarray,
    state: np.ndarray,
    is_gauge: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """Adds the log likelihood of vented rows with the rotor at rest: they show the instruments' offsets."""
    for s in range(found.size):
        for r in range(state.shape[0]):
            for i in range(3):
                if state[r, i] == MISSING:
                    continue
                true = ambient[s] if i == 0 and not is_gauge[r] else 0.0
                difference = reading[r, i] - true * (1.0 + errors[s, i, 1]) - errors[s, i, 0]
                var = (noise_sd[i] * noise_scale[r] * errors[s, i, 2]) ** 2 + resolution[i] ** 2 / 12.0
                if state[r, i] == OBSERVED:
                    found[s] -= 0.5 * (difference * difference / var + math.log(var) + LOG_2_PI)
                else:
                    found[s] += _log_censored(state[r, i], difference, math.sqrt(var))
