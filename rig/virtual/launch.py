"""Start a virtual bench as a process of its own, and talk to it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import configs
from rig.acquisition.opening import port_of
from rig.bench.bench import LineTable
from rig.clock import Clock
from rig.lines.port import Port
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort

ROOT = configs.FOLDER.parent
PORTS = "ports.json"
SERVER = ("rig.virtual",)
START_S = 180.0  # the first time on a machine the model is compiled
STOP_S = 5.0
ANSWER_S = 10.0
LOOK_S = 0.02


class VirtualBenchError(Exception):
    """The virtual bench did not start, or refused a request. The text says why."""


class VirtualBench:
    """A virtual bench that runs; a context manager that ends it."""

    def __init__(self, process: subprocess.Popen[bytes], folder: Path, ports: dict[str, Any]) -> None:
        self.process, self.folder, self.ports = process, folder, ports
        self.clock = Clock(ports["rate"], ports["clock_start_ns"])

    def __enter__(self) -> VirtualBench:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def control(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Ask the bench something, or order it; docs/virtual-bench.md lists what.

        Raises VirtualBenchError when it refuses, or is gone.
        """
        return ask(self.ports, request)

    def port_for(self, line_name: str, line_table: LineTable, clock: Clock) -> Port:
        """The port of a line: the bench's where it is virtual, else the one that the bench file names.

        `clock`: the program's; `clock` for one that runs with the bench's.
        """
        return port_for(self.ports, line_name, line_table, clock)

    def close(self) -> None:
        """End the bench."""
        self.process.terminate()
        try:
            self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def ask(ports: Mapping[str, Any], request: Mapping[str, Any]) -> dict[str, Any]:
    """Ask a bench that another process started. Raises VirtualBenchError when it refuses, or is gone."""
    where = (ports["control"]["host"], ports["control"]["tcp_port"])
    try:
        with socket.create_connection(where, timeout=ANSWER_S) as connection, connection.makefile("rb") as answers:
            connection.sendall(json.dumps(dict(request)).encode() + b"\n")
            answer: dict[str, Any] = json.loads(answers.readline() or b"{}")
    except (OSError, ValueError) as error:
        raise VirtualBenchError(f"the virtual bench at {where[0]}:{where[1]} does not answer ({error})") from None
    if not answer.get("ok"):
        raise VirtualBenchError(f"the virtual bench refused: {answer.get('error', 'no answer')}")
    return answer


def port_for(ports: Mapping[str, Any], line_name: str, line_table: LineTable, clock: Clock) -> Port:
    """The port of a line, from what a bench's ports.json holds."""
    place = ports["lines"].get(line_name)
    if place is None:
        return port_of(line_name, line_table, clock)
    if "port" in place:
        table = line_table
        return SerialPort(place["port"], clock, table.baud, table.parity, table.stop_bits, table.data_bits)
    return TcpPort(place["host"], place["tcp_port"], clock)


def launch(
    bench_path: Path | str,
    rate: float | None = None,
    seed: int | None = None,
    owner: bool = True,
    server: Sequence[str] = SERVER,
) -> VirtualBench:
    """Start a virtual bench and wait until it serves.

    `bench_path`: the bench file, or the name of one in configs/benches.
    `rate`: seconds of the bench in one of the wall [-]; the file's when left out.
    `seed`: of noise, errors and faults [-]; the file's when left out.
    `owner`: whether it ends by itself some seconds after this process, however that ends.
    `server`: the module whose process serves the bench, and options that it has besides those of `rig.virtual`.
    Raises VirtualBenchError when it does not start, with its own words.
    """
    folder = Path(tempfile.mkdtemp(prefix="virtual-bench-"))
    module, *options = server
    command = [sys.executable, "-m", module, str(bench_path), "--state", str(folder), *options]
    for key, value in (("--rate", rate), ("--seed", seed), ("--owner", os.getpid() if owner else None)):
        command += [key, str(value)] if value is not None else []
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}
    said = folder / "said.txt"
    with said.open("wb") as file:
        # a session of its own: Ctrl-C at the terminal is for the program, which has yet to vent this bench
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, env=environment, start_new_session=True
        )
    try:
        return VirtualBench(process, folder, _wait_for_ports(process, folder, bench_path))
    except BaseException:
        process.kill()
        process.wait()
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _wait_for_ports(process: subprocess.Popen[bytes], folder: Path, bench_path: Path | str) -> dict[str, Any]:
    give_up = time.monotonic() + START_S
    while time.monotonic() < give_up:
        with contextlib.suppress(FileNotFoundError):
            return json.loads((folder / PORTS).read_text(encoding="utf-8"))
        if process.poll() is not None:
            words = (folder / "said.txt").read_text(encoding="utf-8", errors="replace").strip()
            told = words if process.returncode == 2 else (words.splitlines() or ["without a word"])[-1]
            raise VirtualBenchError(f"the virtual bench for {bench_path} did not start: {told[-2000:]}")
        time.sleep(LOOK_S)
    raise VirtualBenchError(f"the virtual bench for {bench_path} did not start within {START_S:.0f} s")
