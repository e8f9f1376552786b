"""Live data for others, read only: what the console shows of the run on the bench, part by part.

Nothing is taken from anybody, so nothing that comes from the network can reach the bench.
"""

from __future__ import annotations

import json
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from spinbench.console.access import ConsoleError

EVERY_S = 0.5
ROOT = "spinbench"


class Live(ABC):
    """Publishes the parts ``online``, ``state``, ``alarms`` and ``readings/ROLE`` where they have changed."""

    def __init__(self) -> None:
        self._sent: dict[str, str] = {}
        self._looked_s = 0.0

    def publish(self, ask: Callable[[], dict[str, Any] | None]) -> None:
        """Publish what has changed, twice a second. `ask`: gives the run's facts and readings; None without a run."""
        if time.monotonic() - self._looked_s < EVERY_S or not self._heard():
            return
        self._looked_s = time.monotonic()
        parts: dict[str, Any] = {"online": True}
        if (found := ask()) is not None:
            run = {key: found["run"][key] for key in ("name", "kind", "live", "simulated")}
            alarms = [one for one in found["alarms"] if not one["acknowledged"]]
            parts |= {"state": {**run, "state": found["state"]["word"], "time_s": found["state"]["at_s"]}}
            parts |= {"alarms": [{key: one[key] for key in ("at_s", "text", "guidance")} for one in alarms]}
            parts |= {f"readings/{role}": {"run": run["name"], **one} for role, one in found["readings"].items()}
        for name, part in parts.items():
            text = json.dumps(part, ensure_ascii=False, allow_nan=False)
            if self._sent.get(name) != text:
                self._send(name, part, text)
                self._sent[name] = text

    def _heard(self) -> bool:
        """Whether anybody could hear it."""
        return True

    @abstractmethod
    def _send(self, name: str, part: Any, text: str) -> None:
        """Publish a part, which as JSON is `text`."""

    @abstractmethod
    def close(self) -> None:
        """Say that nothing more comes."""


def plain(name: str) -> str:
    """A bench's name as a part of an address."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", name)


def split(option: str, place: str, usual_port: int) -> tuple[str, int]:
    """Host and port of an option's value."""
    host, colon, port = place.rpartition(":") if re.search(r":\d+$", place) else (place, "", "")
    if not host or (colon and not 0 < int(port) < 65536):
        raise ConsoleError(f"{option} '{place}': expected HOST or HOST:PORT")
    return host.strip("[]"), int(port or usual_port)
