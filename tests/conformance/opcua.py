"""Another maker's OPC UA client, gopcua, reads what a console serves and is refused what it writes."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from rig.runlog import RunWriter
from tests.conformance.clients import Missing
from tests.console_lab import consoles, free_port, short_bench
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of
from tests.waiting import wait_for

FOLDER = Path(__file__).parent / "opcua_go"
GOOD, NO_DATA, NOT_ALLOWED = 0, 0x809B0000, 0x801F0000  # status codes of OPC UA part 6
# case: what is asked for, and what it must say
CASES = {
    "a good reading": (("read", "ns=2;s=short/readings/pressure/value"), f"1.25 {GOOD}"),
    "a reading that is missing": (("read", "ns=2;s=short/readings/speed/value"), f"<nil> {NO_DATA}"),
    "a word": (("read", "ns=2;s=short/state/state"), f"dwell {GOOD}"),
    "a yes or no": (("read", "ns=2;s=short/state/live"), f"true {GOOD}"),
    "a value written": (("write", "ns=2;s=short/readings/pressure/value", "9"), f"{NOT_ALLOWED}"),
}


def answers():
    """What the client says to each case; raises `Missing`."""
    if shutil.which("go") is None:
        raise Missing
    with tempfile.TemporaryDirectory(prefix="conformance-") as name, consoles() as start:
        folder, program = Path(name), Path(name) / "client"
        plain = os.environ | {"CGO_ENABLED": "0"}  # it needs no C compiler
        built = subprocess.run(
            ["go", "build", "-o", program, "."], cwd=FOLDER, env=plain, capture_output=True, check=False
        )
        if built.returncode:
            raise Missing
        place = f"127.0.0.1:{free_port()}"

        def said(words):
            command = [program, f"opc.tcp://{place}/spinbench", *words]
            return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

        with RunWriter.create(folder / "logs", start_of()) as writer:
            writer.event("state", 1, state="dwell", settled=True)
            writer.exchange(poll("gauge", {PRESSURE: 1.25}, 1_000_000_000))
            writer.exchange(poll("tach", {SPEED: None}, 1_000_000_000))
            start(short_bench(folder), folder / "logs", 0, "--opcua", place)
            first, wanted = CASES["a good reading"]
            wait_for(lambda: said(first) == wanted, "the first reading")
            return {case: said(words) for case, (words, _) in CASES.items()}
