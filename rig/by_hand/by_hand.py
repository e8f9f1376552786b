"""Which device of a bench a person reads."""

from __future__ import annotations

from rig.bench.bench import Bench
from rig.plateaus.plan import SweepError


def manual_device(bench: Bench) -> str:
    """The device that a person reads. Raises SweepError when there is none, or more than one."""
    found = [name for name, table in bench.file.devices.items() if bench.file.lines[table.line].kind == "keyboard"]
    if len(found) != 1:
        raise SweepError(
            f"{bench.name}: a manual sweep needs one device on a line of kind 'keyboard', and there are {len(found)}; "
            "the columns of one entry are set in its instrument's file"
        )
    return found[0]


def is_manual(bench: Bench) -> bool:
    """Whether a person reads any of the bench's instruments."""
    return any(bench.file.lines[table.line].kind == "keyboard" for table in bench.file.devices.values())
