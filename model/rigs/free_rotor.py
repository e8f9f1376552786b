"""A rotor that nothing drives: J domega/dt = -f omega - T, the article's Eq. 25 without gas."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson

from model.effects import laws
from model.effects.effect import State
from model.effects.transient import read_with_lag
from model.rigs.state import inertia_factor, state_of

SPEED_SHARE, LEAST_SHARE = 0.01, 0.002  # a step changes the speed by so much of itself, or of the first,
ANGLE_STEP = 0.3  # rad; ... and turns the shaft no farther, where a torque follows its angle
MOST_STEPS = 100_000
# Shares of the first speed between which it is integrated: fine where little is left of it, for laws that bend there.
NODES = np.concatenate([np.linspace(1.0, 0.01, 400) ** 2, np.geomspace(1e-4, 1e-10, 121)[1:]])
MOST_ROUNDS, SETTLED_S, SETTLED_RAD = 30, 1e-9, 1e-8
FINE_STEP = 0.2  # rad, of what torques that follow the angle add to the course
MARCHED = 0.1  # share of the first speed from which on such a course is marched
MOST_DECAY = 300.0
PLACES, WEIGHTS = 0.5 * (np.polynomial.legendre.leggauss(4)[0] + 1.0), 0.5 * np.polynomial.legendre.leggauss(4)[1]
STRAIGHT = 1e-9  # share of its time constant up to which the speed is straight in time


@dataclass(frozen=True)
class Coast:
    """A coast-down, arrays of shape (n,).

    `speed`, `angle`: at the samples [rad/s], [rad].
    `reading`: speed as the tachometer has it: the mean since the sample before, with its lag [rad/s].
    """

    speed: np.ndarray
    angle: np.ndarray
    reading: np.ndarray


def coast(
    inertia: float, friction: float, time: np.ndarray, first: float, chosen: laws.Chosen, clock: float = 0.0
) -> Coast:
    """Speed and angle at the sample times.

    Time and angle are integrals over the speed, for dt = -J domega / T(omega). A torque that changes with time is taken
    at the times found before, until they stay; one that follows the angle disturbs the course. Where that will not do
    the rotor is marched in steps, in each of which the torques are their tangents at its middle.

    `inertia`: J [kg m2].
    `time`, shape (n,): increasing sample times [s].
    `first`: speed at the first sample [rad/s].
    """
    chosen = laws.switched_on(chosen)
    those = laws.members(chosen)
    J = inertia * inertia_factor(chosen)
    torques = [one for one in those if one[0].torque is not None]
    found = _by_speed(J, friction, time, first, torques, clock) if torques and first > 0.0 else None
    speed, angle = _marched(J, friction, time, first, torques, clock) if found is None else found
    mean = speed.copy()
    mean[1:] = np.diff(angle) / np.diff(time)
    return Coast(speed, angle, read_with_lag(mean, time, chosen))


@dataclass(frozen=True)
class _Course:
    """A coast-down at nodes of the speed: when [s], the speed [rad/s], the angle [rad], how fast it slows [rad/s2]."""

    t: np.ndarray
    speed: np.ndarray
    angle: np.ndarray
    slowing: np.ndarray

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speed and angle at times after the first sample [s]."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.t.size - 2)
        span = self.t[i + 1] - self.t[i]
        x = (t - self.t[i]) / span
        speed = _hermite(x, span, self.speed[i], self.speed[i + 1], -self.slowing[i], -self.slowing[i + 1])
        angle = _hermite(x, span, self.angle[i], self.angle[i + 1], self.speed[i], self.speed[i + 1])
        rests = t >= self.t[-1]  # what is left of the speed dies at once, or turns the shaft no more
        return np.where(rests, 0.0, speed), np.where(rests, self.angle[-1], angle)


def _by_speed(
    J: float, friction: float, time: np.ndarray, first: float, torques: laws.Members, clock: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Speed and angle at times without marching; None where a torque drives or nothing settles."""
    smooth = [one for one in torques if not one[0].periodic]
    course = _course(J, friction, time, first, smooth, clock)
    if course is None:
        return None
    if len(smooth) == len(torques):
        return course.at(time - time[0])
    return _disturbed(course, J, friction, time, torques, smooth, clock)


def _course(
    J: float, friction: float, time: np.ndarray, first: float, torques: laws.Members, clock: float
) -> _Course | None:
    """The coast-down by integration over the speed; None where a torque drives or times do not settle."""
    nodes = first * NODES
    cells = -np.diff(nodes)
    state = state_of(np.concatenate([nodes, (nodes[1:, None] + cells[:, None] * PLACES).ravel()]), friction)
    standing = np.zeros(state.omega.size, dtype=bool)
    since = np.zeros(nodes.size)
    changes = any(parameter.unit == "s" for effect, _ in torques for parameter in effect.parameters)
    for _ in range(MOST_ROUNDS):
        within = np.interp(-state.omega, -nodes, since)
        state.time[:] = clock + float(time[0]) + np.minimum(within, float(time[-1] - time[0]))
        total = friction * state.omega + laws.sum_of_torques(torques, state, standing)
        if not np.all(total > 0.0):
            return None
        inside = J / total[nodes.size :].reshape(cells.size, PLACES.size)
        before, since = since, np.concatenate([[0.0], np.cumsum(cells * (inside @ WEIGHTS))])
        if not changes or np.max(np.abs(since - before)[since < time[-1] - time[0]], initial=0.0) < SETTLED_S:
            break
    else:
        return None
    speeds = state.omega[nodes.size :].reshape(inside.shape)
    turned = np.concatenate([[0.0], np.cumsum(cells * ((inside * speeds) @ WEIGHTS))])
    return _Course(since, nodes, turned, total[: nodes.size] / J)


def _disturbed(
    course: _Course,
    J: float,
    friction: float,
    time: np.ndarray,
    torques: laws.Members,
    smooth: laws.Members,
    clock: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Speed and angle at times with torques that follow the angle; None where they change the course too much.

    What they add to the course obeys d(delta)/dt = -k delta + s, k the smooth torques' slope over J and s what is left;
    both are taken anew until the angle stays. The last of the speed, of which they may be a large part, is marched.
    """
    t = time - time[0]
    until = min(float(t[-1]), float(np.interp(-MARCHED * course.speed[0], -course.speed, course.t)))
    last = float(course.at(np.array([until]))[1][0])
    angles = np.linspace(0.0, last, max(math.ceil(last / FINE_STEP), 3))
    grid = np.unique(np.clip(np.interp(angles, course.angle, course.t), 0.0, until))
    omega, theta = course.at(grid)
    state, back = state_of(omega.copy(), friction, time=clock + float(time[0]) + grid), np.zeros(grid.size, dtype=bool)
    alone, slope = _with_slope(friction, smooth, state)
    rate = slope / J
    decay = np.clip(cumulative_simpson(rate, x=grid, initial=0.0), -MOST_DECAY, MOST_DECAY)
    delta, phi = np.zeros(grid.size), np.zeros(grid.size)
    for _ in range(MOST_ROUNDS):
        state.omega[:], state.angle[:] = omega + delta, theta + phi
        if not np.all(state.omega > 0.0):
            return None
        rest = (alone - friction * state.omega - laws.sum_of_torques(torques, state, back)) / J + rate * delta
        delta = np.exp(-decay) * cumulative_simpson(np.exp(decay) * rest, x=grid, initial=0.0)
        before, phi = phi, cumulative_simpson(delta, x=grid, initial=0.0)
        if np.max(np.abs(phi - before)) < SETTLED_RAD:
            break
    else:
        return None
    speed, angle = course.at(t)
    mine = t <= until
    speed[mine] += _between(t[mine], grid, delta, rest - rate * delta)
    angle[mine] += _between(t[mine], grid, phi, delta)
    if not mine.all():
        since = np.concatenate([[time[0] + until], time[~mine]])
        later, turned = _marched(J, friction, since, float(omega[-1] + delta[-1]), torques, clock, theta[-1] + phi[-1])
        speed[~mine], angle[~mine] = later[1:], turned[1:]
    return speed, angle


def _with_slope(friction: float, torques: laws.Members, state: State) -> tuple[np.ndarray, np.ndarray]:
    """What opposes the motion at a state [N m], and its slope with the speed [N m s]; the state ends a step faster."""
    omega, back = state.omega.copy(), np.zeros(state.omega.size, dtype=bool)
    step = laws.step_of(1.0) * omega + laws.step_of(0.0)
    here = friction * omega + laws.sum_of_torques(torques, state, back)
    state.omega[:] = omega + step
    return here, ((friction * state.omega + laws.sum_of_torques(torques, state, back)) - here) / step


def _between(t: np.ndarray, grid: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Values at times, by the cubics between those of a grid and their slopes."""
    i = np.clip(np.searchsorted(grid, t, side="right") - 1, 0, grid.size - 2)
    span = grid[i + 1] - grid[i]
    return _hermite((t - grid[i]) / span, span, values[i], values[i + 1], slopes[i], slopes[i + 1])


def _hermite(x: np.ndarray, h: np.ndarray, a: np.ndarray, b: np.ndarray, da: np.ndarray, db: np.ndarray) -> np.ndarray:
    """The cubic between two values with two slopes, at shares x of a span h; all of shape (n,) and any unit."""
    y = 1.0 - x
    return a * y * y * (1.0 + 2.0 * x) + b * x * x * (3.0 - 2.0 * x) + h * x * y * (da * y - db * x)


def _marched(
    J: float,
    friction: float,
    time: np.ndarray,
    first: float,
    torques: laws.Members,
    clock: float,
    turned_on: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Speed and angle at times, step by step."""
    follows = any(effect.periodic for effect, _ in torques)
    state = state_of(np.zeros(3), friction)

    def tangent_at(omega: float, theta: float, t: float) -> tuple[float, float]:
        """Slope [N m s] and constant [N m] of all that opposes the motion."""
        state.omega[:] = (omega, omega + laws.step_of(omega), omega)
        state.angle[:], state.time[:] = theta, clock + t
        T = laws.sum_of_torques(torques, state, np.zeros(3, dtype=bool))
        slope, constant, _ = laws.tangent(T[0], T[1], T[2], omega, 0.0)
        return friction + slope, constant

    t, end, omega, theta = float(time[0]), float(time[-1]), first, turned_on
    steps = []
    while t < end and omega > 0.0:
        a, c, dt = friction, 0.0, end - t
        if torques:
            a, c = tangent_at(omega, theta, t)
            most = max(SPEED_SHARE * omega, LEAST_SHARE * abs(first))
            dt = min(dt, most * J / max(abs(c + a * omega), 1e-300), ANGLE_STEP / omega if follows else math.inf)
            dt = min(max(dt, (end - float(time[0])) / MOST_STEPS), end - t)
            middle, turned, _ = _step(omega, a, c, J, 0.5 * dt)
            a, c = tangent_at(middle, theta + turned, t + 0.5 * dt) if middle > 0.0 else (a, c)
        steps.append((t, omega, theta, a, c))
        omega, turned, _ = _step(omega, a, c, J, dt)
        theta += turned
        t += dt
    return _at_times(np.array(steps or [(t, omega, theta, friction, 0.0)]), J, time)


def _at_times(steps: np.ndarray, J: float, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and angle at times, from the steps' starts, speeds, angles, slopes and constants, shape (k, 5)."""
    of = np.maximum(np.searchsorted(steps[:, 0], time, side="right") - 1, 0)
    begun, omega, theta, a, c = steps[of].T
    dt = time - begun
    straight = np.abs(a) * dt < STRAIGHT * J
    a_safe, c_safe = np.where(straight, 1.0, a), np.where(c == 0.0, 1e-300, c)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        end = np.where(straight, omega - c / J * dt, (omega + c / a_safe) * np.exp(-a_safe * dt / J) - c / a_safe)
        rests = end < 0.0
        until = np.where(straight, omega * J / c_safe, J / a_safe * np.log1p(a_safe * omega / c_safe))
        moving, end = np.where(rests, until, dt), np.where(rests, 0.0, end)
        turned = np.where(straight, omega * moving - 0.5 * c / J * moving**2, (J * (omega - end) - c * moving) / a_safe)
    return end, theta + turned


def _step(omega: float, a: float, c: float, J: float, dt: float) -> tuple[float, float, float]:
    """Speed after a time, angle turned and time in motion for J domega/dt = -a omega - c."""
    if abs(a) * dt < STRAIGHT * J:
        end = omega - c / J * dt
        moving = dt if end >= 0.0 else omega * J / c
        return max(end, 0.0), omega * moving - 0.5 * c / J * moving**2, moving
    end = (omega + c / a) * math.exp(-a * dt / J) - c / a
    moving = dt
    if end < 0.0:
        moving, end = J / a * math.log1p(a * omega / c), 0.0
    return end, (J * (omega - end) - c * moving) / a, moving
