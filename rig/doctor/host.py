"""What the machine tells about its serial ports, from /proc, /sys and /dev."""

from __future__ import annotations

import contextlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from rig.doctor.finding import Finding, Level, printable

SLOW_LATENCY_MS = 2  # an FTDI chip waits this long for more bytes before it hands on a few
MOST_PORTS_SHOWN = 8
GRABBERS = {
    "brltty": (
        "takes USB serial adapters for Braille displays: ports vanish as soon as they are plugged in",
        "sudo apt remove brltty, then plug the adapter in again",
    ),
    "ModemManager": (
        "asks every new serial port whether it is a modem: bytes in the first half minute are not the instrument's",
        'sudo systemctl disable --now ModemManager, or the udev rule ENV{ID_MM_DEVICE_IGNORE}="1" for the adapter',
    ),
}


@dataclass(frozen=True)
class Host:
    """A machine. `proc`, `sys`, `dev`: where its processes, its devices' settings and its ports are."""

    proc: Path = Path("/proc")
    sys: Path = Path("/sys")
    dev: Path = Path("/dev")

    def serial_ports(self) -> list[str]:
        """The USB serial ports that are there, by the name that survives a replug where there is one."""
        by_id = sorted((self.dev / "serial" / "by-id").glob("*"))
        named = {link.resolve() for link in by_id}
        plain = sorted(port for kind in ("ttyUSB*", "ttyACM*") for port in self.dev.glob(kind) if port not in named)
        return [str(port) for port in (*by_id, *plain)]

    def holders(self, port: str) -> list[str]:
        """Other programs that have a port open: ``name (process 123)``."""
        target = os.path.realpath(port)
        others = (entry for entry in self.proc.glob("[0-9]*") if entry.name != str(os.getpid()))
        return [
            f"{_name_of(process)} (process {process.name})"
            for process in sorted(others, key=lambda entry: int(entry.name))
            if target in _open_files(process)
        ]

    def running(self, name: str) -> int | None:
        """The process number of a program, if it runs. `name`: as the kernel knows it, at most 15 characters count."""
        for process in self.proc.glob("[0-9]*"):
            if _name_of(process) == name[:15]:
                return int(process.name)
        return None

    def latency_timer_ms(self, port: str) -> int | None:
        """The latency timer of an FTDI adapter [ms]; None where the port has none."""
        name = Path(os.path.realpath(port)).name
        with contextlib.suppress(OSError, ValueError):
            return int((self.sys / "class" / "tty" / name / "device" / "latency_timer").read_text())
        return None


def of_port(host: Host, where: str, port: str) -> list[Finding]:
    """What the machine tells of a port before it is opened."""
    found = []
    holders = host.holders(port)
    if holders:
        what = f"{port} is open in {_listed(holders)} too: two programs on a port take each other's bytes"
        found.append(Finding(Level.FAULT, where, what, "close that program"))
    latency_ms = host.latency_timer_ms(port)
    if latency_ms is not None and latency_ms > SLOW_LATENCY_MS:
        rule = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
        what = f"the FTDI adapter holds back short replies for up to {latency_ms} ms (its latency timer)"
        found.append(Finding(Level.WARNING, where, what, f"a udev rule: {rule}"))
    return found


def of_programs(host: Host) -> list[Finding]:
    """Programs that are known to take serial ports."""
    found = []
    for name, (what, fix) in GRABBERS.items():
        process = host.running(name)
        if process is not None:
            found.append(Finding(Level.WARNING, "host", f"{name} runs (process {process}); it {what}", fix))
    return found


def why_closed(host: Host, where: str, port: str, error: Exception) -> Finding:
    """Why a serial port did not open."""
    path = Path(port)
    if not os.path.exists(port):  # noqa: PTH110 (where we may not look there is nothing for us, and no error)
        there = host.serial_ports()
        listed = f"there are {_listed(there)}" if there else "no USB serial port is there at all"
        fix = (
            "write one of them into the bench file"
            if there
            else "plug in the adapter; 'sudo dmesg' tells if it is seen"
        )
        return Finding(Level.FAULT, where, f"{port} is not there; {listed}", fix)
    if not os.access(path, os.R_OK | os.W_OK):
        status = path.stat()
        what = f"no permission to open {port}: it belongs to the group {_group(status.st_gid)}"
        if not status.st_mode & stat.S_IRGRP:
            return Finding(Level.FAULT, where, f"{what}, which may not read it either", f"sudo chmod g+rw {port}")
        return Finding(Level.FAULT, where, what, f"sudo usermod -aG {_group(status.st_gid)} $USER, then log in again")
    return Finding(Level.FAULT, where, printable(str(error)), "see the program named here, if any; then try again")


def _open_files(process: Path) -> set[str]:
    """What a process has open, as far as we may see it; other users' processes we may not."""
    found = set()
    with contextlib.suppress(OSError):
        for entry in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                found.add(str(entry.readlink()))
    return found


def _name_of(process: Path) -> str:
    try:
        return printable((process / "comm").read_text(errors="replace").strip())
    except OSError:
        return ""


def _group(number: int) -> str:
    with contextlib.suppress(ImportError, KeyError):
        import grp

        return grp.getgrgid(number).gr_name
    return str(number)


def _listed(names: list[str]) -> str:
    more = len(names) - MOST_PORTS_SHOWN
    return ", ".join(names[:MOST_PORTS_SHOWN]) + (f" and {more} more" if more > 0 else "")
