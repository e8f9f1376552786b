"""During the run: every reading against the limits. The guard comes first; this is for what nobody predicted.

A single reading beyond a limit trips: a false trip costs a run, a missed one a motor. Only a speed that no rotor can
have reached since the reading before waits for the next reading: a rotor that rocks to rest passes one tooth twice.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

from configs.units import STANDARD_BAR
from rig.bench.bench import RolesTable, SafetyTable
from rig.instruments.codecs.values import OTHER_WAY
from rig.readings import NS, Quality, Reading

# On a clock faster than the wall's, a virtual bench on a busy machine, no signal is called lost sooner than this.
LEAST_REAL_S = 10.0
FASTEST_RISE_RPM_S = 50_000.0  # three times what the highest torque, 8 N m, gives the rotor's 0.005 kg m2


class View(Protocol):
    """Who knows the latest readings: the acquisition."""

    def last(self, channel: str) -> Reading | None:
        """The newest reading of a channel, failed or not; None before the first."""

    def since(self, channel: str, after_ns: int) -> list[Reading]:
        """The readings of a channel, failed or not, whose replies came after a time [ns]."""


class Limits:
    """The trip rules of a bench. It remembers when each signal was last heard and looked at, and the last speed."""

    def __init__(
        self, safety: SafetyTable, roles: RolesTable, ambient_bar_abs: float = STANDARD_BAR, rate: float = 1.0
    ) -> None:
        self.safety, self.roles, self.ambient_bar_abs = safety, roles, ambient_bar_abs
        self.longest_silence_s = max(safety.speed_stale_s, LEAST_REAL_S * rate if rate > 1.0 else 0.0)
        self._heard_ns: dict[str, int] = {}
        self._looked_ns: dict[str, int] = {}
        self._pressurised = False
        self._speed_before: Reading | None = None

    def trip(self, view: View, now_ns: int, pressurised: bool) -> str | None:
        """Why the line must be vented now; None when nothing is wrong. To be asked several times a second.

        `pressurised`: whether the regulator is, or is being, set above zero: only then must the signals be there.
        """
        speed, pressure = view.last(self.roles.speed), view.last(self.roles.pressure)
        if pressurised and not self._pressurised:  # what was silent before has not been silent under pressure
            self._heard_ns = dict.fromkeys((self.roles.speed, self.roles.pressure), now_ns)
        self._pressurised = pressurised
        fast, high = self.safety.highest_speed_rpm, self.safety.highest_pressure_bar_abs
        too_fast = self._any_beyond(view, speed, self.roles.speed, ("speed", fast, "rpm", 0.0))
        if too_fast and speed is not None and (speed.value or 0.0) < 0.0:
            too_fast += f"; it reads {speed.value:g} rpm: {OTHER_WAY}"
        return (
            too_fast
            or self._any_beyond(
                view, pressure, self.roles.pressure, ("pressure", high, "bar abs", self._zero(pressure))
            )
            or self._silent(self.roles.speed, speed, now_ns, "speed")
            or self._silent(self.roles.pressure, pressure, now_ns, "pressure")
        )

    def _zero(self, pressure: Reading | None) -> float:
        return self.ambient_bar_abs if pressure is not None and pressure.channel.endswith("_gauge") else 0.0

    def _any_beyond(
        self, view: View, newest: Reading | None, channel: str, limit: tuple[str, float, str, float]
    ) -> str | None:
        """Of the readings since the last look; of the newest at the first."""
        if newest is None:
            return None
        looked_ns = self._looked_ns.get(channel)
        self._looked_ns[channel] = newest.reply_ns
        readings = [newest] if looked_ns is None else view.since(channel, looked_ns)
        if channel == self.roles.speed:
            readings = [one for one in map(_without_direction, readings) if self._possible(one)]
        return next(filter(None, (self._beyond(reading, *limit) for reading in readings)), None)

    def _possible(self, reading: Reading) -> bool:
        """Whether a rotor can have this speed, after the reading before. What a person typed is believed.

        Of a speed off the top of its scale the scale's end is judged: the rotor had that at least.
        """
        if not (reading.usable or _is_above(reading)) or reading.value is None:
            return True
        before, self._speed_before = self._speed_before, reading
        if before is None or before.value is None or reading.quality is Quality.MANUAL:
            return True
        return reading.value - before.value <= FASTEST_RISE_RPM_S * (reading.reply_ns - before.reply_ns) / NS

    @staticmethod
    def _beyond(reading: Reading, what: str, limit: float, unit: str, zero: float) -> str | None:
        """A value above the limit, or above its instrument's scale: then nobody knows how far."""
        if reading.value is None:
            if not _is_above(reading):
                return None
            return f"{what} beyond the scale of {reading.name}, limit {limit:g} {unit}"
        value = reading.value + zero
        if _is_above(reading):
            return f"{what} beyond the scale of {reading.name}: {value:.6g} {unit} or more, limit {limit:g} {unit}"
        if reading.usable and value > limit:
            return f"{what} {value:.6g} {unit} ({reading.name}), limit {limit:g} {unit}"
        return None

    def _silent(self, channel: str, reading: Reading | None, now_ns: int, what: str) -> str | None:
        """No usable reading for too long while there is pressure."""
        if not self._pressurised:
            return None
        if reading is not None and reading.usable:
            self._heard_ns[channel] = max(self._heard_ns[channel], reading.reply_ns)
        silence_s = (now_ns - self._heard_ns[channel]) / NS
        if silence_s <= self.longest_silence_s:
            return None
        last = "nothing was ever read" if reading is None else f"the last reading is '{reading.quality}'"
        last += f": {reading.detail}" if reading is not None and reading.detail else ""
        return (
            f"{what} signal lost: no usable reading of {channel} for {silence_s:.2f} s under pressure, limit "
            f"{self.longest_silence_s:g} s; {last}"
        )


def _without_direction(speed: Reading) -> Reading:
    """A speed as its magnitude: a tachometer that shows the direction counts below zero the other way."""
    if speed.value is None or speed.value >= 0.0:
        return speed
    return dataclasses.replace(speed, value=-speed.value, censored=-speed.censored)


def _is_above(reading: Reading) -> bool:
    """Whether it is off the top of its instrument's scale, as far as is told. A person may have typed that."""
    return reading.censored > 0 or (reading.quality is Quality.OVER_RANGE and reading.censored == 0)
