"""Live data over MQTT, published to a broker; nothing is subscribed to."""

from __future__ import annotations

from typing import Any

from spinbench.console.access import ConsoleError
from spinbench.console.live import ROOT, Live, plain, split
from spinbench.extras import need

PORT, KEEPALIVE_S = 1883, 20


class Mqtt(Live):
    """Publishes under ``spinbench/BENCH``, retained.

    Raises ConsoleError when the broker cannot be reached now; one that goes later is looked for again by itself.
    """

    def __init__(self, place: str, bench: str) -> None:
        super().__init__()
        need("paho")
        from paho.mqtt import client as paho

        host, port = split("--mqtt", place, PORT)
        self.root = f"{ROOT}/{plain(bench)}"
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

    def _heard(self) -> bool:
        return bool(self._client.is_connected())

    def _send(self, name: str, part: Any, text: str) -> None:
        self._client.publish(f"{self.root}/{name}", text, retain=True)

    def close(self) -> None:
        """Say that nothing more comes."""
        if self._client.is_connected():
            self._client.publish(f"{self.root}/online", "false", qos=1, retain=True).wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()
