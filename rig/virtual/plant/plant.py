"""The air line and the motor of the virtual bench: the transient model, carried on from wherever it was.

The truth is the motor's file with the parameters that the bench file's ``[virtual.truth]`` changes. The line's
pressure follows the regulator's set-point as a first-order lag; a set-point of zero opens the dump valve, which is
faster. A line that holds air fills and empties by its mass balance instead (`air_line`).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from configs.units import BAR
from model.gas.air import gas_constant, water_fraction
from model.gas.cylinder import gas_state
from model.layout import RPM
from model.motor import Motor
from model.solvers.crank_angle import M_IN, OMEGA, P0, THETA
from model.solvers.transient import DONE, Supply, integrate, rest_state
from rig.readings import NS
from rig.virtual.plant.air_line import AirLine
from rig.virtual.plant.truth import LineTruth, Listener

SAMPLE_NS = 1_000_000  # of the shaft's angle: between two samples it is a cubic
SPAN_NS = 10_000_000  # the line's pressure is constant for so long
CHUNK_NS = 250_000_000  # in one call of the model
# Where the line holds air, motor and line take turns: for so long while the pressure moves, and where it stands.
FINE_NS, COARSE_NS = 2_000_000, 10_000_000
STANDS_BAR = 1e-4  # in a turn
SETTLED_BAR = 1e-7
PULSE_S = 0.005  # of the motor's draught: what the line feels of it
METER_LAG_S = 0.2  # the flow meter's, first order; the motor draws air in pulses
HISTORY_NS = 20_000_000
MOST_HISTORY = 60_000
MOST_GASES = 1000
MOST_SETPOINTS = 10_000
LEAST_VOLUME_L = 0.01  # of a line that holds air


class Plant:
    """The line and the motor; `advance` carries them on, the attributes tell how they stand."""

    def __init__(self, motor: Motor, line: LineTruth | None = None) -> None:
        self.motor = motor
        self.line = line or LineTruth()
        self.time_ns = 0
        self.ambient_bar = motor.si("ambient_pressure") / BAR
        self.room_k, self.inlet_k = motor.si("ambient_temperature"), motor.si("inlet_temperature")
        self.pressure_bar = self.ambient_bar  # absolute, at the inlet
        self.target_bar = self.ambient_bar
        self.flow_kg_s = 0.0  # through the meter, with its lag
        self.state = rest_state(motor)
        self.listeners: list[Listener] = []
        # time [s] and pressure ordered [bar abs]
        self.setpoints: deque[tuple[float, float]] = deque([(0.0, self.ambient_bar)], maxlen=MOST_SETPOINTS)
        # time [s], pressure [bar abs], speed [rpm], flow [kg/s]
        self.history: deque[tuple[float, float, float, float]] = deque(maxlen=MOST_HISTORY)
        self._next_history_ns = 0.0
        self._parameters, self._readings = motor.vector(), motor.readings.vector()
        self._gases: dict[float, np.ndarray] = {}  # by pressure [Pa]
        # where the pressure is taken for vented: there an open inlet holds what a vented one does
        drops = (motor.si("inlet_pressure_drop") + motor.si("outlet_pressure_drop")) / BAR
        self._vented_bar = self.ambient_bar + drops
        moist = water_fraction(
            motor.si("ambient_temperature"), motor.si("ambient_pressure"), motor.si("relative_humidity")
        )
        self.gas_constant = float(gas_constant(moist))
        self._taken_kg_s = 0.0  # by the motor, over the time of a pulse
        self._turn_ns = FINE_NS
        self._air = None if not self.line.holds_air else self._air_line()

    @property
    def line_bar(self) -> float:
        """Pressure of the line, whatever its gauge reads, absolute."""
        return self.pressure_bar

    @property
    def speed_rpm(self) -> float:
        """Instantaneous speed."""
        return float(self.state[OMEGA]) * RPM

    @property
    def angle_rad(self) -> float:
        """Angle of the shaft since the start."""
        return float(self.state[THETA])

    @property
    def vented(self) -> bool:
        """Whether the dump valve is open: no gauge pressure is ordered."""
        return self.target_bar <= self.ambient_bar

    def order(self, pressure_bar_abs: float) -> None:
        """Order a pressure, now. `pressure_bar_abs`: absolute [bar]; the ambient's or less opens the dump valve."""
        gauge = max(0.0, pressure_bar_abs - self.ambient_bar) * self.line.regulator_gain
        target = self.ambient_bar + gauge
        if abs(target - self.target_bar) > SETTLED_BAR:
            self.target_bar = target
            self._turn_ns = FINE_NS
            self.setpoints.append((self.time_ns / NS, target))

    def volume_flow_l_min(self, pressure_bar_abs: float, temperature_k: float) -> float:
        """The present mass flow as a volume flow at a state."""
        density = pressure_bar_abs * BAR / (self.gas_constant * temperature_k)
        return self.flow_kg_s / density * 60e3

    def advance(self, to_ns: int) -> None:
        """Carry line and motor on to a time; an earlier one changes nothing. `to_ns`: time of the bench [ns]."""
        while self.time_ns < to_ns:
            self._carry_on(min(to_ns, self.time_ns + CHUNK_NS))

    def _carry_on(self, to_ns: int) -> None:
        if self._air is None:
            self._carry_over(to_ns)
            return
        while self.time_ns < to_ns:  # what the motor takes of the line is known only when it has taken it
            before = self.pressure_bar
            self._carry_over(min(to_ns, self.time_ns + self._turn_ns))
            self._turn_ns = COARSE_NS if abs(self.pressure_bar - before) < STANDS_BAR else FINE_NS

    def _carry_over(self, to_ns: int) -> None:
        span_ns = to_ns - self.time_ns
        pieces = math.ceil(span_ns / SPAN_NS)
        samples = pieces * max(1, round(span_ns / pieces / SAMPLE_NS))  # whole samples in each span
        time_s = np.linspace(0.0, span_ns / NS, samples + 1)
        supply, pressures = self._supply(pieces, span_ns / pieces / NS)
        run = self._integrate(supply, time_s)
        every = samples // pieces
        self._follow(pressures, np.diff(run[::every, 2]), span_ns / pieces, run[every::every, 1])
        start_ns, self.time_ns = self.time_ns, to_ns
        self.state[M_IN:P0] = 0.0  # counting on would lose digits
        times_ns = start_ns + time_s * NS
        for listener in self.listeners:
            listener(times_ns, run[:, 0], run[:, 1])

    def _integrate(self, supply: list[Supply], time_s: np.ndarray) -> np.ndarray:
        """`solvers.transient.simulate`, carried on; so often called that what does not change is worked out once."""
        samples = np.empty((time_s.size, 6))
        status, _, _ = integrate(
            self.state,
            0.0,
            np.array([span.start_s for span in supply]),
            np.array([span.pressure_pa for span in supply]),
            np.array([float(span.is_open) for span in supply]),
            time_s,
            samples,
            np.empty(0),
            self._parameters,
            self._gas(round(max(span.pressure_pa for span in supply), -1 if self._air is None else -2)),
            self._readings,
            1,
        )
        if status != DONE:
            raise ArithmeticError(f"the motor's model failed (status {status}): is the truth of the bench physical?")
        return samples

    def _gas(self, pressure_pa: float) -> np.ndarray:
        gas = self._gases.get(pressure_pa)
        if gas is None:
            gas = gas_state(self._parameters, pressure_pa, self._readings)
            if len(self._gases) >= MOST_GASES:
                self._gases.clear()
            self._gases[pressure_pa] = gas
        return gas

    def _supply(self, pieces: int, piece_s: float) -> tuple[list[Supply], list[float]]:
        """The line over the next spans, each at the pressure of its middle, and the pressure at the end of each."""
        if self._air is not None:
            return self._from_air(self._air, pieces * piece_s)
        lag_s = self.line.vent_lag_s if self.vented else self.line.regulator_lag_s
        supply: list[Supply] = []
        ends: list[float] = []
        pressure = self.pressure_bar
        for piece in range(pieces):
            away = pressure - self.target_bar
            middle = self.target_bar + away * math.exp(-0.5 * piece_s / lag_s)
            is_open = middle > self._vented_bar
            last = supply[-1] if supply else None
            if last is None or last.is_open != is_open or abs(last.pressure_pa - middle * BAR) > SETTLED_BAR * BAR:
                supply.append(Supply(piece * piece_s, middle * BAR, is_open))
            pressure = self.target_bar + away * math.exp(-piece_s / lag_s)
            if abs(pressure - self.target_bar) < SETTLED_BAR:
                pressure = self.target_bar
            ends.append(pressure)
        self.pressure_bar = pressure
        return supply, ends

    def _air_line(self) -> AirLine:
        line = self.line
        volume_l = max(line.line_volume_l, LEAST_VOLUME_L)
        gas = self.gas_constant * self.inlet_k
        droop = line.regulator_droop_bar_min_l
        return AirLine(
            volume_l, line.valve_time_s, line.valve_area_mm2, line.regulator_lag_s, droop, self.ambient_bar, gas
        )

    def _from_air(self, air: AirLine, span_s: float) -> tuple[list[Supply], list[float]]:
        """The same over one short span, from the mass balance."""
        middle = air.step(self.target_bar, not self.vented, self._taken_kg_s, span_s)
        self.pressure_bar = air.pressure_bar
        return [Supply(0.0, middle * BAR, middle > self._vented_bar)], [air.pressure_bar]

    def _follow(self, pressures: list[float], passed_kg: np.ndarray, piece_ns: float, speeds: np.ndarray) -> None:
        """Keep what the spans have shown; with the dump valve open nothing passes the meter."""
        for piece, pressure in enumerate(pressures):
            taken = float(passed_kg[piece]) / piece_ns * NS
            self._taken_kg_s += (taken - self._taken_kg_s) * -math.expm1(-piece_ns / NS / PULSE_S)
            flow = 0.0 if self.vented else taken
            self.flow_kg_s += (flow - self.flow_kg_s) * -math.expm1(-piece_ns / NS / METER_LAG_S)
            time_ns = self.time_ns + (piece + 1) * piece_ns
            if time_ns >= self._next_history_ns:
                self._next_history_ns = time_ns + HISTORY_NS
                self.history.append((time_ns / NS, pressure, float(speeds[piece]) * RPM, self.flow_kg_s))
