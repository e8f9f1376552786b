"""Which device of a bench a person reads."""

from __future__ import annotations

from rig.bench.bench import Bench
from rig.bench.instrument import ChannelFile
from rig.instruments.manual import ManualEntry, factor, is_other_unit, unit_on_face
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


def faces_of(bench: Bench) -> dict[str, ChannelFile]:
    """What a person reads of a bench, in the order of an entry, as it stands on the instruments' faces."""
    driver = bench.build(manual_device(bench))
    return driver.faces if isinstance(driver, ManualEntry) else driver.channels


def on_the_dial(bench: Bench, level_bar_abs: float, ambient_bar: float) -> str:
    """A level as a dial shows it that a person reads, where another unit than bar stands on it; else nothing.

    `ambient_bar`: the room's pressure, for a dial that counts from there [bar].
    """
    name = bench.file.roles.pressure.partition(".")[2]
    face = faces_of(bench).get(name)
    if face is None or not is_other_unit(name, face):
        return ""
    bar = level_bar_abs - (ambient_bar if name.endswith("_gauge") else 0.0)
    return f"{float(f'{bar / factor(name, face):.4g}'):g} {unit_on_face(name, face)}"


def is_manual(bench: Bench) -> bool:
    """Whether a person reads any of the bench's instruments."""
    return any(bench.file.lines[table.line].kind == "keyboard" for table in bench.file.devices.values())
