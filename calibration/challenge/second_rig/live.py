"""The second rig carried on in a bench's time, for instruments that ask it whenever they like.

The motor is marched as everywhere here (`motor.step`). Ahead of it is a line that holds air: a regulator with a lag and
a droop, a three-way valve that takes its time, a volume. What the attributes tell is what instruments without errors of
their own would read, so that a concealed gauge or tachometer comes in front of the instrument's own errors.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.challenge.second_rig import concealed, instruments
from calibration.challenge.second_rig.bench import Rig
from calibration.challenge.second_rig.concealed import Concealed
from calibration.challenge.second_rig.machine import marches, motor
from calibration.challenge.second_rig.machine.motor import OMEGA, PA, THETA
from calibration.challenge.second_rig.machine.slots import BAR, L_MIN, R_AIR, RPM
from calibration.challenge.second_rig.supply.line import LINE, Supply, at_rest, march

NS = 1_000_000_000
SAMPLE_NS = 1_000_000  # of the shaft's angle
CHUNK_NS = 250_000_000  # in one call of the march
STEPS = 25  # of the march in a sample
METER_LAG_S = 0.2  # the flow meter's, first order
HISTORY_NS = 20_000_000
MOST_HISTORY, MOST_SETPOINTS = 60_000, 10_000
SETTLED_BAR = 1e-7

Listener = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


class Tachometer:
    """What a concealed tachometer makes of the shaft, sample after sample: the angle that its wheel seems to turn."""

    def __init__(self, effects: tuple[Concealed, ...]) -> None:
        self.effects = effects
        self.is_true = not any(
            effect.id in ("speed_scale", "speed_lag", "tachometer_slips_from_a_moment_on") for effect in effects
        )
        self.angle = self.speed = 0.0
        self._lag = next((effect for effect in effects if effect.id == "speed_lag"), None)
        cells = 0 if self._lag is None else max(1, round(self._lag.values["time_s"] * NS / SAMPLE_NS))
        if self._lag is not None and self._lag.form == "moving_average":
            cells *= 2  # so that the delay is the same
        self._past: deque[float] = deque([0.0] * (cells + 1), maxlen=cells + 1)

    def follow(self, speeds: np.ndarray, span_s: float, clock_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and speeds [rad/s] as they are seen, shape (n,).

        `speeds`, shape (n,): mean speed of the shaft in each sample [rad/s].
        `span_s`: of a sample [s].
        `clock_s`: at the start of the first [s].
        """
        shown = instruments.read_speed(self.effects, speeds, clock_s + span_s * (1.0 + np.arange(speeds.size)))
        shown = self._late(shown, span_s)
        angles = self.angle + np.cumsum(shown) * span_s
        self.angle, self.speed = float(angles[-1]), float(shown[-1])
        return angles, shown

    def _late(self, speeds: np.ndarray, span_s: float) -> np.ndarray:
        if self._lag is None:
            return speeds
        out = np.empty_like(speeds)
        kept = math.exp(-span_s / self._lag.values["time_s"])
        now = self.speed
        for k, speed in enumerate(speeds.tolist()):
            self._past.append(speed)
            if self._lag.form == "delay":
                now = self._past[0]
            elif self._lag.form == "moving_average":
                now = sum(self._past) / len(self._past)
            else:
                now = speed + (now - speed) * kept
            out[k] = now
        return out


class LivePlant:
    """Line and motor; `advance` carries them on, the attributes tell how they stand.

    `rig`: the motor as built, and what is concealed; the instruments' own errors are not taken from it.
    `line`: figures of a bench's line: ``regulator_lag_s``, ``regulator_gain``, ``regulator_droop_bar_min_l``,
        ``line_volume_l``, ``valve_time_s``, ``valve_area_mm2``; the instruments read what else there is of it.
    """

    def __init__(self, rig: Rig, line: Any, room_k: float) -> None:
        self.line, self.effects = line, rig.effects
        self._base = rig.figures() | {"ambient_k": room_k}
        self.room_k, self.inlet_k = room_k, self._base["inlet_k"]
        self.time_ns = 0
        self._begun_ns: int | None = None
        self.ambient_bar = self.target_bar = self._base["ambient_pa"] / BAR
        self.listeners: list[Listener] = []
        self.setpoints: deque[tuple[float, float]] = deque([(0.0, self.ambient_bar)], maxlen=MOST_SETPOINTS)
        self.history: deque[tuple[float, float, float, float]] = deque(maxlen=MOST_HISTORY)
        self._next_history_ns = 0
        self._way = 0.0  # 1 once the set-point has gone up, -1 down
        p = np.array(list(self._base.values()))
        self._y = motor.rest(p, marches.TABLE, 0.0, p[PA], False)
        self._s = at_rest(p)
        self._figures = Supply.of(
            line.regulator_lag_s,
            line.regulator_droop_bar_min_l,
            line.valve_time_s,
            line.valve_area_mm2,
            line.valve_area_mm2,
            line.line_volume_l,
        ).figures()
        self._passed_kg_s = 0.0  # through the meter, with its lag
        self._float_m3_s = 0.0  # of a flow meter whose float sticks
        self._tachometer = Tachometer(rig.effects)
        self._sticks = next((e.values["half_width_m3_s"] for e in rig.effects if e.id == "flow_float_sticks"), None)
        self._meter = tuple(e for e in rig.effects if e.id != "flow_float_sticks")

    @property
    def line_bar(self) -> float:
        """Pressure of the line, whatever its gauge reads, absolute [bar]."""
        return float(self._s[LINE]) / BAR

    @property
    def pressure_bar(self) -> float:
        """What the gauge makes of it [bar]."""
        return float(instruments.read_pressure(self.effects, self._s[LINE : LINE + 1].copy())[0]) / BAR

    @property
    def flow_kg_s(self) -> float:
        """What the meter makes of the flow [kg/s]."""
        density = self._s[LINE] / (R_AIR * self.inlet_k)
        volume = self._passed_kg_s / density if self._sticks is None else self._float_m3_s
        shown = instruments.read_flow(
            self._meter, np.array([volume]), self._s[LINE : LINE + 1].copy(), self.inlet_k, np.zeros(1, dtype=bool)
        )
        return float(shown[0] * density)

    @property
    def speed_rpm(self) -> float:
        """Instantaneous speed, as the tachometer's wheel turns."""
        return float(self._y[OMEGA] if self._tachometer.is_true else self._tachometer.speed) * RPM

    @property
    def angle_rad(self) -> float:
        """Angle of the shaft since the start, as the tachometer's wheel turns."""
        return float(self._y[THETA] if self._tachometer.is_true else self._tachometer.angle)

    @property
    def vented(self) -> bool:
        """Whether the valve is driven to the vent: no gauge pressure is ordered."""
        return self.target_bar <= self.ambient_bar

    def order(self, pressure_bar_abs: float) -> None:
        """Order a pressure, now. `pressure_bar_abs`: absolute [bar]; the ambient's or less vents the line."""
        gauge = max(0.0, pressure_bar_abs - self.ambient_bar) * self.line.regulator_gain
        target = self.ambient_bar + gauge
        if abs(target - self.target_bar) > SETTLED_BAR:
            self._way = math.copysign(1.0, target - self.target_bar)
            self.target_bar = target
            if self._begun_ns is None and not self.vented:
                self._begun_ns = self.time_ns
            self.setpoints.append((self.time_ns / NS, target))

    def volume_flow_l_min(self, pressure_bar_abs: float, temperature_k: float) -> float:
        """The present mass flow as a volume flow at a state."""
        return self.flow_kg_s * R_AIR * temperature_k / (pressure_bar_abs * BAR) * L_MIN

    def advance(self, to_ns: int) -> None:
        """Carry line and motor on to a time; an earlier one changes nothing. `to_ns`: time of the bench [ns]."""
        while self.time_ns < to_ns:
            self._carry_on(min(to_ns, self.time_ns + CHUNK_NS))

    def _carry_on(self, to_ns: int) -> None:
        span_ns = to_ns - self.time_ns
        count = max(1, round(span_ns / SAMPLE_NS))
        span_s = span_ns / count / NS
        # What goes by the time counts from the first pressure: a bench stands for a while before anybody looks.
        clock_s = 0.0 if self._begun_ns is None else (self.time_ns - self._begun_ns) / NS
        rows, lines = concealed.row_figures(
            self._base, self.effects, np.array([clock_s]), np.array([self._way]), np.zeros(1)
        )
        before = self.angle_rad, self.speed_rpm / RPM
        start_rad = float(self._y[THETA])
        target, opened, dt = self.target_bar * BAR, np.full(count, not self.vented), span_s / STEPS
        samples = march(
            rows[0], marches.TABLE, self._y, self._s, self._figures, target, opened, -lines[0], STEPS, dt, False
        )
        if not np.all(np.isfinite(samples[-1])):
            raise ArithmeticError("the second rig's march failed: are the figures of its line physical?")
        angles, speeds = samples[:, 0], samples[:, 1]
        if not self._tachometer.is_true:
            means = np.diff(angles, prepend=start_rad) / span_s
            angles, speeds = self._tachometer.follow(means, span_s, clock_s)
        start_ns, self.time_ns = self.time_ns, to_ns
        self._meters(samples, span_s, start_ns, speeds)
        times_ns = start_ns + np.arange(count + 1) * (span_s * NS)
        seen = np.concatenate([[before[0]], angles]), np.concatenate([[before[1]], speeds])
        for listener in self.listeners:
            listener(times_ns, *seen)

    def _meters(self, samples: np.ndarray, span_s: float, start_ns: int, speeds: np.ndarray) -> None:
        """The flow meter's lag, its float where it sticks, and the history; vented, nothing passes the meter."""
        share = -math.expm1(-span_s / METER_LAG_S)
        shut = self.vented
        for k, (line_pa, flow) in enumerate(samples[:, 2:].tolist()):
            self._passed_kg_s += ((0.0 if shut else flow) - self._passed_kg_s) * share
            if self._sticks is not None:
                volume = self._passed_kg_s * R_AIR * self.inlet_k / line_pa
                self._float_m3_s = min(max(self._float_m3_s, volume - self._sticks), volume + self._sticks)
            time_ns = start_ns + int((k + 1) * span_s * NS)
            if time_ns >= self._next_history_ns:
                self._next_history_ns = time_ns + HISTORY_NS
                pressure = instruments.read_pressure(self.effects, np.array([line_pa]))
                speed = float(speeds[k]) * RPM
                self.history.append((time_ns / NS, float(pressure[0]) / BAR, speed, self._passed_kg_s))
