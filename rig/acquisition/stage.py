"""What is added to an exchange on its way to the log. A replay passes through here too, in the same order."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from rig.acquisition.derived import InletFlow
from rig.bench.bench import Bench
from rig.readings import Exchange, Quality, Reading

ROOM = "room"  # the event with which a person puts right what was told of the room


class Stage:
    """Marks the readings of a virtual bench as simulated, and adds the derived channels.

    `ambient_bar`, `ambient_c`: ambient pressure [bar] and temperature [degree Celsius] of the run; the bench file's
        when left out.
    """

    def __init__(
        self, bench: Bench, simulated: bool, ambient_bar: float | None = None, ambient_c: float | None = None
    ) -> None:
        self.simulated = simulated
        self.inlet_flow = InletFlow(bench, ambient_bar, ambient_c)

    def __call__(self, exchange: Exchange) -> Exchange:
        """The exchange as it is logged."""
        if not exchange.readings:
            return exchange
        logged: list[Reading] = []
        for read in exchange.readings:
            reading = self._marked(read)
            logged.append(reading)
            derived = self.inlet_flow(reading)
            if derived is not None:
                logged.append(derived)
        return exchange.with_readings(tuple(logged))

    def hear(self, event: str, details: Mapping[str, Any]) -> None:
        """Take the room as a person has put it right, from this event of the log on."""
        bar, celsius = details.get("pressure_bar_abs"), details.get("temperature_c")
        if event == ROOM and isinstance(bar, int | float) and isinstance(celsius, int | float):
            self.inlet_flow.ambient_bar, self.inlet_flow.ambient_c = bar, celsius

    def _marked(self, reading: Reading) -> Reading:
        if self.simulated and reading.quality is Quality.OK:
            return dataclasses.replace(reading, quality=Quality.SIMULATED)
        return reading
