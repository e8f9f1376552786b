"""A triangular quadratic map from independent normal numbers to something shaped like the posterior.

Speed fixes f_overall to a per mille once lap, roller friction and ambient pressure are given, so the posterior is a
thin ridge, and a curved one: a normal distribution of the same covariance overlaps it badly. Here each unknown, from
the widest to the narrowest, is a quadratic polynomial of those before it plus a normal residual. The map's volume is
explicit, so a sampler may walk in the independent numbers instead, where the ridge is straight and every move works.
The residual's sd is itself exponential in the unknowns before it: the ridge is as wide as the noise, and the noise's
scale is an unknown that a dozen rows leave uncertain by a factor of two.

An unknown that varies by a factor enters the polynomials as its value, not as its logarithm, and where the recording
fixes it well it is its value that the polynomial gives: f_overall is linear in the roller friction, and logarithms miss
that ridge by several of its widths at two prior sds.
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit

LEAST = 1e-3  # of its typical value: no value that varies by a factor is taken to fall below
TRIMS = 6  # passes of the regression that leave out what lies far off the ridge
FAR = 5.0  # residual sds
MEDIAN_OF_NORMAL = 0.6745  # median of |N(0, 1)|
RIDGE = 1.0  # of the regression, in standardised units: a prior pseudo-sample for every coefficient
NARROW = 0.2  # relative spread below which an unknown that varies by a factor is modelled as its value
STEEPEST = 2.0  # of the logarithm of a residual's sd, against its typical one
LOG_OF_NORMAL = -0.6352  # mean of log |N(0, 1)|
REACH = 6.0  # prior standard deviations: nothing further out is ever proposed


class Plain:
    """No map: points are their own independent numbers."""

    def push(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points themselves, and a log volume of 0."""
        return e, np.zeros(len(e))

    def pull(self, points: np.ndarray) -> np.ndarray:
        """The points themselves."""
        return points


class TransportMap:
    """The map, fitted to samples.

    `samples`, shape (n_samples, n): draws that look like the posterior [-].
    `factors`, shape (n,): the factor that one unit of each coordinate stands for; 1 where it is additive [-].
    """

    def __init__(self, samples: np.ndarray, factors: np.ndarray) -> None:
        n = samples.shape[1]
        self.order = np.argsort(-samples.std(axis=0))
        self.mean = samples.mean(axis=0)
        self.width = samples.std(axis=0)
        self.rate = np.log(factors)
        warped = self._warp(samples, self.rate)
        self.centre, self.span = warped.mean(axis=0), warped.std(axis=0)
        self.as_value = (self.rate > 0.0) & (self.rate * self.width < NARROW)
        self.pairs = np.array([(i, j) for i in range(n) for j in range(i + 1)])
        self._columns = [_columns_of(k, n) for k in range(n)]
        terms = self._terms(samples)
        scaled = self._targets(samples)
        self.coefficients: list[np.ndarray] = []
        self.widening: list[np.ndarray] = []
        for k in range(n):
            found, miss, kept = _robustly_regressed(terms[:, self._columns[k]], scaled[:, k])
            self.coefficients.append(found)
            self.widening.append(_widening(terms[kept, : k + 1], miss[kept]))
        polynomials, widening = np.zeros((n, terms.shape[1])), np.zeros((n, 1 + n))
        for k in range(n):
            polynomials[k, self._columns[k]] = self.coefficients[k]
            widening[k, : k + 1] = self.widening[k]
        scales = (self.mean, self.width, self.centre, self.span, self.rate)
        self._kernel = (self.order, self.as_value, *scales, polynomials, widening)

    def push(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points from independent numbers.

        `e`, shape (n_points, n): independent numbers [-].
        Returns `points`: points; what lies beyond ten times `REACH` is brought back to there [-]; `log_volume`:
        logarithm of the map's Jacobian, up to a constant [-].
        """
        points, log_volume = np.empty_like(e), np.empty(len(e))
        _push(e, *self._kernel, points, log_volume)
        return points, log_volume

    def pull(self, points: np.ndarray) -> np.ndarray:
        """The independent numbers of given points; the inverse of `push`, both of shape (n_points, n) [-]."""
        terms = self._terms(points)
        scaled = self._targets(points)
        fitted = [terms[:, self._columns[k]] @ self.coefficients[k] for k in range(points.shape[1])]
        log_sd = [self._log_sd(terms, k) for k in range(points.shape[1])]
        return (scaled - np.column_stack(fitted)) * np.exp(-np.column_stack(log_sd))

    def _log_sd(self, terms: np.ndarray, k: int) -> np.ndarray:
        """Logarithm of the residual's sd of unknown ``k`` (in the map's order), from those before it."""
        constant, slopes = self.widening[k][0], self.widening[k][1:]
        found: np.ndarray = constant + _between(terms[:, 1 : k + 1] @ slopes, -STEEPEST, STEEPEST)
        return found

    def _targets(self, points: np.ndarray) -> np.ndarray:
        """What the polynomials give, standardised and in the map's order, shape (n_points, n)."""
        values = (self._warp(points, self.rate) - self.centre) / self.span
        scaled = np.where(self.as_value, values, (points - self.mean) / self.width)
        return scaled[:, self.order]

    def _warp(self, values: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """The value of a coordinate that is a logarithm, others as they are; bounded where no point is proposed."""
        bounded = _between(values, -2.0 * REACH, 2.0 * REACH)
        safe = np.where(rate > 0.0, rate, 1.0)
        return np.where(rate > 0.0, np.expm1(safe * bounded) / safe, bounded)

    def _terms(self, points: np.ndarray) -> np.ndarray:
        """1, all coordinates, then all products of two, in the map's order, by their later coordinate."""
        warped = (self._warp(points, self.rate) - self.centre) / self.span
        features = warped[:, self.order]
        products = features[:, self.pairs[:, 0]] * features[:, self.pairs[:, 1]]
        return np.hstack([np.ones((len(points), 1)), features, products])


@njit(cache=True, nogil=True)
def _push(
    e: np.ndarray,
    order: np.ndarray,
    as_value: np.ndarray,
    mean: np.ndarray,
    width: np.ndarray,
    centre: np.ndarray,
    span: np.ndarray,
    rate: np.ndarray,
    polynomials: np.ndarray,
    widening: np.ndarray,
    points: np.ndarray,
    log_volume: np.ndarray,
) -> None:
    """`TransportMap.push`, a point at a time: each unknown needs those before it."""
    n = e.shape[1]
    features = np.empty(n)
    for i in range(len(e)):
        log_volume[i] = 0.0
        for k in range(n):
            which = order[k]
            scaled, along, product = polynomials[k, 0], 0.0, 1 + n
            for a in range(k):
                scaled += polynomials[k, 1 + a] * features[a]
                along += widening[k, 1 + a] * features[a]
                for b in range(a + 1):
                    scaled += polynomials[k, product] * features[a] * features[b]
                    product += 1
            log_sd = widening[k, 0] + min(max(along, -STEEPEST), STEEPEST)
            scaled += math.exp(log_sd) * e[i, k]
            log_volume[i] += log_sd
            if as_value[which]:
                value = max(rate[which] * (scaled * span[which] + centre[which]), LEAST - 1.0)
                point = math.log1p(value) / rate[which]
                log_volume[i] -= rate[which] * point
            else:
                point = min(max(scaled * width[which] + mean[which], -10.0 * REACH), 10.0 * REACH)
            points[i, which] = point
            bounded = min(max(point, -2.0 * REACH), 2.0 * REACH)
            warped = math.expm1(rate[which] * bounded) / rate[which] if rate[which] > 0.0 else bounded
            features[k] = (warped - centre[which]) / span[which]


def _columns_of(k: int, n: int) -> np.ndarray:
    """Which terms unknown ``k`` of n (in the map's order) may depend on: those of the unknowns before it."""
    return np.concatenate([np.arange(1 + k), np.arange(1 + n, 1 + n + k * (k + 1) // 2)])


def _between(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """As `np.clip`, which takes several times as long where there are few."""
    found: np.ndarray = np.minimum(np.maximum(values, low), high)
    return found


def _robustly_regressed(terms: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ridge coefficients, the residuals, and which points lie on the ridge: a few far off must not widen the map.

    The first term, a constant, is not penalised.
    """
    gram, moment = terms.T @ terms, terms.T @ values
    penalty = np.full(terms.shape[1], RIDGE)
    penalty[0] = 0.0
    kept = np.ones(len(values), dtype=bool)
    for _ in range(TRIMS):
        found = np.linalg.solve(gram + np.diag(penalty), moment)
        miss = values - terms @ found
        near = np.abs(miss) < FAR * np.median(np.abs(miss[kept])) / MEDIAN_OF_NORMAL
        gone, back = kept & ~near, near & ~kept
        if not gone.any() and not back.any():
            break
        gram += terms[back].T @ terms[back] - terms[gone].T @ terms[gone]
        moment += terms[back].T @ values[back] - terms[gone].T @ values[gone]
        kept = near
    return found, miss, kept


def _widening(terms: np.ndarray, miss: np.ndarray) -> np.ndarray:
    """How the logarithm of the residuals' sd depends on linear terms, a constant first; scaled to their mean square."""
    penalty = np.full(terms.shape[1], RIDGE)
    penalty[0] = 0.0
    logarithm = np.log(np.maximum(np.abs(miss), 1e-12)) - LOG_OF_NORMAL
    found: np.ndarray = np.linalg.solve(terms.T @ terms + np.diag(penalty), terms.T @ logarithm)
    slope = np.clip(terms[:, 1:] @ found[1:], -STEEPEST, STEEPEST)
    found[0] = 0.5 * np.log(np.mean((miss * np.exp(-slope)) ** 2))
    return found
