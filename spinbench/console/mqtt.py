"""Live data for others, read only: what the console shows of the run on the bench, published to an MQTT broker.

Nothing is subscribed to, so nothing that comes from the broker can reach the bench.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from typing import Any

from spinbench.console.access import ConsoleError
from spinbench.extras import need

PORT, EVERY_S, KEEPALIVE_S = 1883, 0.5, 20
ROOT = "spinbench"


class Mqtt:
    """Publishes under ``spinbench/BENCH``, retained: ``online``, ``state``, ``alarms``, ``readings/ROLE``.

    Raises ConsoleError when the broker cannot be reached now; one that goes later is looked for again by itself.
    """

    def __init__(self, place: str, bench: str) -> None:
        need("paho")
        from paho.mqtt import client as paho

        host, port = _split(place)
        self.root = f"{ROOT}/{re.sub(r'[^A-Za-z0-9._-]', '_', bench)}"
        self._sent: dict[str, str] = {}
        self._looked_s = 0.0
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.will_set(f"{self.root}/online", "false", qos=1, retain=True)
        self._client.on_connect = self._connected
        try:
            self._client.connect(host, port, KEEPALIVE_S)
        except OSError as error:
            raise ConsoleError(
                f"--mqtt {place}: no broker answers there ({error.strerror or error}); start it, or leave --mqtt out"
            ) from None
        self._client.loop_start()

    def _connected(self, *_: Any) -> None:
        self._sent = {}  # whatever the broker held, it gets all of it anew

    def publish(self, ask: Callable[[], dict[str, Any] | None]) -> None:
        """Publish what has changed, twice a second. `ask`: gives the run's facts and readings; None without a run."""
        if time.monotonic() - self._looked_s < EVERY_S or not self._client.is_connected():
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
                self._sent[name] = text
                self._client.publish(f"{self.root}/{name}", text, retain=True)

    def close(self) -> None:
        """Say that nothing more comes."""
        if self._client.is_connected():
            self._client.publish(f"{self.root}/online", "false", qos=1, retain=True).wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()


def _split(place: str) -> tuple[str, int]:
    host, colon, port = place.rpartition(":") if re.search(r":\d+$", place) else (place, "", "")
    if not host or (colon and not 0 < int(port) < 65536):
        raise ConsoleError(f"--mqtt '{place}': expected HOST or HOST:PORT")
    return host.strip("[]"), int(port or PORT)
