"""The second rig's bench without its noise: what is run, and what the instruments would read of it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.challenge.second_rig import concealed, instruments
from calibration.challenge.second_rig.concealed import Concealed
from calibration.challenge.second_rig.machine import marches, motor
from calibration.challenge.second_rig.machine.slots import BAR, L_MIN, PULSE, R_AIR
from calibration.challenge.second_rig.supply import line
from calibration.challenge.second_rig.supply.line import Supply
from calibration.challenge.second_rig.supply.loaded import under_load

SAMPLE_S = 0.005  # between samples of a run in time
CELL_S = 0.0005  # in which a run in time is kept before it is sampled
Steady = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Plateaus:
    """Steady rows that are to be measured, arrays of shape (n,)."""

    lines: np.ndarray
    clock: np.ndarray
    way: np.ndarray
    locked: bool = False


@dataclass(frozen=True)
class Run:
    """A run in time that is to be measured: the supply opens or shuts while the speed is sampled.

    `line`: what the regulator is set to; with an ideal supply, the line's pressure when it is open [Pa].
    `opened`, shape (n,): whether the valve is driven towards the regulator, a sample of `SAMPLE_S` each.
    `start_s`: on the recording's clock [s].
    `angle`: shaft angle at which the supply changes, within a pulse [rad].
    """

    line: float
    opened: np.ndarray
    start_s: float
    angle: float


@dataclass(frozen=True)
class Rig:
    """The motor as built, and the errors of its instruments.

    `nuisances`: figures of the motor off their defaults [SI].
    `errors`: ``pressure_offset_bar``, ``pressure_scale``, ``flow_offset_l_min``, ``flow_scale``, ``speed_offset_rpm``
        and ``speed_scale``; scales less 1.
    `added_inertia`: of a flywheel [kg m2].
    `supply`: the line; None where the pressure steps.
    """

    nuisances: Mapping[str, float]
    errors: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Concealed, ...] = ()
    added_inertia: float = 0.0
    supply: Supply | None = None

    def figures(self) -> dict[str, float]:
        """Figures of the motor with the effects in them."""
        found = concealed.figures(self.nuisances, self.effects)
        found["inertia"] += self.added_inertia
        return found


@dataclass(frozen=True)
class Readings:
    """What the instruments show without noise, arrays of shape (n,).

    `flow`: volume at the line's state [m3/s]; nan along a run in time.
    """

    pressure: np.ndarray
    flow: np.ndarray
    speed: np.ndarray


@dataclass(frozen=True)
class History:
    """A run in time as it goes, at the ends of cells of `CELL_S`, arrays of shape (n + 1,).

    `turned`: angle by which the tachometer's wheel seems to have turned [rad].
    """

    turned: np.ndarray
    pressure: np.ndarray


def figures_of(rig: Rig, asked: Plateaus) -> tuple[np.ndarray, np.ndarray]:
    """Figures of the motor in each row, shape (n, k), and pressures that it gets [Pa]; see `concealed.row_figures`."""
    return concealed.row_figures(rig.figures(), rig.effects, asked.clock, asked.way, asked.lines)


def marched(rows: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Speed [rad/s], mass flow [kg/s] and gas torque [N m] of plateaus, shape (n, 3)."""
    return _plateaus(rows.tobytes(), lines.tobytes())


def plateaus(rig: Rig, asked: Plateaus, steady: Steady = marched) -> Readings:
    """Readings of steady rows. `steady`: what gives speed and mass flow of rows of figures at pressures of the line."""
    rows, lines = figures_of(rig, asked)
    inlet_k = rows[:, motor.TIN]
    if asked.locked:
        leak = np.array([motor.leak_flow(row, line) for row, line in zip(rows, lines, strict=True)])
        found = np.column_stack([np.zeros(lines.size), leak])
    else:
        found = steady(rows, lines)
    volume = found[:, 1] * R_AIR * inlet_k / lines
    follows = np.concatenate([[False], np.diff(asked.clock) < 120.0])
    flow = instruments.read_flow(rig.effects, volume, lines, float(inlet_k[0]), follows)
    speed = shown_speed(rig, found[:, 0], asked.clock)
    return Readings(shown_pressure(rig, asked.lines), shown_flow(rig, flow), speed)


def at_rest(rig: Rig, rows: int) -> Readings:
    """Readings with the line vented and the rotor at rest."""
    ambient = np.full(rows, rig.figures()["ambient_pa"])
    flow = instruments.read_flow(rig.effects, np.zeros(rows), ambient, rig.figures()["inlet_k"], np.zeros(rows, bool))
    own = rig.errors.get("speed_offset_rpm", 0.0) * np.pi / 30.0
    return Readings(shown_pressure(rig, ambient), shown_flow(rig, flow), np.full(rows, own))


def delivered(rig: Rig, asked: Plateaus) -> np.ndarray:
    """Pressure of the line in steady rows [Pa], of what the regulator is set to: it droops, and the valve takes some.

    `asked`: the rows, the regulator's setting in place of the line's pressure.
    """
    if rig.supply is None:
        return asked.lines
    p = np.array(list(rig.figures().values()))
    return np.array([under_load(p, rig.supply, float(target), asked.locked)[0] for target in asked.lines])


def history(rig: Rig, asked: Run, dt: float = marches.STEP_S, ripple: bool = True) -> History:
    """What a run does in time, as tachometer and gauge are given it.

    `ripple`: whether the pulses of single cylinders are seen; without them a small change stays small however long the
        run.
    """
    moment = np.array([asked.start_s])
    rows, lines = concealed.row_figures(rig.figures(), rig.effects, moment, np.zeros(1), np.array([asked.line]))
    p, opened = rows[0], np.repeat(asked.opened, round(SAMPLE_S / CELL_S))
    less = asked.line - float(lines[0])
    found = _marched_run(p.tobytes(), asked.line, less, opened.tobytes(), asked.angle, dt, rig.supply)
    angle = found[:, 0] if ripple else _from_pulse_to_pulse(found[:, 0])
    shown = instruments.lagged(rig.effects, np.diff(angle) / CELL_S, CELL_S)
    return History(np.concatenate([[0.0], np.cumsum(shown)]) * CELL_S, found[:, 1])


def run(rig: Rig, asked: Run, dt: float = marches.STEP_S, jitter: np.ndarray | None = None) -> Readings:
    """Readings of a run at every `SAMPLE_S`; a speed is the mean since the sample before. No flow is read.

    `jitter`, shape (n,), optional: how late each sample really is [s].
    """
    found = history(rig, asked, dt)
    grid = np.arange(found.turned.size) * CELL_S
    ends = np.arange(asked.opened.size + 1) * SAMPLE_S
    if jitter is not None:
        ends[1:] += jitter
    speed = np.diff(np.interp(ends, grid, found.turned)) / np.diff(ends)
    pressure = np.interp(ends[1:], grid, found.pressure)
    nothing = np.full(speed.size, np.nan)
    return Readings(shown_pressure(rig, pressure), nothing, shown_speed(rig, speed, asked.start_s + ends[1:]))


@functools.lru_cache(maxsize=16)
def _plateaus(rows: bytes, lines: bytes) -> np.ndarray:
    """Marched plateaus; kept, because what changes an instrument alone leaves the motor as it was."""
    pressures = np.frombuffer(lines)
    asked = np.column_stack([pressures, np.frombuffer(rows).reshape(pressures.size, -1)])
    once, back = np.unique(asked, axis=0, return_inverse=True)
    found = marches.steady(np.ascontiguousarray(once[:, 1:]), once[:, 0].copy())[back.reshape(-1)]
    found.flags.writeable = False
    return found


@functools.lru_cache(maxsize=32)
def _marched_run(
    figures: bytes, target: float, less: float, opened: bytes, angle: float, dt: float, supply: Supply | None
) -> np.ndarray:
    """Shaft angle and line's pressure at the ends of the cells of a run; kept for the same reason."""
    p, is_open = np.frombuffer(figures), np.frombuffer(opened, dtype=bool)
    shuts = int(np.argmin(is_open)) if is_open[0] and not is_open.all() else 0
    if supply is None:
        y = _turning(p, target - less, angle, shuts * CELL_S, dt) if is_open[0] else _resting(p, angle)
        angles = marches.run_in_time(p, marches.TABLE, y, target - less, is_open, CELL_S, dt)
        pressure = np.where(is_open, target, p[motor.PA])
        found = np.column_stack([angles, np.concatenate([pressure[:1], pressure])])
    else:
        y, s = _resting(p, angle), line.at_rest(p)
        if is_open[0]:
            s[line.LINE], s[line.REGULATED] = under_load(p, supply, target)
            s[line.OPENED] = 1.0
            y = _turning(p, s[line.LINE] - less, angle, shuts * CELL_S, dt)
        steps, begins = max(1, math.ceil(CELL_S / dt - 1e-9)), np.array([[y[motor.THETA], s[line.LINE]]])
        ends = line.march(p, marches.TABLE, y, s, supply.figures(), target, is_open, less, steps, CELL_S / steps, True)
        found = np.vstack([begins, ends[:, [0, 2]]])
    found.flags.writeable = False
    return found


def _resting(p: np.ndarray, angle: float) -> np.ndarray:
    """A motor at rest in a vented line."""
    return motor.rest(p, marches.TABLE, angle, p[motor.PA], False)


def _turning(p: np.ndarray, feed: float, angle: float, ahead: float, dt: float) -> np.ndarray:
    """A motor that turns steadily, and comes to an angle some time ahead."""
    return marches.turning(p, marches.TABLE, feed, marches.guess(p, feed), angle, ahead, dt)


def _from_pulse_to_pulse(angle: np.ndarray) -> np.ndarray:
    """The angle smoothly through its values at whole pulses, from the start of the motion until it turns back [rad]."""
    turns = int(np.argmax(angle)) + 1
    moving = int(np.argmax(angle > angle[0] + 1e-3))
    whole = np.arange(np.ceil(angle[moving] / PULSE), np.floor(angle[turns - 1] / PULSE) + 1.0) * PULSE
    cells = np.arange(moving, turns)
    if whole.size < 3 or cells.size < 3:
        return angle
    times = np.interp(whole, np.maximum.accumulate(angle[cells]) + 1e-12 * cells, cells)
    inside = np.arange(math.ceil(times[0]), math.floor(times[-1]) + 1)
    smooth = angle.copy()
    smooth[inside] = PchipInterpolator(times, whole)(inside)
    return smooth


def shown_pressure(rig: Rig, pressure: np.ndarray) -> np.ndarray:
    """What the gauge shows of a pressure [Pa]: effects on it come before its own errors."""
    e = rig.errors
    found = instruments.read_pressure(rig.effects, pressure)
    return found * (1.0 + e.get("pressure_scale", 0.0)) + e.get("pressure_offset_bar", 0.0) * BAR


def shown_speed(rig: Rig, speed: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """What the tachometer shows of a speed [rad/s]: effects on it come before its own errors.

    `speed`, shape (n,): of the shaft [rad/s].
    """
    e = rig.errors
    found = instruments.read_speed(rig.effects, speed, clock)
    return found * (1.0 + e.get("speed_scale", 0.0)) + e.get("speed_offset_rpm", 0.0) * np.pi / 30.0


def shown_flow(rig: Rig, flow: np.ndarray) -> np.ndarray:
    """What the flow meter shows of a flow that effects have changed [m3/s].

    `flow`, shape (n,): volume at the line's state [m3/s].
    """
    e = rig.errors
    return flow * (1.0 + e.get("flow_scale", 0.0)) + e.get("flow_offset_l_min", 0.0) / L_MIN


def without(rig: Rig, effects: Sequence[Concealed]) -> Rig:
    """The same rig with another set of effects."""
    return replace(rig, effects=tuple(effects))
