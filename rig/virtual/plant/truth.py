"""What is true of a virtual bench: its line, and what its instruments ask of motor and line."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np

import configs
from model.motor import QUANTITIES, Motor

# Called with sample times [ns, shape (n,)], angles [rad] and speeds [rad/s] as they become known; the first sample is
# the last of the call before.
Listener = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


def _within(value: float, low: float, high: float) -> Any:
    """A figure that may be changed within bounds."""
    return field(default=value, metadata={"bounds": (low, high)})


@dataclass(frozen=True)
class LineTruth:
    """How the bench besides the motor is.

    `regulator_lag_s`, `vent_lag_s`: time constants of the pressure towards a set-point, and towards the ambient with
        the dump valve open [s]; the second counts only where the line holds no air.
    `regulator_gain`: gauge pressure that the regulator makes of 1 bar ordered [-].
    `comm_safety_s`: silence after which an output module's communications safety acts [s].
    `regulator_droop_bar_min_l`: what the regulator loses for each L/min that the motor takes at the line's state [bar
        min/L].
    `line_volume_l`: of the line between valve and motor [L]; 0 when the regulator's pressure is the motor's.
    `valve_time_s`: from shut to open, and back [s].
    `valve_area_mm2`: effective area of the valve, to the regulator and to the vent, where the line holds air [mm2].
    `pitch_error_sd`: errors of a toothed wheel, each tooth its own, as a share of the pitch, 1 sigma [-].
    `tachometer_window_s`: over which a tachometer that is asked takes its mean [s]; 0 when it tells the present speed.
    """

    regulator_lag_s: float = _within(0.3, 1e-3, 100.0)
    vent_lag_s: float = _within(0.03, 1e-3, 100.0)
    regulator_gain: float = _within(1.0, 1e-3, 100.0)
    comm_safety_s: float = _within(2.0, 1e-3, 100.0)
    regulator_droop_bar_min_l: float = _within(0.0, 0.0, 0.02)
    line_volume_l: float = _within(0.0, 0.0, 50.0)
    valve_time_s: float = _within(0.0, 0.0, 10.0)
    valve_area_mm2: float = _within(50.0, 1.0, 1000.0)
    pitch_error_sd: float = _within(0.0, 0.0, 0.3)
    tachometer_window_s: float = _within(0.0, 0.0, 10.0)

    @property
    def holds_air(self) -> bool:
        """Whether there is a mass balance to keep."""
        return self.line_volume_l > 0.0 or self.valve_time_s > 0.0 or self.regulator_droop_bar_min_l > 0.0


# What the truth may change besides the motor's parameters: its bounds.
LINE_TRUTH: dict[str, tuple[float, float]] = {one.name: one.metadata["bounds"] for one in fields(LineTruth)}


class Turning(Protocol):
    """Line and motor as the instruments know them: `Plant`, or what stands in its place.

    What they tell is what an instrument without errors of its own would read.

    `time_ns`: to which it has been carried on [ns].
    `ambient_bar`, `target_bar`: of the room, and ordered, absolute [bar].
    `room_k`, `inlet_k`: temperature of the room, and of the line's air [K].
    """

    time_ns: int
    ambient_bar: float
    room_k: float
    inlet_k: float
    target_bar: float
    line: LineTruth
    listeners: list[Listener]
    setpoints: deque[tuple[float, float]]
    history: deque[tuple[float, float, float, float]]

    @property
    def pressure_bar(self) -> float:
        """Of the line at its gauge, absolute."""

    @property
    def line_bar(self) -> float:
        """Of the line, whatever its gauge reads, absolute."""

    @property
    def flow_kg_s(self) -> float:
        """Through the meter."""

    @property
    def speed_rpm(self) -> float:
        """Instantaneous speed."""

    @property
    def angle_rad(self) -> float:
        """Angle of the shaft since the start."""

    @property
    def vented(self) -> bool:
        """Whether the dump valve is open."""

    def order(self, pressure_bar_abs: float) -> None:
        """Order a pressure, now. `pressure_bar_abs`: absolute [bar]; the ambient's or less opens the dump valve."""

    def volume_flow_l_min(self, pressure_bar_abs: float, temperature_k: float) -> float:
        """The present mass flow as a volume flow at a state."""

    def advance(self, to_ns: int) -> None:
        """Carry on to a time; an earlier one changes nothing. `to_ns`: time of the bench [ns]."""


def read_truth(motor: Motor, truth: Mapping[str, float], place: str) -> tuple[Motor, LineTruth]:
    """The motor and the line as they really are on a virtual bench.

    `truth`: changed figures: the motor's parameters each in its own unit, and those of the line [own unit].
    Raises ConfigError for an unknown name, or a value out of its bounds.
    """
    known = [*QUANTITIES, *LINE_TRUTH]
    mistakes = []
    for name, value in truth.items():
        if name not in known:
            close = configs.close_to(name, known)
            hint = f"did you mean '{close}'?" if close else f"known: {', '.join(known)}"
            mistakes.append(f"{place}: virtual.truth.{name}: no such parameter; {hint}")
        elif name in LINE_TRUTH:
            low, high = LINE_TRUTH[name]
            if not low <= value <= high:
                mistakes.append(f"{place}: virtual.truth.{name}: {value:g} is outside {low:g}..{high:g}")
    if mistakes:
        raise configs.ConfigError("\n".join(mistakes))
    line = LineTruth(**{name: value for name, value in truth.items() if name in LINE_TRUTH})
    return motor.with_values({name: value for name, value in truth.items() if name in QUANTITIES}), line
