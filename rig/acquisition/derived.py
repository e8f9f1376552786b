"""Flow at the inlet's state from a flow meter that refers to another one.

A thermal meter reads volume at a standard state, so Q = Q_s (P_s/P)(T/T_s). A rotameter's scale was made for the
density of one state, and its float balances drag, so Q = Q_read sqrt(rho_s/rho) with rho proportional to P/T. The
meter's own reading stays in the log as it came; this is a channel beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from configs.units import STANDARD_BAR, ZERO_C
from rig.bench.bench import Bench
from rig.bench.instrument import ChannelFile, Reference
from rig.readings import NS, Quality, Reading

DEVICE = "derived"
CHANNEL = "flow_l_min"
FRESH_S = 5.0  # a pressure older than this does not belong to the flow


@dataclass(frozen=True)
class State:
    """A gas state with its standard uncertainties: absolute pressure [bar] and temperature [K]."""

    pressure_bar: float
    pressure_sd_bar: float
    temperature_k: float
    temperature_sd_k: float


def inlet_flow(flow: float, flow_sd: float, reference: Reference, inlet: State) -> tuple[float, float]:
    """Volume flow at the inlet's pressure and temperature, and its standard uncertainty.

    `flow`, `flow_sd`: the meter's reading and its uncertainty [L/min].
    Returns flow and 1 sigma [L/min], by first-order propagation.
    """
    ratio = (reference.pressure_bar_abs / inlet.pressure_bar) * (
        inlet.temperature_k / (reference.temperature_c + ZERO_C)
    )
    power = 1.0 if reference.kind == "standard_volume" else 0.5
    factor = ratio**power
    relative_sd = power * math.hypot(
        inlet.pressure_sd_bar / inlet.pressure_bar, inlet.temperature_sd_k / inlet.temperature_k
    )
    return flow * factor, math.hypot(flow_sd * factor, flow * factor * relative_sd)


class InletFlow:
    """Makes the derived channel from the readings as they pass, in the order of the log.

    `ambient_bar`: ambient pressure, for a gauge that reads above it [bar]; the bench file's, or 1.01325, when left out.
    `ambient_c`: inlet temperature where no channel tells it [degree Celsius]; the bench file's, or 20, when left out.
    """

    def __init__(self, bench: Bench, ambient_bar: float | None = None, ambient_c: float | None = None) -> None:
        ambient = bench.file.ambient
        self.ambient_bar = ambient_bar or ambient.pressure_bar_abs or STANDARD_BAR
        self.ambient_sd_bar = ambient.pressure_sd_bar
        chosen_c = ambient_c if ambient_c is not None else ambient.temperature_c
        self.ambient_c = 20.0 if chosen_c is None else chosen_c
        self.flow_name = bench.file.roles.flow
        self.flow_figures = bench.channel("flow")[1] if self.flow_name else None
        self.pressure_name, self.pressure_figures = bench.channel("pressure")
        self.temperature_name = bench.file.roles.temperature
        self.reference = self.flow_figures.reference if self.flow_figures else None
        self._pressure: Reading | None = None
        self._temperature: Reading | None = None

    def __call__(self, reading: Reading) -> Reading | None:
        """The derived reading of a flow reading; None for any other, and where the meter reads the inlet's state."""
        if reading.name == self.pressure_name:
            self._pressure = reading
        elif reading.name == self.temperature_name:
            self._temperature = reading
        if reading.name != self.flow_name or self.flow_figures is None or self.reference is None:
            return None
        return self._derived(reading, self.flow_figures, self.reference)

    def _derived(self, flow: Reading, figures: ChannelFile, reference: Reference) -> Reading:
        missing = self._missing(flow)
        if missing or flow.value is None or self._pressure is None or self._pressure.value is None:
            return self._reading(flow, None, flow.quality if flow.value is None else Quality.STALE, missing)
        absolute = self._pressure.value
        sd_bar = _sd(self.pressure_figures, absolute)
        if self.pressure_name.endswith("_gauge"):
            absolute += self.ambient_bar
            sd_bar = math.hypot(sd_bar, self.ambient_sd_bar)
        measured = self._temperature is not None and self._temperature.usable
        celsius = self._temperature.value if measured and self._temperature is not None else self.ambient_c
        inlet = State(absolute, sd_bar, float(celsius or 0.0) + ZERO_C, 0.5 if measured else 2.0)
        value, sd = inlet_flow(flow.value, _sd(figures, flow.value), reference, inlet)
        words = f"sd {sd:.4g} L/min; from {flow.value!r} {flow.unit} at {reference.pressure_bar_abs:g} bar, "
        words += f"{reference.temperature_c:g} degC ({reference.kind})"
        trusted = flow.quality if self._pressure.good else Quality.UNVERIFIED
        return self._reading(flow, value, trusted, words)

    def _missing(self, flow: Reading) -> str:
        if flow.value is None:
            return "no flow reading"
        if self._pressure is None or not self._pressure.usable:
            return "no pressure at the time"
        if abs(flow.time_ns - self._pressure.time_ns) > FRESH_S * NS:
            return f"the last pressure is more than {FRESH_S:g} s old"
        return ""

    def _reading(self, flow: Reading, value: float | None, quality: Quality, detail: str) -> Reading:
        return Reading(
            DEVICE,
            CHANNEL,
            value,
            "L/min",
            quality,
            flow.time_ns,
            flow.request_ns,
            flow.reply_ns,
            raw=flow.raw,
            detail=detail,
            censored=flow.censored if value is not None else 0,
        )


def _sd(figures: ChannelFile, value: float) -> float:
    """Standard uncertainty of one reading from the instrument's figures."""
    parts = (
        figures.noise_sd or 0.0,
        figures.bias_sd or 0.0,
        (figures.scale_sd or 0.0) * abs(value),
        (figures.resolution or 0.0) / math.sqrt(12.0),
    )
    return math.hypot(*parts)
