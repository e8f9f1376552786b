"""The second rig's bench without its noise: what is run, and what the instruments would read of it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.challenge.second_rig import concealed, instruments, marches, motor
from calibration.challenge.second_rig.concealed import Concealed
from calibration.challenge.second_rig.slots import BAR, PULSE, R_AIR

SAMPLE_S = 0.005  # between samples of a run in time
CELL_S = 0.0005  # in which a run in time is kept before it is sampled
Steady = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Plateaus:
    """Steady rows that are to be measured, arrays of shape (n,).

    Attributes
    ----------
    lines : ndarray
        Pressure at the gauge [Pa].
    clock : ndarray
        On the recording's clock [s].
    way : ndarray
        1 upwards, -1 downwards, 0 neither [-].
    locked : bool
        Whether the rotor is held.
    """

    lines: np.ndarray
    clock: np.ndarray
    way: np.ndarray
    locked: bool = False


@dataclass(frozen=True)
class Run:
    """A run in time that is to be measured: the supply opens or shuts while the speed is sampled.

    Attributes
    ----------
    line : float
        Pressure when the supply is open [Pa].
    opened : ndarray of bool, shape (n,)
        Whether the supply is open, a sample each.
    start_s : float
        On the recording's clock [s].
    angle : float
        Shaft angle at which the supply changes, within a pulse [rad].
    """

    line: float
    opened: np.ndarray
    start_s: float
    angle: float


@dataclass(frozen=True)
class Rig:
    """The motor as built, and the errors of its instruments.

    Attributes
    ----------
    nuisances : mapping of str to float
        Figures of the motor off their defaults [SI].
    errors : mapping of str to float
        ``pressure_offset_bar``, ``pressure_scale``, ``flow_offset_l_min``, ``flow_scale``, ``speed_offset_rpm`` and
        ``speed_scale``; scales less 1.
    effects : tuple of Concealed
        What is concealed.
    added_inertia : float
        Of a flywheel [kg m2].
    """

    nuisances: Mapping[str, float]
    errors: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Concealed, ...] = ()
    added_inertia: float = 0.0

    def figures(self) -> dict[str, float]:
        """Figures of the motor with the effects in them."""
        found = concealed.figures(self.nuisances, self.effects)
        found["inertia"] += self.added_inertia
        return found


@dataclass(frozen=True)
class Readings:
    """What the instruments show without noise, arrays of shape (n,).

    Attributes
    ----------
    pressure : ndarray
        Of the line, at the gauge [Pa].
    flow : ndarray
        Volume at the line's state [m3/s]; nan along a run in time.
    speed : ndarray
        Of the shaft [rad/s].
    """

    pressure: np.ndarray
    flow: np.ndarray
    speed: np.ndarray


def figures_of(rig: Rig, asked: Plateaus) -> tuple[np.ndarray, np.ndarray]:
    """Figures of the motor in each row, shape (n, k), and pressures that it gets [Pa]; see `concealed.row_figures`.

    Parameters
    ----------
    rig : Rig
        Motor and instruments.
    asked : Plateaus
        The rows.
    """
    return concealed.row_figures(rig.figures(), rig.effects, asked.clock, asked.way, asked.lines)


def marched(rows: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Speed [rad/s], mass flow [kg/s] and gas torque [N m] of plateaus, shape (n, 3).

    Parameters
    ----------
    rows : ndarray, shape (n, k)
        Figures of the motor, a row a plateau, laid out as in `slots`.
    lines : ndarray, shape (n,)
        Pressure of the line [Pa].
    """
    return _plateaus(rows.tobytes(), lines.tobytes())


def plateaus(rig: Rig, asked: Plateaus, steady: Steady = marched) -> Readings:
    """Readings of steady rows.

    Parameters
    ----------
    rig : Rig
        Motor and instruments.
    asked : Plateaus
        The rows.
    steady : callable
        What gives speed and mass flow of rows of figures at pressures of the line.
    """
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
    speed = instruments.read_speed(rig.effects, found[:, 0], asked.clock)
    return _shown(rig, asked.lines, flow, speed)


def at_rest(rig: Rig, rows: int) -> Readings:
    """Readings with the line vented and the rotor at rest.

    Parameters
    ----------
    rig : Rig
        Motor and instruments.
    rows : int
        Number of them [-].
    """
    ambient = np.full(rows, rig.figures()["ambient_pa"])
    flow = instruments.read_flow(rig.effects, np.zeros(rows), ambient, rig.figures()["inlet_k"], np.zeros(rows, bool))
    return _shown(rig, ambient, flow, np.zeros(rows))


def run(
    rig: Rig, asked: Run, dt: float = marches.STEP_S, jitter: np.ndarray | None = None, ripple: bool = True
) -> Readings:
    """Readings of a run in time; a speed is the mean since the sample before. No flow is read.

    Parameters
    ----------
    rig : Rig
        Motor and instruments.
    asked : Run
        The run.
    dt : float
        Largest step of the march [s].
    jitter : ndarray, shape (n,), optional
        How late each sample really is [s].
    ripple : bool
        Whether the pulses of single cylinders are seen; without them a small change stays small however long the run.
    """
    one = np.array([asked.start_s])
    rows, lines = concealed.row_figures(rig.figures(), rig.effects, one, np.zeros(1), np.array([asked.line]))
    p, line = rows[0], float(lines[0])
    cells = round(SAMPLE_S / CELL_S)
    opened = np.repeat(asked.opened, cells)
    angle = _angles(p.tobytes(), line, opened.tobytes(), asked.angle, dt)
    if not ripple:
        angle = _from_pulse_to_pulse(angle)
    shown = instruments.lagged(rig.effects, np.diff(angle) / CELL_S, CELL_S)
    turned = np.concatenate([[0.0], np.cumsum(shown)]) * CELL_S
    grid = np.arange(turned.size) * CELL_S
    ends = np.arange(asked.opened.size + 1) * SAMPLE_S
    if jitter is not None:
        ends[1:] += jitter
    speed = np.diff(np.interp(ends, grid, turned)) / np.diff(ends)
    clock = asked.start_s + ends[1:]
    speed = instruments.read_speed(rig.effects, speed, clock)
    ambient = p[motor.PA]
    return _shown(rig, np.where(asked.opened, asked.line, ambient), np.full(speed.size, np.nan), speed)


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
def _angles(figures: bytes, line: float, opened: bytes, angle: float, dt: float) -> np.ndarray:
    """Shaft angle at the ends of the cells of a run; kept for the same reason."""
    p, is_open = np.frombuffer(figures), np.frombuffer(opened, dtype=bool)
    if is_open[0]:
        ahead = float(np.argmin(is_open)) * CELL_S if not is_open.all() else 0.0
        y = marches.turning(p, marches.TABLE, line, marches.guess(p, line), angle, ahead, dt)
    else:
        y = motor.rest(p, marches.TABLE, angle, line, False)
    found: np.ndarray = marches.run_in_time(p, marches.TABLE, y, line, is_open, CELL_S, dt)
    found.flags.writeable = False
    return found


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


def _shown(rig: Rig, pressure: np.ndarray, flow: np.ndarray, speed: np.ndarray) -> Readings:
    """Readings with the instruments' own errors, which effects on a gauge come before."""
    e = rig.errors
    return Readings(
        instruments.read_pressure(rig.effects, pressure) * (1.0 + e.get("pressure_scale", 0.0))
        + e.get("pressure_offset_bar", 0.0) * BAR,
        flow * (1.0 + e.get("flow_scale", 0.0)) + e.get("flow_offset_l_min", 0.0) / 60_000.0,
        speed * (1.0 + e.get("speed_scale", 0.0)) + e.get("speed_offset_rpm", 0.0) * np.pi / 30.0,
    )


def without(rig: Rig, effects: Sequence[Concealed]) -> Rig:
    """The same rig with another set of effects.

    Parameters
    ----------
    rig : Rig
        The rig.
    effects : sequence of Concealed
        What is at work then.
    """
    return Rig(rig.nuisances, rig.errors, tuple(effects), rig.added_inertia)
