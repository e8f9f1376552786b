"""The log likelihood of single rows, compiled, and whether a row is bad."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from calibration.data.measurement import BELOW, MISSING, OBSERVED
from calibration.likelihood.bad_reading import variances
from configs.compiled import njit
from configs.units import BAR
from model.layout import L_MIN, RPM
from model.solvers import steady

LOG_2_PI = math.log(2.0 * math.pi)


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
def cases(
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
    slope_q = out[steady.FLOW_SLOPE] * L_MIN * BAR * (1.0 + errors[1, 1])
    slope_n = out[steady.SPEED_SLOPE] * RPM * BAR * (1.0 + errors[2, 1])
    q = out[steady.VOLUME_FLOW] * L_MIN * (1.0 + errors[1, 1]) + errors[1, 0]
    n = out[steady.SPEED_OUT] * RPM * (1.0 + errors[2, 1]) + errors[2, 0]
    narrower = 1.0 / (1.0 + errors[0, 1]) ** 2
    good_p, bad_p = variances(noise_sd[0] * scale * errors[0, 2], resolution[0], reading[0])
    good_q, bad_q = variances(noise_sd[1] * scale * errors[1, 2], resolution[1], reading[1])
    good_n, bad_n = variances(noise_sd[2] * scale * errors[2, 2], resolution[2], reading[2])
    odds = math.log(bad_share / (1.0 - bad_share)) if bad_share > 0.0 else -math.inf
    none_bad = 3.0 * math.log1p(-bad_share)
    top = -math.inf
    for k in range(8):
        p_is_bad, q_is_bad, n_is_bad = k & 1, (k >> 1) & 1, (k >> 2) & 1
        if (k > 0 and bad_share == 0.0) or (q_is_bad and state[1] == MISSING) or (n_is_bad and state[2] == MISSING):
            case[k] = -math.inf
            continue
        var_p = (bad_p if p_is_bad else good_p) * narrower
        own_q = bad_q if q_is_bad else good_q
        own_n = bad_n if n_is_bad else good_n
        var_q = own_q + var_p * slope_q * slope_q
        var_n = own_n + var_p * slope_n * slope_n
        cov = var_p * slope_q * slope_n
        # Not var_q var_n - cov^2: where the pressure's error is all there is, nothing would be left of that.
        det = own_q * own_n + var_p * (own_q * slope_n * slope_n + own_n * slope_q * slope_q)
        case[k] = _log_row(reading[1] - q, reading[2] - n, state[1], state[2], var_q, var_n, cov, det) + none_bad
        if k > 0:
            case[k] += (p_is_bad + q_is_bad + n_is_bad) * odds
        top = max(top, case[k])
    total = 0.0
    for k in range(8):
        total += math.exp(case[k] - top)
    return top + math.log(total)


@njit(cache=True, parallel=True)
def sum_rows(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """Log likelihood of the steady rows, one entry a parameter set."""
    for s in prange(out.shape[0]):
        found[s] = of_set(out[s], errors[s], noise_sd, resolution, bad_share, reading, state, noise_scale)


@njit(cache=True, nogil=True)
def of_set(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    noise_scale: np.ndarray,
) -> float:
    """Log likelihood of the steady rows at one parameter set."""
    case = np.empty(8)
    total = 0.0
    for r in range(out.shape[0]):
        total += cases(out[r], errors, noise_sd, resolution, bad_share, reading[r], state[r], noise_scale[r], case)
    return total


@njit(cache=True)
def bad_rows(
    out: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """Adds, row by row, the probability that each reading is bad, summed over the parameter sets."""
    case = np.empty(8)
    for s in range(out.shape[0]):
        for r in range(out.shape[1]):
            total = cases(
                out[s, r], errors[s], noise_sd, resolution, bad_share, reading[r], state[r], noise_scale[r], case
            )
            for k in range(1, 8):
                weight = math.exp(case[k] - total)
                for i in range(3):
                    if (k >> i) & 1:
                        found[r, i] += weight


@njit(cache=True)
def add_zero_rows(
    ambient: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    reading: np.ndarray,
    state: np.ndarray,
    noise_scale: np.ndarray,
    is_gauge: np.ndarray,
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
