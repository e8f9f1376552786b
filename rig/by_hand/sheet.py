"""A sheet of paper for a sweep, printed before it: as a page, and as a table to be filled in."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Mapping

from configs.units import STANDARD_BAR
from rig.bench.bench import Bench
from rig.bench.instrument import ChannelFile
from rig.by_hand.by_hand import faces_of, manual_device, on_the_dial
from rig.instruments.manual import is_other_unit, quantity, unit_on_face
from rig.plateaus.plan import DOWN, UP, Step, SweepError, plan

AT_ZERO = "zero"  # in the column of the level: instruments read with the line vented


def sheet_columns(bench: Bench) -> dict[str, str]:
    """The columns of a sheet, in order, and how each is headed: with its unit, where that is not the name's.

    Raises SweepError when no person reads the bench's pressure.
    """
    faces = faces_of(bench)
    device, _, pressure = bench.file.roles.pressure.partition(".")
    if device != manual_device(bench):
        raise SweepError(
            f"{bench.name}: roles.pressure is '{bench.file.roles.pressure}', which nobody reads; a sheet needs a gauge "
            "that a person reads. Take the sweep at the prompt (spinbench sweep)"
        )
    names = ["time", "level_bar_abs", "direction", *faces, f"{pressure}_after", "note"]
    units = {name: f" [{unit_on_face(name, face)}]" for name, face in faces.items() if is_other_unit(name, face)}
    return {name: name + units.get(name.removesuffix("_after"), "") for name in names}


def print_sheet(bench: Bench) -> str:
    """A sheet as CSV text: the levels of the bench's sweep, with cells to be filled in."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    columns = sheet_columns(bench)
    writer.writerow(columns.values())
    empty = [""] * (len(columns) - 3)
    writer.writerow(["", AT_ZERO, "", *empty])
    writer.writerows(["", f"{step.level_bar_abs:g}", step.direction, *empty] for step in _steps(bench))
    writer.writerow(["", AT_ZERO, "", *empty])
    return stream.getvalue()


FROM = {UP: "below", DOWN: "above"}  # where a level is approached from


def print_page(bench: Bench, ambient_bar: float | None = None) -> str:
    """A sheet to be printed on A4 and filled in by hand, as HTML.

    `ambient_bar`: the room's pressure, for the gauge values [bar]; the bench file's, or 1.01325, when left out.
    """
    faces = faces_of(bench)
    heads = [html.escape(_words(column, faces)) for column in sheet_columns(bench)]
    ambient_bar = ambient_bar or bench.file.ambient.pressure_bar_abs or STANDARD_BAR
    rows = [_page_row("zero", "", len(heads))]
    for step in _steps(bench):
        dial = on_the_dial(bench, step.level_bar_abs, ambient_bar)
        also = f"{step.level_bar_abs - ambient_bar:.2f} gauge{dial and f'; dial: {dial}'}"
        level = f"{step.level_bar_abs:.2f} <small>({html.escape(also)})</small>"
        rows.append(_page_row(level, FROM[step.direction], len(heads)))
    rows.append(_page_row("zero", "", len(heads)))
    blanks = "".join(
        f"<p>{text} <span></span></p>"
        for text in (
            "Date, operator:",
            "Ambient pressure at this height, start / end [bar abs, as 1.013]:",
            "Room temperature, start / end [°C]:",
            "Relative humidity, start / end [0 to 1, as 0.50]:",
            "Lubrication, when last given:",
            "Minutes that the motor has run today:",
        )
    )
    return SHEET_PAGE.format(
        title=html.escape(bench.file.title),
        blanks=blanks,
        heads="".join(f"<th>{head}</th>" for head in heads[:-1]) + '<th class="note">note</th>',
        rows="\n".join(rows),
        wait=f"{bench.file.sweep.dwell_s:g}",
        highest=f"{bench.file.safety.highest_speed_rpm:g}",
        room=f"{ambient_bar:g}",
    )


SHEET_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
@page {{ size: A4; margin: 15mm }}
body {{ font: 10pt sans-serif }}
h1 {{ font-size: 13pt }}
p {{ margin: 2mm 0; display: flex }}
p span {{ flex: 1; border-bottom: 0.3pt solid; margin-left: 2mm }}
table {{ border-collapse: collapse; width: 100%; margin-top: 4mm }}
th, td {{ border: 0.3pt solid; padding: 1mm; height: 6mm; text-align: left }}
th.note {{ width: 40% }}
tr {{ break-inside: avoid }}
</style></head><body>
<h1>{title}</h1>
{blanks}
<table><thead><tr>{heads}</tr></thead><tbody>
{rows}
</tbody></table>
<p>Gauge values are those with {room} bar abs in the room.</p>
<p>Approach each level from the side that stands beside it. Wait {wait} s, read all, read the pressure again.
&lt;10, &gt;100: off the scale. Above {highest} rpm: close the valve.</p>
</body></html>
"""


def _steps(bench: Bench) -> list[Step]:
    table = bench.file.sweep
    return plan(table.levels_bar_abs, table.order, table.repeats, table.seed)


def _words(column: str, faces: Mapping[str, ChannelFile]) -> str:
    """A column's name as a person reads it."""
    base = column.removesuffix("_after")
    named = {"level_bar_abs": "level [bar abs]", "direction": "from", "time": "time"}
    if base not in faces:
        return named.get(column, column)
    return f"{quantity(base)}{' after' if base != column else ''} [{unit_on_face(base, faces[base])}]"


def _page_row(level: str, direction: str, cells: int) -> str:
    return f"<tr><td></td><td>{level}</td><td>{direction}</td>{'<td></td>' * (cells - 3)}</tr>"
