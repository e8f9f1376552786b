"""Live data over OPC UA: a server that clients read and subscribe to, and that takes nothing from them."""

from __future__ import annotations

import logging
import math
from datetime import UTC, datetime
from typing import Any

from rig.readings import GOOD, USABLE
from spinbench.console.access import ConsoleError
from spinbench.console.live import ROOT, Live, plain, split
from spinbench.extras import need

PORT = 4840
NAMESPACE = "urn:spinbench"


class OpcUa(Live):
    """Serves variables that are named as MQTT's topics are, each field of a part one: ``ns=2;s=BENCH/state/live``.

    What is missing or bad has the status Bad, what is censored or not verified Uncertain. Raises ConsoleError when it
    cannot be served.
    """

    def __init__(self, place: str, bench: str) -> None:
        super().__init__()
        need("asyncua")
        from asyncua import ua
        from asyncua.sync import Server, ThreadLoop

        host, port = split("--opcua", place, PORT)
        logging.getLogger("asyncua").setLevel(logging.ERROR)  # it warns that nothing is encrypted
        self._ua: Any = ua
        self._nodes, self._root = dict[str, Any](), plain(bench)
        self._loop = ThreadLoop()
        self._loop.daemon = True
        self._loop.start()
        self._server = Server(tloop=self._loop)
        self._server.set_server_name(ROOT)
        self._server.set_endpoint(f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}/{ROOT}")
        self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        self._server.aio_obj.iserver.allow_remote_admin = False  # nobody may write, whatever name he gives
        self._space = self._server.register_namespace(NAMESPACE)
        try:
            self._server.start()
        except OSError as error:
            self._loop.stop()
            raise ConsoleError(f"--opcua {place}: cannot be served ({error.strerror or error})") from None

    def _send(self, name: str, part: Any, text: str) -> None:
        fields = {f"{name}/{key}": value for key, value in part.items()} if isinstance(part, dict) else {name: part}
        status = self._status(part) if name.startswith("readings/") else self._ua.StatusCodes.Good
        for path, value in fields.items():
            is_reading = name.startswith("readings/") and path.endswith("/value")
            self._write(path, value, status if is_reading else self._ua.StatusCodes.Good)

    def _status(self, reading: dict[str, Any]) -> int:
        codes = self._ua.StatusCodes
        if reading["value"] is None or reading["quality"] not in USABLE:
            return int(codes.BadNoData)
        return int(codes.Good if reading["quality"] in GOOD and not reading["censored"] else codes.Uncertain)

    def _write(self, path: str, value: Any, status: int) -> None:
        types = self._ua.VariantType
        if isinstance(value, list):
            variant = self._ua.Variant(
                [f"{one['text']}. {one['guidance']}" for one in value], types.String, is_array=True
            )
        elif isinstance(value, bool | str):
            variant = self._ua.Variant(value, types.Boolean if isinstance(value, bool) else types.String)
        else:
            variant = self._ua.Variant(math.nan if value is None else float(value), types.Double)
        if path not in self._nodes:
            self._nodes[path] = self._added(path, variant)
        now = datetime.now(UTC)
        self._nodes[path].write_value(
            self._ua.DataValue(
                variant, StatusCode=self._ua.StatusCode(status), SourceTimestamp=now, ServerTimestamp=now
            )
        )

    def _added(self, path: str, variant: Any) -> Any:
        """A new variable, in the folders that its name says."""
        *folders, name = f"{self._root}/{path}".split("/")
        parent, so_far = self._server.nodes.objects, ""
        for folder in folders:
            so_far = f"{so_far}/{folder}" if so_far else folder
            if so_far not in self._nodes:
                ids = self._ua.NodeId(so_far, self._space), self._ua.QualifiedName(folder, self._space)
                self._nodes[so_far] = parent.add_folder(*ids)
            parent = self._nodes[so_far]
        return parent.add_variable(
            self._ua.NodeId(f"{so_far}/{name}", self._space), self._ua.QualifiedName(name, self._space), variant
        )

    def close(self) -> None:
        """Serve no longer: its clients notice."""
        self._server.stop()
        self._loop.stop()
