"""Before a step: the speed that the next pressure would give, and whether it may be ordered.

The rotor settles in 0.08 s, so a trip that waits for a reading comes after the speed is there. The model says it
before: its unknowns, with the priors of the motor's file, learn from the points so far, and a level whose upper 99 %
passes the limit is refused. What the model may lack is part of the bound, in two forms:

- a shift of the pressure: the gauge's bias, and dry friction, which acts like one (0.1 N m is 0.036 bar of this motor).
  It is what makes a motor run faster above the points than a model without it says: +13 % from 1.3 to 2.5 bar.
- a discrepancy of the log speed, 4 %, alike over a doubling of the gauge pressure and forgotten beyond, for what else
  differs. Near a measured point it is known from it; it grows with the distance. Heat left out moves the speed at
  2.5 bar by 1 % against that at 1.3, the other reading of the torque by 0.1 %; windage (2e-4 N m s2) and throttling
  by -13 %, to the safe side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from configs.units import BAR
from model.gas.air import RANGES
from model.layout import F_OVERALL, RPM
from model.motor import QUANTITIES, Motor
from model.solvers import steady
from rig.interlock import SafetyError, belief
from rig.interlock.belief import Belief, Discrepancy, LogPrior
from rig.interlock.step import Point, Prediction, Verdict

__all__ = ["Guard", "Point", "Prediction", "Verdict"]

HIGHEST_PA = RANGES["P"][1]
UPPER, LOWER = 0.99, 0.01
DRY_FRICTION_PA = 3600.0  # 1 sd of dry friction, 0.1 N m, as pressure
STATIC_PA = 5000.0  # mean of what static friction holds beyond the running one, 0.14 N m, as pressure; exponential
STANDS_FOR_A_REASON = 0.01  # a rotor that stands where so few would is stuck, or its tachometer is dead
DISCREPANCY = Discrepancy(sd=0.04, length=float(np.log(2.0)))
LEAST_LOG_SD, LEAST_SD_RAD_S = 0.003, 0.1  # no reading counts for more; ripple and stiction are not modelled to 1 rpm
TURNING_RAD_S = 0.2  # 2 rpm: below, the rotor stands
MOST_POINTS = 100  # the latest
SAME_SPEED = 0.005  # share by which a single reading may differ from its plateau's mean
DRAWS = 512
GAUGE_NODES_BAR = np.array([0.08, 0.12, 0.16, 0.2, 0.25, 0.3, 0.4, 0.55, 0.8, 1.2, 1.8, 3.0, 5.0])  # straight between
FLOOR_NM = 1e-3  # a torque below has no logarithm worth having
F_SHARES = np.array([0.002, 0.2, 0.4, 0.6, 0.8, 0.998])  # quantiles of f for which the curves are solved
F_ROUNDS = 4  # f from the torque from f: a round gains a digit or two, for the torque hardly depends on f
NEAREST_PA = 1000.0  # no pressure is counted as nearer to the ambient's than this


class _Knowledge(NamedTuple):
    """What the points say: log f and weight of each draw, and the belief they come from, if there are any."""

    log_f: np.ndarray
    weights: np.ndarray
    held: Belief | None
    place: np.ndarray


class Guard:
    """Predicts the speed of a motor before it is there.

    `motor`: with the priors of its file, and the room's state as far as it is known.
    `limit_rpm`: highest speed [rpm]; the motor's own when left out.
    `gauge_sd_pa`: 1-sigma bias of the pressure gauge [Pa].
    `level_sd_pa`: how far the pressure may be from the one ordered, overshoot included, 1 sigma [Pa].
    """

    def __init__(
        self, motor: Motor, limit_rpm: float | None = None, gauge_sd_pa: float = 2000.0, level_sd_pa: float = 1000.0
    ) -> None:
        self.motor = motor
        self.limit_rpm = motor["speed_limit"].value if limit_rpm is None else limit_rpm
        self._ambient_pa = motor.si("ambient_pressure")
        self._nodes = np.minimum(self._ambient_pa + GAUGE_NODES_BAR * BAR, HIGHEST_PA)
        self._gas, self._readings = steady.gas_table(motor, self._nodes), motor.readings.vector()
        self._prior = _log_prior(motor)
        others = [name for name in QUANTITIES if motor[name].prior is not None and name != "f_overall"]
        from scipy.stats import qmc  # a third of a second, which commands that draw nothing are spared

        uniform = np.clip(qmc.Sobol(len(others) + 3, seed=20).random(DRAWS), 1e-9, 1.0 - 1e-9)
        self._share, normal = uniform[:, 0], ndtri(uniform[:, 1:])
        self._shift_pa = normal[:, 0] * np.hypot(gauge_sd_pa, DRY_FRICTION_PA)
        self._off_pa = normal[:, 1] * level_sd_pa
        self._sets = np.tile(motor.vector(), (DRAWS, 1))
        for column, name in enumerate(others, start=2):
            quantity = motor.quantity(name)
            values = np.clip(_of_prior(motor, name, normal[:, column]), quantity.low, quantity.high)
            self._sets[:, list(QUANTITIES).index(name)] = values * quantity.to_si
        self._log_f = self._prior.quantiles(F_SHARES)
        solved = np.array([self._solved(log_f) for log_f in self._log_f])  # shape (n_f, n_draws, n_nodes, columns)
        running = solved[..., steady.STATUS] == steady.RUNNING
        self._lowest = np.minimum(np.argmax(running, axis=2), self._nodes.size - 2)  # node that still runs
        speed = np.where(running, solved[..., steady.SPEED_OUT], 0.0)
        self._curves = speed * np.exp(self._log_f)[:, None, None]  # torque that f has to take
        self._known: tuple[tuple[Point, ...], _Knowledge] | None = None

    def predict(self, level_pa_abs: float, points: Sequence[Point]) -> Prediction:
        """The speed at a level.

        `points`: the plateaus so far; none: what the priors say.
        Raises SafetyError when the level or a point is no pressure at all, or beyond the model's reach.
        """
        self._check(level_pa_abs, points)
        if level_pa_abs <= self._ambient_pa:
            return Prediction(0.0, 0.0, 0.0, f"{level_pa_abs / BAR:.2f} bar abs: vented, 0 rpm")
        known = self._knowledge(tuple(points[-MOST_POINTS:]))
        torque, _ = self._torque(known.log_f, level_pa_abs + self._off_pa[:, None])
        speeds = np.maximum(torque[:, 0], 0.0) / np.exp(known.log_f) * RPM
        log_mean, log_sd = np.zeros(DRAWS), np.full(DRAWS, DISCREPANCY.sd)
        if known.held is not None:
            towards = DISCREPANCY.covariance(known.place, self._place(np.array([level_pa_abs])))[:, 0]
            log_mean, log_sd = belief.discrepancy_at(known.held, known.log_f, towards, DISCREPANCY)
        mean = float(known.weights @ (speeds * np.exp(log_mean + 0.5 * log_sd**2)))
        upper, lower = (belief.quantile(speeds, known.weights, log_mean, log_sd, share) for share in (UPPER, LOWER))
        text = f"{level_pa_abs / BAR:.2f} bar abs: {mean:.0f} rpm expected, 99 % below {upper:.0f} rpm"
        return Prediction(mean, upper, lower, text)

    def friction(self, points: Sequence[Point]) -> tuple[float, float]:
        """Mean and standard deviation of f_overall after the plateaus so far [N m s]."""
        known = self._knowledge(tuple(points[-MOST_POINTS:]))
        f = np.exp(known.log_f)
        mean = float(known.weights @ f)
        return mean, float(np.sqrt(known.weights @ (f - mean) ** 2))

    def verdict(self, level: float, points: Sequence[Point]) -> Verdict:
        """Whether a level may be ordered next."""
        stuck = self._stuck(level, points)
        if stuck:
            return Verdict(False, stuck, self._ambient_pa)
        if level > HIGHEST_PA:
            reach = HIGHEST_PA / BAR
            text = f"{level / BAR:.2f} bar abs is not allowed: the model that predicts the speed ends at {reach:g} bar"
            return Verdict(False, text, self.highest_pa(points))
        expected = self.predict(level, points)
        if expected.upper99_rpm <= self.limit_rpm:
            return Verdict(True, f"{expected.text}, limit {self.limit_rpm:g} rpm", level)
        highest = self.highest_pa(points)
        known = len(_turning(points))
        after = f"from {known} plateau{'s' if known > 1 else ''}" if known else "before the first plateau"
        text = (
            f"{level / BAR:.2f} bar abs is not yet allowed; the speed there could reach {expected.upper99_rpm:.0f} "
            f"rpm, limit {self.limit_rpm:g} rpm ({expected.mean_rpm:.0f} rpm expected {after}). Up to "
            f"{np.floor(highest / BAR * 100) / 100:.2f} bar abs is allowed, and a plateau there narrows the prediction"
        )
        return Verdict(False, text, highest)

    def highest_pa(self, points: Sequence[Point]) -> float:
        """The highest pressure whose upper 99 % is within the limit, to 200 Pa below. It is absolute [Pa]."""
        low, high = self._ambient_pa, HIGHEST_PA
        while high - low > 200.0:
            middle = 0.5 * (low + high)
            within = self.predict(middle, points).upper99_rpm <= self.limit_rpm
            low, high = (middle, high) if within else (low, middle)
        return low

    def _stuck(self, level: float, points: Sequence[Point]) -> str:
        """Why no higher level is safe although no speed was seen: the rotor holds, or the tachometer is dead."""
        standing = _standing(points)
        if standing is None or level <= standing.pressure_pa:
            return ""
        stuck = self._should_turn(standing, points)
        return stuck and f"{level / BAR:.2f} bar abs is not allowed: {stuck}"

    def doubt(self, points: Sequence[Point]) -> str:
        """Why the latest speeds cannot be so, as of a tachometer that has died; empty when they can.

        `points`: the plateaus so far, oldest first.
        """
        turned = max((i for i, p in enumerate(points) if _turns(p)), default=-1)
        standing = max(points[turned + 1 :], key=lambda p: p.pressure_pa, default=None)
        if standing is not None:
            return self._should_turn(standing, points)
        if len(points) < 2 or not _repeats(*points[-2:]):
            return ""
        before, last = points[-2:]
        expected, shown = self.predict(last.pressure_pa, points[:-1]), last.speed_rad_s * RPM
        if expected.lower99_rpm <= shown <= expected.upper99_rpm:
            return ""
        return (
            f"the tachometer shows {shown:.6g} rpm all the time at {last.pressure_pa / BAR:.2f} bar abs, as at "
            f"{before.pressure_pa / BAR:.2f} bar abs before; check that its display does not hang"
        )

    def _should_turn(self, standing: Point, points: Sequence[Point]) -> str:
        """That a rotor stands where it should turn; empty where it may well stand."""
        known = self._knowledge(_turning(points))
        if float(known.weights @ self._chances(known.log_f, standing)) >= STANDS_FOR_A_REASON:
            return ""
        return (
            f"the rotor stands at {standing.pressure_pa / BAR:.2f} bar abs, where it should turn; check that it is "
            "free and that the tachometer counts"
        )

    def _knowledge(self, points: tuple[Point, ...]) -> _Knowledge:
        """What the points say; the answer to the last question is kept."""
        if self._known is None or self._known[0] != points:
            turning = _turning(points)
            self._known = (points, self._learnt(turning) if turning else self._unlearnt(_standing(points)))
        return self._known[1]

    def _unlearnt(self, standing: Point | None) -> _Knowledge:
        """The priors. A rotor at rest tells from where on it may turn, give or take static friction; no more."""
        log_f = self._prior.quantiles(self._share)
        weights = np.ones(DRAWS) if standing is None else self._chances(log_f, standing) + 1e-12
        return _Knowledge(log_f, weights / weights.sum(), None, np.empty(0))

    def _learnt(self, points: tuple[Point, ...]) -> _Knowledge:
        pressure = np.array([p.pressure_pa for p in points])
        speed = np.array([p.speed_rad_s for p in points])
        speed_sd = np.hypot(np.array([p.speed_sd for p in points]), LEAST_SD_RAD_S)
        pressure_sd = np.array([p.pressure_sd for p in points])
        place = self._place(pressure)
        shared = DISCREPANCY.covariance(place, place)
        log_f = self._prior.quantiles(np.full(DRAWS, 0.5))
        for _ in range(F_ROUNDS):
            torque, slope = self._torque(log_f, pressure[None, :])
            torque = np.maximum(torque, FLOOR_NM)
            noise_sd = np.sqrt(LEAST_LOG_SD**2 + (speed_sd / speed) ** 2 + (slope * pressure_sd / torque) ** 2)
            held = belief.update(np.log(speed) - np.log(torque), noise_sd, shared, self._prior)
            log_f = np.clip(held.mean, self._prior.low, self._prior.high)
        log_f = belief.draw(held, self._prior, self._share)
        return _Knowledge(log_f, belief.normalised(held.log_weight), held, place)

    def _solved(self, log_f: float) -> np.ndarray:
        """Steady states of the draws at the nodes with one f, shape (n_draws, n_nodes, columns)."""
        sets = self._sets.copy()
        sets[:, F_OVERALL] = np.exp(log_f)
        return steady.solve(sets, self._readings, np.tile(self._nodes, (DRAWS, 1)), self._gas)

    def _torque(self, log_f: np.ndarray, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torque that f has to take, and its slope, at pressures of shape (n_draws or 1, n), the shift added.

        Below the lowest node that runs, the lowest piece between two that do goes on, through zero.
        """
        P = np.broadcast_to(pressure + self._shift_pa[:, None], (DRAWS, pressure.shape[1]))
        at = np.clip(np.searchsorted(self._log_f, log_f) - 1, 0, self._log_f.size - 2)
        share = ((log_f - self._log_f[at]) / (self._log_f[at + 1] - self._log_f[at]))[:, None]
        (low, low_slope), (high, high_slope) = (self._on_curve(i, P) for i in (at, at + 1))
        return low + share * (high - low), low_slope + share * (high_slope - low_slope)

    def _on_curve(self, i: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and slope on the curves of f number i of each draw."""
        k = np.arange(DRAWS)
        piece = np.searchsorted(self._nodes, P) - 1
        piece = np.clip(piece, self._lowest[i, k][:, None], self._nodes.size - 2)
        start, end = (self._curves[i[:, None], k[:, None], node] for node in (piece, piece + 1))
        slope = (end - start) / (self._nodes[piece + 1] - self._nodes[piece])
        return start + slope * (P - self._nodes[piece]), slope

    def _chances(self, log_f: np.ndarray, standing: Point) -> np.ndarray:
        """How likely each draw's rotor is to stand where it does, shape (n_draws,) [-]."""
        torque, slope = self._torque(log_f, np.array([[standing.pressure_pa]]))
        beyond = torque[:, 0] / np.maximum(
            slope[:, 0], 1e-12
        )  # the pressure from which it turns; the ripple may say more
        nearest = np.argmin(np.abs(log_f[:, None] - self._log_f), axis=1)
        lowest = self._lowest[nearest, np.arange(DRAWS)]
        turns_from = 0.5 * (self._nodes[np.maximum(lowest - 1, 0)] + self._nodes[lowest])
        beyond = np.minimum(beyond, standing.pressure_pa + self._shift_pa - turns_from)
        return np.asarray(np.exp(-np.maximum(beyond, 0.0) / STATIC_PA))

    def _place(self, pressure: np.ndarray) -> np.ndarray:
        return np.log(np.maximum(pressure - self._ambient_pa, NEAREST_PA))

    def _check(self, level: float, points: Sequence[Point]) -> None:
        if not (np.isfinite(level) and 0.0 <= level <= HIGHEST_PA):
            raise SafetyError(
                f"the guard cannot predict a speed at {level / BAR:g} bar abs; it can from 0 to 8 bar abs"
            )
        for p in points:
            figures = (p.pressure_pa, p.speed_rad_s, p.speed_sd, p.pressure_sd)
            if not all(np.isfinite(figure) and figure >= 0.0 for figure in figures) or p.pressure_pa > HIGHEST_PA:
                raise SafetyError(f"the guard cannot use this plateau: {p}; leave it out")


def _log_prior(motor: Motor) -> LogPrior:
    """What the motor's file says of f_overall before a recording, as log f."""
    parameter, quantity = motor["f_overall"], QUANTITIES["f_overall"]
    prior, centre = parameter.prior, float(np.log(parameter.value))
    if prior is not None and prior.low is not None and prior.high is not None:
        low, high = float(np.log(prior.low)), float(np.log(prior.high))
        return LogPrior(0.5 * (low + high), np.inf, low, high)
    sd = 1e-4  # no prior: the figure is held
    if prior is not None and prior.factor is not None:
        sd = float(np.log(prior.factor))
    elif prior is not None and prior.sd is not None:
        sd = prior.sd / parameter.value
    return LogPrior(centre, sd, float(np.log(quantity.low)), float(np.log(quantity.high)))


def _of_prior(motor: Motor, name: str, z: np.ndarray) -> np.ndarray:
    """Values of a parameter, in its own unit, at standard normal z."""
    parameter = motor[name]
    prior = parameter.prior
    if prior is not None and prior.sd is not None:
        return parameter.value + prior.sd * z
    if prior is not None and prior.factor is not None:
        return parameter.value * prior.factor**z
    if prior is not None and prior.low is not None and prior.high is not None:
        return prior.low * (prior.high / prior.low) ** ndtr(z)
    return np.full_like(z, parameter.value)


def _turns(point: Point) -> bool:
    return point.speed_rad_s > max(TURNING_RAD_S, 3.0 * point.speed_sd)


def _repeats(before: Point, last: Point) -> bool:
    """Whether a plateau's readings are all the same, and what the plateau before it may have ended with."""
    near = max(5.0 * before.speed_sd, SAME_SPEED * before.speed_rad_s)
    return last.speed_sd == 0.0 and abs(last.speed_rad_s - before.speed_rad_s) <= near


def _turning(points: Sequence[Point]) -> tuple[Point, ...]:
    return tuple(p for p in points if _turns(p))


def _standing(points: Sequence[Point]) -> Point | None:
    """The point of the highest pressure at which the rotor stood, if none shows it turning at that pressure or more."""
    highest = max((p for p in points if not _turns(p)), key=lambda p: p.pressure_pa, default=None)
    if highest is None or any(p.pressure_pa >= highest.pressure_pa for p in _turning(points)):
        return None
    return highest
