"""The first line of a CSV file, and which columns each kind of file has to hold."""

from __future__ import annotations

from typing import Any

from rig.recording.columns import MEASURED, NAMES, PRESSURE, nearest, other_spelling, siblings
from rig.recording.contents import Kind
from rig.recording.headings import plainly_named, read_heading
from rig.recording.mistakes import Mistakes, shown
from rig.recording.units import UNITS, advice

MAX_COLUMNS = 256
_TITLE_LINES = 50  # that may stand above the names
_MOTION = ("speed_rpm", "flow_l_min")
_NEEDS = {
    "radial_piston": (PRESSURE, _MOTION),
    "displacement_machine": (PRESSURE, _MOTION),
    "free_rotor": (("speed_rpm", "angle_rad"),),
    "turning_axis": (("torque_nm",), ("speed_rpm", "angle_rad")),
    "sliding_axis": (("force_n",), ("velocity_m_s",)),
}


def needed_columns(kind: Kind, motor: str | dict[str, Any]) -> tuple[tuple[str, ...], ...]:
    """The columns that a file has to hold: of each group, one.

    `motor`: the recording's motor; a name stands for a radial piston motor.
    """
    if kind == "zero":
        return (MEASURED,)
    name = "radial_piston" if isinstance(motor, str) else str(motor.get("kind"))
    if name == "driven_axis" and isinstance(motor, dict):
        name = "sliding_axis" if "mass_kg" in motor else "turning_axis"
    groups = _NEEDS.get(name, (MEASURED,))
    return (("time_s",), *groups) if kind == "transient" else groups


def names_below(first: list[str], rows: list[list[str]]) -> int | None:
    """The line, from 1, of the column names where the first line holds none of them and a later one several.

    `first`, `rows`: the cells of the first line, and of those behind it.
    """
    if set(first) & set(NAMES):
        return None
    below = (len({cell.strip() for cell in row} & set(NAMES)) for row in rows[:_TITLE_LINES])
    return next((line for line, count in enumerate(below, start=2) if count > 1), None)


def check_separator(names: list[str], place: str, mistakes: Mistakes) -> bool:
    """Whether the first line looks like a header at all; False with one mistake noted when it does not."""
    line = ",".join(names)
    for letter, word in ((";", "semicolons"), ("\t", "tabs")):
        if letter in line:
            mistakes.add(
                f"{place}, header",
                f"'{shown(line)}' has {word} between the columns; separate them with commas and write decimals with a "
                "point (1.5)",
            )
            return False
    if all(_is_number(name) for name in names):
        mistakes.add(f"{place}, header", f"'{shown(line)}' holds numbers; put the column names into the first line")
        return False
    if len(names) > MAX_COLUMNS:
        mistakes.add(f"{place}, header", f"{len(names)} columns; at most {MAX_COLUMNS} are read, leave out the others")
        return False
    return True


def check_names(names: list[str], needed: tuple[tuple[str, ...], ...], place: str, mistakes: Mistakes) -> None:
    """Check the column names of one file: no doubles, no other units, nothing missing."""
    header = f"{place}, header"
    for name in sorted({name for name in names if names.count(name) > 1}):
        mistakes.add(header, f"column '{shown(name)}' stands {names.count(name)} times; keep one, or rename the others")
    if "" in names:
        mistakes.add(header, f"column {names.index('') + 1} has no name; give it one, or take the column out")
    if set(PRESSURE) <= set(names):
        mistakes.add(header, f"both {' and '.join(PRESSURE)}; keep the one that the gauge shows")
    renamed: set[str] = set()
    for name in unknown(names):
        spelling = other_spelling(name)
        if spelling is not None and not set(siblings(name)) & set(names):
            mistakes.add(header, f"column '{shown(name)}': expected {spelling[0]} ({spelling[1]})")
            renamed |= set(siblings(name))
        elif (columns := _meant(name, needed)) and not columns & set(names):
            mistakes.add(header, _looks_like(name, columns))
            renamed |= columns
    for group in needed:
        if not set(group) & (set(names) | renamed):
            near = next((name for name in unknown(names) if nearest(name, group)), None)
            meant = f"; is '{shown(near)}' meant? Rename it" if near else "; add it"
            mistakes.add(header, f"no column {_listed(group)}, which this file needs{meant}")


def _meant(name: str, needed: tuple[tuple[str, ...], ...]) -> set[str]:
    """The columns that a heading plainly says it is, of those that a file may need or that order and mark its rows.

    The air's temperature is no such: a heading does not tell which one of several it is.
    """
    said = plainly_named(name)
    columns = set(PRESSURE) if said == "pressure" else {said}
    asked = {column for group in needed for column in group} - {"inlet_temperature_c"}
    return columns & (asked | {"time_s", "rotor_locked"})


def _looks_like(name: str, meant: set[str]) -> str:
    """What to do with a column whose heading says that it is one of a recording's."""
    heading = read_heading(name)
    unit = UNITS.get(heading.unit) or UNITS.get(f"{heading.unit} abs")
    numbers = f" ({advice(unit)})" if unit else ""
    likely = meant & {PRESSURE[not heading.is_absolute]} if heading.is_absolute is not None else meant
    return (
        f"column '{shown(name)}' looks like {' or '.join(sorted(likely or meant))}; rename it{numbers}, or let its "
        "name say what else it is; or import the file: spinbench runs import FILE --guess"
    )


def unknown(names: list[str]) -> list[str]:
    """The columns that this tool does not know by name."""
    return [name for name in names if name and name not in NAMES]


def unknown_warning(names: list[str], place: str, kept: bool) -> list[str]:
    """One sentence on the columns of a file that are not used, each with what may have been meant."""
    columns = [f"'{shown(name)}'{nearest(name)}" for name in unknown(names)]
    fate = "kept as text, not used" if kept else "not used, and not kept: the file is large"
    return [f"{place}: unknown {'column' if len(columns) == 1 else 'columns'} {', '.join(columns)} ({fate})"] * bool(
        columns
    )


def _listed(group: tuple[str, ...]) -> str:
    return " or ".join(f"'{name}'" for name in group)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
