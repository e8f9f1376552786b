"""The watchdog's own process, ``python -m rig.interlock.watching``: a plan and then beats on its standard input."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import select
import signal
import sys
import time
from typing import Any

from rig.acquisition.opening import line_of, port_of
from rig.bench.bench import read_bench
from rig.bench.instrument import Regulator
from rig.clock import Clock
from rig.interlock.watchdog import READY, RELEASE, SILENCE_S, Plan
from rig.lines.serial import SerialPort
from rig.recording.files import alone_in

GIVE_UP_S = 10.0
AGAIN_S = 0.1  # between attempts
CONTROLLER_ENDED, SILENT, RELEASED = "the controller has ended", f"no beat for {SILENCE_S:g} s", "released"
MOST_PLAN_BYTES = 65_536


def main() -> int:
    """Watch until the controller releases, ends or hangs; the exit code is 0 unless the regulator could not be set."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    pipe = sys.stdin.fileno()
    try:
        plan = Plan.from_json(_first_line(pipe))
        driver = read_bench(plan.bench_file).regulator(plan.device)
    except Exception as error:
        _say(f"{type(error).__name__}: {error}"[:500].encode())
        return 2
    _note(plan, "watching", pid=os.getpid(), controller=os.getppid())
    _say(READY)
    while True:
        reason = watch(pipe)
        if reason == RELEASED:
            _note(plan, "released")
            return 0
        outcome = vent(plan, driver, pipe, reason)
        if outcome != "beating again":
            return 0 if outcome == "vented" else 1


def watch(pipe: int) -> str:
    """Wait for a reason to act, or for the release. Returns `CONTROLLER_ENDED`, `SILENT` or `RELEASED`."""
    while True:
        # After a long wait look again: on a machine that stood still the beats are there, and so is this process.
        if not select.select([pipe], [], [], SILENCE_S)[0] and not select.select([pipe], [], [], 0.0)[0]:
            return SILENT
        data = os.read(pipe, 4096)
        if RELEASE in data:
            return RELEASED
        if not data:
            return CONTROLLER_ENDED


def vent(plan: Plan, driver: Regulator, pipe: int, reason: str) -> str:
    """Order zero until the regulator reads it back, for 10 s.

    `pipe`: beats that come again before the port could be opened call it off.
    Returns ``vented``, ``failed`` or ``beating again``.
    """
    start_s = time.monotonic()
    attempts, last_error, opened = 0, "", False
    while time.monotonic() - start_s < GIVE_UP_S:
        if reason == SILENT and not opened and select.select([pipe], [], [], 0.0)[0] and os.read(pipe, 4096):
            _note(plan, "beating again", attempts=attempts, error=last_error)
            return "beating again"
        attempts += 1
        clock = Clock(plan.rate)
        port = port_of(plan.device, plan.line, clock)
        if isinstance(port, SerialPort) and reason == SILENT:
            port.exclusive = False  # a controller that hangs keeps its lock, and reads nothing
        line = line_of(plan.device, plan.line, port, clock)
        try:
            line.open()
            opened = True
            line.drop()  # the answer to the controller's last question may be on its way
            driver.open(line)
            zero = max(0.0, driver.lowest)
            reads_back = driver.write(line, zero)
        except Exception as error:  # whatever it is, the next attempt may succeed
            last_error = f"{type(error).__name__}: {error}"[:500]
            time.sleep(AGAIN_S)
        else:
            figures = {"ordered": zero, "reads_back": reads_back, "unit": driver.unit}
            took_s = round(time.monotonic() - start_s, 3)
            _note(plan, "vented", reason=reason, attempts=attempts, took_s=took_s, error=last_error, **figures)
            return "vented"
        finally:
            line.close()
    _note(plan, "failed", reason=reason, attempts=attempts, error=last_error)
    return "failed"


def _first_line(pipe: int) -> bytes:
    """The plan, byte by byte: what follows it are beats, and those are counted elsewhere."""
    text = b""
    while not text.endswith(b"\n"):
        byte = os.read(pipe, 1)
        if not byte or len(text) > MOST_PLAN_BYTES:
            raise ValueError("the plan is not whole; the controller ended while it started this process")
        text += byte
    return text


def _say(text: bytes) -> None:
    with contextlib.suppress(OSError):  # the controller may be gone already
        os.write(sys.stdout.fileno(), text)


def _note(plan: Plan, event: str, **details: Any) -> None:
    """A line of JSON in one write; a full disk or a folder that is gone must not keep the regulator from zero.

    A run may be sealed while this process is being started: `repair` right after a kill.
    """
    if plan.log is None:
        return
    utc = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    text = json.dumps({"utc": utc, "event": event, "device": plan.device, **details})
    with contextlib.suppress(OSError), alone_in(plan.log.parent):
        if plan.seal is not None and plan.seal.exists():
            return
        file = os.open(plan.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(file, text.encode() + b"\n")
            os.fsync(file)
        finally:
            os.close(file)


if __name__ == "__main__":
    sys.exit(main())
