"""The transient model driven with a recorded pressure: what speed and flow should have been, in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from configs.units import BAR, ZERO_C
from model.motor import Motor
from model.operation.performance import HIGHEST_PA, OperatingPointError
from model.solvers.transient import Supply, simulate

VENTED_PA = 2000.0  # above the ambient; below that the line counts as vented
STILL_PA = 500.0  # from one reading to the next, below which a line is taken to stand still
PIECE_S = 0.01  # of a line that moves
LONGEST_GAP_S = 2.0  # without a pressure: what is simulated there means nothing


@dataclass(frozen=True)
class Simulated:
    """Speed and flow as the model has them, arrays of shape (n,).

    `time_s`: ends of the intervals [s].
    `speed_rad_s`: mean over each interval [rad/s].
    `flow_m3_s`: likewise, at the line's pressure and temperature [m3/s]; nan where the line is vented.
    """

    time_s: np.ndarray
    speed_rad_s: np.ndarray
    flow_m3_s: np.ndarray


def in_room(
    motor: Motor, pressure_bar_abs: float | None, temperature_c: float | None, relative_humidity: float | None
) -> Motor:
    """The motor in the room of a run; what was not recorded keeps the motor's default.

    `motor`: as configured.
    `pressure_bar_abs`, `temperature_c`, `relative_humidity`: of the room [bar], [degree Celsius], [0 to 1].
    """
    values: dict[str, float] = {}
    if pressure_bar_abs is not None:
        values["ambient_pressure"] = pressure_bar_abs * BAR
    if temperature_c is not None:
        values["ambient_temperature"] = values["inlet_temperature"] = temperature_c + ZERO_C
    if relative_humidity is not None:
        values["relative_humidity"] = relative_humidity
    return motor.with_values(values)


def drive(motor: Motor, time_s: np.ndarray, pressure_pa: np.ndarray, step_s: float) -> Simulated:
    """Simulate from rest through a record of the line's pressure, which goes in a straight line between readings.

    `motor`: in the room as it was.
    `time_s`, `pressure_pa`, shape (m,): readings of the absolute line pressure [s], [Pa], in order.
    `step_s`: interval of what is returned [s].
    Returns mean speed and flow of each interval. Raises ValueError with fewer than two readings, OperatingPointError
    where the model does not reach a pressure, or cannot be integrated.
    """
    if time_s.size < 2:
        raise ValueError("a record of the pressure needs at least two readings")
    beyond = np.flatnonzero(pressure_pa > HIGHEST_PA)
    if beyond.size:
        raise OperatingPointError(
            f"the line's pressure was {pressure_pa[beyond[0]] / BAR:.4g} bar at {time_s[beyond[0]]:.3f} s, and the "
            f"model goes up to {HIGHEST_PA / BAR:g} bar"
        )
    P_a = motor.si("ambient_pressure")
    moves = np.abs(np.diff(pressure_pa)) > STILL_PA
    pieces = np.where(moves & (np.diff(time_s) < LONGEST_GAP_S), np.ceil(np.diff(time_s) / PIECE_S), 1).astype(int)
    begins = np.concatenate(
        [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(time_s[:-1], time_s[1:], pieces, strict=True)]
    )
    middles = np.where(np.repeat(pieces, pieces) > 1, begins + 0.5 * PIECE_S, begins)
    supply = [
        Supply(float(at), float(P) if P_a + VENTED_PA < P else P_a, bool(P_a + VENTED_PA < P))
        for at, P in zip(begins, np.interp(middles, time_s, pressure_pa), strict=True)
    ]
    ends = np.arange(time_s[0], time_s[-1], step_s)
    try:
        run = simulate(motor, supply, ends)
    except ArithmeticError as error:
        raise OperatingPointError(f"the model cannot be driven with this record of the pressure: {error}") from None
    mass = np.diff(run.inlet_kg) / step_s
    held = pressure_pa[np.clip(np.searchsorted(time_s, ends[1:], side="right") - 1, 0, time_s.size - 1)]
    R = 287.05  # moist air's differs by less than 1 %: this is for a picture
    volume = mass * R * motor.si("inlet_temperature")
    flow = np.divide(volume, held, out=np.full(mass.size, np.nan), where=held > P_a + VENTED_PA)
    return Simulated(ends[1:], run.mean_speed_rad_s()[1:], flow)
