"""Who may ask the console for what: the host that is named, the origin, the token, and files within the logs folder."""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import re
import secrets
import threading
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from rig.runlog.folder import START

HOSTS = ("127.0.0.1", "localhost", "[::1]")
TOKEN_HEADER = "x-spinbench-token"  # noqa: S105 - a header's name
KEPT = ".console.json"
REPORTS = "reports"  # in the logs folder, with a folder a run: a run's own folder holds nothing but the run
SERVED = {
    ".html": "text/html; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".csv": "text/plain; charset=utf-8",
    ".json": "application/json",
    ".txt": "text/plain; charset=utf-8",
    ".md": "text/plain; charset=utf-8",
}
MOST_BYTES = 100_000_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,150}", re.ASCII)
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report brings its styles and pictures with it, and runs no script. It is of this origin so that the page around it
# hears the key of STOP while the report has the focus.
REPORT_POLICY = (
    "sandbox allow-same-origin; default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'self'"
)


class ConsoleError(Exception):
    """The console cannot be served, or shown, or heard. The text says why and what to do."""


class RefusedError(Exception):
    """A request that is refused: its HTTP status, and why in words."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


def refuse_strangers(method: str, headers: Mapping[str, str], hosts: Collection[str] = HOSTS) -> None:
    """Refuse what another site's page could have sent, whatever it asks for.

    The host's name must be this machine's, one of `hosts`: a hostile name that leads here is not. A change must come
    from a page of this origin.
    """
    host = headers.get("host", "")
    name = host.rpartition(":")[0] if re.search(r":\d+$", host) else host
    if name.lower() not in hosts:
        raise RefusedError(421, f"this console answers to {', '.join(hosts)}, not to another host's name")
    origin = headers.get("origin")
    if origin is not None and origin != f"http://{host}":
        raise RefusedError(403, "the request comes from a page of another site")
    if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
        raise RefusedError(403, "the request comes from a page of another site")
    if method not in ("GET", "HEAD"):
        if origin is None:
            raise RefusedError(403, "a change is asked for by a page of this console; Origin is missing")
        if headers.get("content-type", "").partition(";")[0] != "application/json":
            raise RefusedError(415, "a change is asked for as JSON")


class Kept:
    """What a console keeps in the logs folder for its next start and its user's eyes: token, alarms seen, queue."""

    def __init__(self, logs: Path) -> None:
        self._path, self._lock = logs / KEPT, threading.Lock()
        held = self._read()
        token = held.get("token")
        self.token = token if isinstance(token, str) and len(token) >= 32 else secrets.token_urlsafe(32)
        seen = held.get("acknowledged")
        self.acknowledged: dict[str, list[int]] = seen if isinstance(seen, dict) else {}
        queue = held.get("queue")
        self.queue: list[Any] = queue if isinstance(queue, list) else []
        self._write(token=self.token)

    @property
    def stop_token(self) -> str:
        """Opens STOP alone. Every page of the console has it, whoever looks: stopping is the safe side."""
        return hashlib.sha256(f"stop {self.token}".encode()).hexdigest()

    @property
    def watch_token(self) -> str:
        """Lets a browser watch, where the console serves other machines: a cookie that no script reads."""
        return hashlib.sha256(f"watch {self.token}".encode()).hexdigest()

    def refuse_without_cookie(self, given: str | None) -> None:
        """Refuse to show anything to a browser that has never had the token."""
        if not hmac.compare_digest((given or "").encode(), self.watch_token.encode()):
            raise RefusedError(403, "open the address that the console printed: nothing is shown without its token")

    def acknowledge(self, run: str, alarm: int) -> None:
        """A person has seen an alarm."""
        self.acknowledged[run] = sorted({*self.acknowledged.get(run, []), alarm})
        self._write(acknowledged=self.acknowledged)

    def keep_queue(self, planned: list[Any]) -> None:
        """The runs that are planned have changed."""
        self.queue = planned
        self._write(queue=planned)

    def refuse_without_token(self, given: str, stop: bool = False) -> None:
        """Refuse a change without the token; STOP takes its own too."""
        allowed = (self.token, self.stop_token) if stop else (self.token,)
        if not any(hmac.compare_digest(given.encode(), token.encode()) for token in allowed):
            raise RefusedError(
                403, "open the address that the console printed: this window has no token, so it watches"
            )

    def _read(self) -> dict[str, Any]:
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _write(self, **changed: Any) -> None:
        """Write what has changed; another console of this folder may have changed the rest."""
        with self._lock:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            kept = self._read() | changed
            new = self._path.with_suffix(".new")
            handle = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                json.dump(kept, stream)
            new.replace(self._path)


def is_plain(name: str) -> bool:
    """Whether a name can be that of a run: no path, no hidden file."""
    return bool(_NAME.fullmatch(name))


def run_folder(logs: Path, name: str) -> Path:
    """The folder of a run within the logs folder; links are refused."""
    folder = logs / name
    if not is_plain(name) or folder.is_symlink() or not (folder / START).is_file():
        raise RefusedError(404, "there is no such run in the logs folder")
    return folder


def file_within(logs: Path, wanted: str) -> tuple[Path, str]:
    """A file of the logs folder that may be shown, and its media type. `wanted`: its path from the logs folder."""
    parts = Path(wanted).parts
    kind = SERVED.get(Path(wanted).suffix.lower())
    path = logs.joinpath(*parts)
    plain = bool(parts) and all(map(is_plain, parts))
    if not plain or kind is None or not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise RefusedError(404, "there is no such report in the logs folder")
    if not path.resolve().is_relative_to(logs.resolve()):
        raise RefusedError(404, "there is no such report in the logs folder")
    return path, kind


def reports_of(logs: Path, run: str) -> list[str]:
    """The pages in a run's folder of reports and the folders in it, by their path from the logs folder."""
    folder = logs / REPORTS / run
    found = sorted([*folder.glob("*.html"), *folder.glob("*/*.html")])
    return [str(path.relative_to(logs)) for path in found[:20]]
