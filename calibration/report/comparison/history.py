"""The page of a history: what changed along the dates of many recordings, motor by motor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calibration.data.dates import in_order
from calibration.report.comparison import overlay, trend
from calibration.report.diagnosis.words import quantity
from calibration.report.render import HTML, Grid, inline, render, versions
from calibration.report.sets_in_words import titles
from rig.recording import Recording
from rig.recording.origin import parsed

MOST_OF_AN_ERROR = 200  # characters


def report(rows: Sequence[Mapping[str, Any]], recordings: Mapping[str, Recording]) -> dict[str, bytes]:
    """Files of the page by name: ``report.html``.

    `rows`: of the table of diagnoses.
    `recordings`: those that could be read, by their name in the table.
    """
    found = trend.trends(rows)
    of = trend.motors_of(rows)
    motors = [
        _of_motor(motor, found, [row for row in rows if of.get(str(row["recording"])) == motor], recordings)
        for motor in sorted(set(of.values()))
    ]
    failed = [(str(row["recording"]), str(row["error"])[:MOST_OF_AN_ERROR]) for row in rows if row["error"]]
    filled = {
        "alarms": trend.alarms(found),
        "count": len(found),
        "motors": motors,
        "failed": Grid(("recording", "what is wrong"), tuple(failed), 2) if failed else None,
        "versions": versions(),
    }
    return {HTML: render("trend.html.j2", filled)}


def _of_motor(
    motor: str, found: Sequence[trend.Trend], rows: Sequence[Mapping[str, Any]], recordings: Mapping[str, Recording]
) -> dict[str, Any]:
    mine = in_order(rows, lambda row: parsed(row["date"]))
    trends = [one for one in found if one.motor == motor]
    swept = [recordings[str(row["recording"])] for row in mine if str(row["recording"]) in recordings]
    laid = overlay.picture(swept)
    return {
        "name": motor[:1].upper() + motor[1:] if motor else "Motor without a serial number",
        "sentences": [trend.sentence(one) for one in trends],
        "trend": inline(trend.picture(trends)) if trends else "",
        "overlay": inline(laid) if laid else "",
        "table": Grid(
            ("recording", "date", "verdict", "effects", "f_overall, N m s"), tuple(_row(one) for one in mine), 4
        ),
    }


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    friction = trend.figures_of(row).get("")
    shown = "" if friction is None else quantity(*friction, "N m s").removesuffix(" N m s")
    unsure = "" if trend.is_reliable(row) else ", not in the line"
    effects = titles(row["effects"]) if row.get("effects") else ""
    return str(row["recording"]), str(row["date"] or "not noted"), f"{row['verdict']}{unsure}", effects, shown
