"""A console as a person starts it, a bench short enough for a test, and a link between the two that can be cut."""

from __future__ import annotations

import contextlib
import json
import re
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rig.bench.bench import FOLDER
from rig.runlog import Run, read_run
from tests.waiting import ENOUGH_S, wait_for

PROGRAM = [sys.executable, "-m", "spinbench"]
PATIENT_MS = 1000.0 * ENOUGH_S
RATE = 4.0  # of the bench's clock: no faster, for other work keeps the machine busy


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return int(listening.getsockname()[1])


def short_bench(folder: Path, levels: str = "[1.25, 1.35]", dwell_s: float = 3.0) -> Path:
    """The shipped virtual bench with few levels and short waits."""
    text = (FOLDER / "virtual.toml").read_text(encoding="utf-8")
    for key, value in {
        "levels_bar_abs": f"{levels}\nzero_s = 2.0",
        "order": '"up"',
        "window_s": "2.0",
        "dwell_s": str(dwell_s),
        "captures": "[]",
        "rate": str(RATE),
    }.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return path


class Console:
    """The command as a process. `address`: of the page, with the token."""

    def __init__(self, bench: Path, logs: Path, port: int = 0, *more: str) -> None:
        command = [*PROGRAM, "console", str(bench), "--logs", str(logs), "--port", str(port), *more]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        assert self._process.stdout is not None
        said = self._process.stdout.readline()
        self.address = said.removeprefix("open ").strip()
        self.place, _, self.token = self.address.partition("/#token=")
        self.port = int(self.place.rpartition(":")[2])

    def kill(self, number: int = signal.SIGKILL) -> int:
        """End it; what it ended with."""
        if self._process.poll() is None:
            self._process.send_signal(number)
        self._process.wait(60.0)
        assert self._process.stdout is not None
        self._process.stdout.close()
        return int(self._process.returncode)

    def ask(self, path: str, body: Any = None, **headers: str) -> tuple[int, str, dict[str, str]]:
        """A request as another program may make it: status, text, headers. A body makes it a POST."""
        data = None if body is None else json.dumps(body).encode()
        given = {"content-type": "application/json", "origin": self.place} if body is not None else {}
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        request = urllib.request.Request(self.place + path, data, given | named)
        try:
            with urllib.request.urlopen(request, timeout=60.0) as answer:
                return answer.status, answer.read().decode(), dict(answer.headers)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode(), dict(error.headers)

    def parts(self) -> dict[str, Any]:
        """What a window is shown first."""
        with urllib.request.urlopen(f"{self.place}/events?span=0&window=test", timeout=60.0) as stream:
            found = json.loads(stream.readline().decode().removeprefix("data: "))
        assert isinstance(found, dict)
        return found


@contextlib.contextmanager
def consoles() -> Iterator[Callable[..., Console]]:
    """Starts consoles; all that are left at the end are ended."""
    made: list[Console] = []

    def start(*arguments: Any, **options: Any) -> Console:
        made.append(Console(*arguments, **options))
        return made[-1]

    try:
        yield start
    finally:
        for one in made:
            one.kill()


class Link:
    """A port that leads to another one, until it is cut: then nothing comes through, and nobody is told."""

    def __init__(self, to_port: int) -> None:
        self._to_port, self.cut = to_port, threading.Event()
        self._over = threading.Event()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """No more."""
        self._over.set()
        self._listening.close()

    def _accept(self) -> None:
        while not self._over.is_set():
            try:
                ours, _ = self._listening.accept()
            except OSError:
                return
            threading.Thread(target=self._carry, args=(ours,), daemon=True).start()

    def _carry(self, ours: socket.socket) -> None:
        with ours, contextlib.suppress(OSError):
            while self.cut.is_set() and not self._over.is_set():
                time.sleep(0.05)
            with (
                socket.create_connection(("127.0.0.1", self._to_port), 10.0) as theirs,
                selectors.DefaultSelector() as ready,
            ):
                ready.register(ours, selectors.EVENT_READ, theirs)
                ready.register(theirs, selectors.EVENT_READ, ours)
                while not self._over.is_set():
                    for key, _ in ready.select(0.2):
                        if self.cut.is_set():
                            time.sleep(0.05)
                            continue
                        block = key.fileobj.recv(65536)  # type: ignore[union-attr]
                        if not block:
                            return
                        key.data.sendall(block)


def only_run(logs: Path) -> Path | None:
    """The one run of a logs folder, once its start record is there."""
    return next((one.parent for one in logs.glob("*/start.json")), None)


def events_of(folder: Path) -> list[dict[str, Any]]:
    """The events of a run that may be growing."""
    path = folder / "events.jsonl"
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.exists() else []
    return [json.loads(line) for line in lines]


def has(page: Any, selector: str, text: str) -> None:
    """Wait until an element says something."""
    page.wait_for_function(
        "([selector, text]) => document.querySelector(selector).textContent.includes(text)", arg=[selector, text]
    )


def start_from(page: Any) -> None:
    """Take control and start a sweep, with the keyboard alone."""
    page.keyboard.press("t")
    has(page, "#control-told", "This window controls")
    page.wait_for_function("() => !document.querySelector('#start').disabled")
    page.focus("#start")
    page.keyboard.press("Enter")
    page.wait_for_selector("#start-dialog", state="visible")
    assert "bar abs" in page.inner_text("#planned")  # what is planned is shown before it starts
    page.keyboard.type("Novák")
    page.wait_for_function("() => !document.querySelector('#start-now').disabled")
    page.focus("#start-now")
    page.keyboard.press("Enter")


def ends(logs: Path) -> Run:
    """The one run of a logs folder, once it is sealed."""
    folder = only_run(logs)
    assert folder is not None
    wait_for(lambda: (folder / "end.json").exists(), "the run sealed")
    return read_run(folder)
