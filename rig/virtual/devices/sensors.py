"""What an instrument makes of the truth: errors drawn once from its file's figures, noise, drift, resolution."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Callable

import numpy as np

from configs.units import ZERO_C
from rig.bench.instrument import ChannelFile, Reference
from rig.readings import NS
from rig.virtual.devices.faults import Faults
from rig.virtual.plant.truth import Turning

DRIFT_SHARE = 0.2  # of bias_sd in DRIFT_S, 1 sigma
DRIFT_S = 1000.0


def generator(seed: int, *names: str) -> np.random.Generator:
    """A source of chance of its own for each name, the same for the same seed."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


def truth_of(plant: Turning, channel: str, reference: Reference | None) -> Callable[[], float]:
    """What a channel would read without any error.

    `reference`: state of a standard volume, or of a rotameter's scale.
    Raises ValueError when the virtual bench has no such quantity.
    """
    room_k, inlet_k = plant.room_k, plant.inlet_k
    if channel.startswith("flow"):
        return _flow(plant, channel, reference, inlet_k)
    quantities: dict[str, Callable[[], float]] = {
        "pressure_bar_abs": lambda: plant.pressure_bar,
        "pressure_bar_gauge": lambda: plant.pressure_bar - plant.ambient_bar,
        "setpoint_bar_abs": lambda: plant.target_bar,
        "setpoint_bar_gauge": lambda: plant.target_bar - plant.ambient_bar,
        "speed_rpm": _Averaged(plant, plant.line.tachometer_window_s),
        "angle_rad": lambda: plant.angle_rad,
        "temperature_c": lambda: (room_k if plant.vented else inlet_k) - ZERO_C,
        "inlet_temperature_c": lambda: (room_k if plant.vented else inlet_k) - ZERO_C,
        "ambient_temperature_c": lambda: room_k - ZERO_C,
    }
    if channel not in quantities:
        raise ValueError(f"the virtual bench knows no quantity for the channel '{channel}' ({', '.join(quantities)})")
    return quantities[channel]


def _flow(plant: Turning, channel: str, reference: Reference | None, inlet_k: float) -> Callable[[], float]:
    """A meter's own flow: at the inlet's state, at a standard one, or by the float of a rotameter."""
    if channel not in ("flow_l_min", "flow_sl_min"):
        raise ValueError(f"the virtual bench knows flow_l_min and flow_sl_min, not '{channel}'")
    if reference is None:
        return lambda: plant.volume_flow_l_min(plant.line_bar, inlet_k)
    state_bar, state_k = reference.pressure_bar_abs, reference.temperature_c + ZERO_C
    if reference.kind == "standard_volume":
        return lambda: plant.volume_flow_l_min(state_bar, state_k)

    def on_the_scale() -> float:
        """The float sees flow times the root of density; its scale was made for the density of one state."""
        lighter = (plant.line_bar / state_bar) * (state_k / inlet_k)
        return plant.volume_flow_l_min(plant.line_bar, inlet_k) * math.sqrt(lighter)

    return on_the_scale


class _Averaged:
    """The speed that a tachometer tells: at present, or the mean over a fixed time until now [rpm]."""

    def __init__(self, plant: Turning, window_s: float) -> None:
        self.plant, self.window_ns = plant, window_s * NS
        self._samples: deque[tuple[float, float]] = deque([(float(plant.time_ns), plant.angle_rad)])
        if window_s > 0.0:
            plant.listeners.append(self._watch)

    def __call__(self) -> float:
        if self.window_ns == 0.0:
            return abs(self.plant.speed_rpm)
        end_ns, end_rad = self._samples[-1]
        start_ns, start_rad = self._samples[0]
        if end_ns <= start_ns:
            return abs(self.plant.speed_rpm)
        if len(self._samples) > 1 and end_ns - start_ns > self.window_ns:  # the window begins between two samples
            later_ns, later_rad = self._samples[1]
            share = (end_ns - self.window_ns - start_ns) / (later_ns - start_ns)
            start_ns, start_rad = end_ns - self.window_ns, start_rad + share * (later_rad - start_rad)
        return abs(end_rad - start_rad) / (end_ns - start_ns) * NS * 30.0 / math.pi

    def _watch(self, times_ns: np.ndarray, angles: np.ndarray, speeds: np.ndarray) -> None:
        self._samples.extend(zip(times_ns[1:].tolist(), angles[1:].tolist(), strict=True))
        while len(self._samples) > 2 and self._samples[1][0] <= self._samples[-1][0] - self.window_ns:
            self._samples.popleft()


class Sensor:
    """One channel of one instrument.

    `figures`: the instrument's 1-sigma figures; what is left out is 0.
    `truth`: what it would read without error [own unit].
    `update_s`: how often the instrument has a new value [s].
    """

    def __init__(
        self,
        device: str,
        channel: str,
        figures: ChannelFile,
        truth: Callable[[], float],
        faults: Faults,
        seed: int,
        update_s: float = 0.0,
    ) -> None:
        self.device, self.figures, self.truth, self.faults = device, figures, truth, faults
        self.update_ns = int(update_s * NS)
        self._chance = generator(seed, device, channel)
        self.bias = (figures.bias_sd or 0.0) * self._chance.standard_normal()
        self.scale = (figures.scale_sd or 0.0) * self._chance.standard_normal()
        self.drift_per_s = (figures.bias_sd or 0.0) * DRIFT_SHARE / DRIFT_S * self._chance.standard_normal()
        self._counts = channel.startswith("speed")  # marks that pass: none at standstill, and never fewer
        self._last: float | None = None
        self._last_ns = 0

    def read(self, time_ns: int) -> float:
        """The instrument's value at a time to which the plant has been carried on [own unit]."""
        fresh = self._last is None or time_ns - self._last_ns >= self.update_ns
        if self._last is None or (fresh and not self.faults.happens("frozen", self.device, time_ns)):
            self._last, self._last_ns = self._measure(time_ns), time_ns
        return math.nan if self.faults.happens("nan", self.device, time_ns) else self._last

    def _measure(self, time_ns: int) -> float:
        truth = self.truth()
        if self._counts and truth == 0.0:
            return 0.0
        value = truth * (1.0 + self.scale) + self.bias + self.drift_per_s * time_ns / NS
        value += (self.figures.noise_sd or 0.0) * self._chance.standard_normal()
        step = self.figures.resolution
        value = round(value / step) * step if step else value
        return max(0.0, value) if self._counts else value
