"""The figures of a run's instruments, as a recording states them: noise, offset, scale, how a speed is made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from rig.recording import Channel
from rig.recording.schema import MOST_TEXT, OF_SPEED, ChannelTable, channel_of
from rig.runlog.reader import Run
from rig.runlog.schema import ChannelRecord, DeviceRecord

TEMPERATURE_SHARE = (
    2.0 / 293.0
)  # of a standard-volume flow brought to an inlet state whose temperature was not measured


class Figures:
    """What is known of each quantity's instrument.

    `run`: its devices' records hold the figures, its plateaus the noise.
    """

    def __init__(self, run: Run, channels: Mapping[str, str]) -> None:
        self.channels = dict(channels)
        self._devices = {name: self._device(run, name) for name in channels}
        self._records = {name: self._record(run, name) for name in channels}
        self._errors = {name: _rms(self._plateau_errors(run, name)) for name in channels}
        self._scatter = {name: _rms(self._plateau_scatter(run, name)) for name in channels}

    def channel(self, name: str) -> Channel:
        """A quantity's figures; its noise is that of a plateau's mean."""
        record, device = self._records[name], self._devices[name]
        stated: dict[str, Any] = {
            "noise_sd": self.noise_sd(name),
            "bias_sd": record.bias_sd,
            "drift_sd": record.drift_sd,
            "scale_sd": record.scale_sd,
            "resolution": record.resolution,
            "serial": device.serial_number[:MOST_TEXT] or None,
            "calibrated": device.calibration[:MOST_TEXT] or None,
        }
        if name == "speed_rpm":
            stated |= {key: getattr(record, key) for key in OF_SPEED}
        return channel_of(name, ChannelTable(**stated))

    def noise_sd(self, name: str) -> float | None:
        """Noise of one row of the steady file; the instrument's own where the plateaus do not show it.

        Beside the standard error of a mean stands what averaging leaves: the instrument's repeatability.
        """
        record = self._records[name]
        return math.hypot(self._errors[name] or record.noise_sd or 0.0, record.repeatability_sd or 0.0) or None

    def sample_scale(self, name: str) -> float:
        """Noise of a single reading, times that of a row of the steady file [-]."""
        noise = self.noise_sd(name)
        sample = self._records[name].noise_sd or self._scatter[name]
        return _ratio(sample, noise)

    def scale_of(self, errors: Mapping[str, list[float]]) -> float:
        """Noise of rows with such standard errors, times that of the steady file: the largest of the quantities [-]."""
        ratios = [
            _ratio(_rms(found), self.noise_sd(name)) for name, found in errors.items() if found and name != "speed_rpm"
        ]
        return max(ratios, default=1.0)

    def _device(self, run: Run, name: str) -> DeviceRecord:
        device, _, _ = self.channels[name].partition(".")
        if device == "derived":
            device, _, _ = (run.start.roles.get("flow") or "").partition(".")
        return run.start.devices.get(device) or DeviceRecord()

    def _record(self, run: Run, name: str) -> ChannelRecord:
        device, _, channel = self.channels[name].partition(".")
        if device == "derived":
            return self._derived(run)
        table = run.start.devices.get(device)
        return (table.channels.get(channel) if table else None) or ChannelRecord()

    def _derived(self, run: Run) -> ChannelRecord:
        """Figures of the derived flow: the meter's, brought to the inlet's state as the readings were, on average."""
        device, _, channel = (run.start.roles.get("flow") or "").partition(".")
        table = run.start.devices.get(device)
        meter = (table.channels.get(channel) if table else None) or ChannelRecord()
        samples = run.samples
        used = samples[samples["value"].abs() > 0.0]
        ours = used[used["device"] == "derived"]["value"].abs().mean()
        theirs = used[(used["device"] == device) & (used["channel"] == channel)]["value"].abs().mean()
        factor = float(ours / theirs) if theirs and math.isfinite(ours / theirs) else 1.0
        names = ("noise_sd", "bias_sd", "drift_sd", "resolution", "repeatability_sd")
        stated = {name: figure * factor for name in names if (figure := getattr(meter, name)) is not None}
        scale_sd = None if meter.scale_sd is None else math.hypot(meter.scale_sd, TEMPERATURE_SHARE)
        return ChannelRecord(scale_sd=scale_sd, **stated)

    def _plateau_errors(self, run: Run, name: str) -> list[float]:
        means = [plateau.means[name] for plateau in run.plateaus if name in plateau.means]
        return [mean.se for mean in means if mean.se and not mean.censored]

    def _plateau_scatter(self, run: Run, name: str) -> list[float]:
        means = [plateau.means[name] for plateau in run.plateaus if name in plateau.means]
        return [mean.se * math.sqrt(mean.n_eff) for mean in means if mean.se and mean.n_eff and not mean.censored]


def _rms(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _ratio(value: float | None, to: float | None) -> float:
    return value / to if value and to else 1.0
