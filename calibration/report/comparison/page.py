"""The report of what changed between two recordings: one self-contained HTML page, and one picture."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from calibration.data.rows_used import few_used, in_words_of
from calibration.diagnosis.result import Diagnosis, several_of
from calibration.report import along_dates
from calibration.report.along_dates import Panel, Point
from calibration.report.comparison import words
from calibration.report.fit.words import rounded
from calibration.report.render import HTML, PNG, Grid, inline, render, step_times, versions
from calibration.report.sets_in_words import in_a_row
from calibration.report.style import png
from calibration.report.units import CAUTION, how_taken, on_an_axis, promise_in_short
from calibration.unknowns.effects import changed, is_change, unchanged
from model.effects import effects
from rig.recording.origin import parsed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JSON = "comparison.json"
NO_BREAK = "\N{NO-BREAK SPACE}"
MOST, MOST_WIDE = 6, 38  # changes that are drawn, and characters of a line of their titles


def report(found: Diagnosis, document: Mapping[str, Any], notes: Sequence[str] = ()) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``.

    `notes`: what was left out or assumed of the recordings, and of their order, a sentence each.
    """
    drawn = png(picture(document))
    filled = context(found, document, notes) | {"picture": inline(drawn)}
    return {HTML: render("comparison.html.j2", filled), PNG: drawn}


def picture(document: Mapping[str, Any]) -> Figure:
    """The one picture of a comparison."""
    return along_dates.drawn(panels(document))


def panels(document: Mapping[str, Any]) -> list[Panel]:
    """Each change that is listed, then the most probable ones: its size in both recordings."""
    made, recordings = [], document["recordings"]
    for change in document["changes"][:MOST]:
        name, one = next(iter(change["parameters"].items()))
        factor, unit = on_an_axis("-" if one["unit"] == "1" else one["unit"], name)
        points = [
            Point(
                recording["recording"],
                parsed(recording["date"]),
                *(factor * one[key][figure] for figure in ("mean", "q05", "q95")),
            )
            for recording, key in zip(recordings, ("before", "after"), strict=True)
        ]
        quantity = words.bare(name) if change["of"] == "motor" else effects()[change["id"]].amplitude.text
        title = f"{words.called([change['id']])}, probability {words.chance(change['probability'])}"
        title = f"{textwrap.fill(title, MOST_WIDE)}\nchange {words.figure(name, one, 'change')}"
        made.append(Panel(title, quantity, unit, points))
    return made


def context(found: Diagnosis, document: Mapping[str, Any], notes: Sequence[str]) -> dict[str, Any]:
    """The texts and tables of the page."""
    problem, p = several_of(found).problem, document["unchanged_probability"]
    return {
        "names": " and ".join(one["recording"] for one in document["recordings"]),
        "motor": problem.parts[0].motor.name,
        "kind": document["verdict"],
        "verdict": words.sentence(document),
        "mismatch": words.mismatch(document),
        "used": in_words_of([part.recording for part in problem.parts], document["files"]),
        "unchanged": "" if p is None else words.chance(p),
        "explanations": [f"{words.called_set(one)}{_figures(document, one)}" for one in document["explanations"]],
        "changes": _change_table(document),
        "sets": _set_table(document),
        "tests": _test_table(document),
        "caution": CAUTION,
        "seen": _seen_table(found),
        "notes": [*few_used(document["files"]), *notes],
        "seconds": step_times(found.seconds),
        "versions": versions(),
        "sha256": " and ".join(part.recording.sha256 for part in problem.parts if part.recording.sha256),
    }


def _figures(document: Mapping[str, Any], one: Mapping[str, Any]) -> str:
    told = words.moves(document, one)
    return f": {told}" if told else ""


def _change_table(document: Mapping[str, Any]) -> Grid:
    rows = []
    for change in document["changes"]:
        for name, one in change["parameters"].items():
            unit = "-" if one["unit"] == "1" else one["unit"]
            factor, shown = on_an_axis(unit, name)
            low, high = (rounded(factor * one["change"][key], factor * one["change"]["sd"]) for key in ("q05", "q95"))
            rows.append(
                (
                    words.called([change["id"]]),
                    name,
                    *(_unbroken(words.figure(name, one, key)) for key in ("before", "after", "change")),
                    f"{low} to {high} {shown.replace(' ', NO_BREAK)}",
                    words.chance(change["probability"]),
                )
            )
    header = ("if it is this that changed", "figure", "before", "after", "change", "change, 90 %", "probability")
    return Grid(header, tuple(rows), 2)


def _unbroken(figure: str) -> str:
    """A figure that a line may end in ahead of its unit alone."""
    number = re.sub(r"^(\S+) ± ", rf"\1{NO_BREAK}±{NO_BREAK}", figure)
    value, _, unit = number.partition(" ")
    return f"{value} {unit.replace(' ', NO_BREAK)}".strip()


def _set_table(document: Mapping[str, Any]) -> Grid:
    rows = tuple(
        (
            words.called_set(one),
            "" if one["refused"] is None else f"refused: {one['refused']}".replace(changed(""), ""),
            words.chance(one["probability"]),
        )
        for one in document["sets"]
    )
    return Grid(("explanation", "", "probability"), rows, 2)


def _test_table(document: Mapping[str, Any]) -> Grid:
    rows = tuple(
        (
            f"{test['test']}: {how_taken(test)}",
            in_a_row([[unchanged(name) for name in one.split("+")] for one in test["separates"]], "and"),
            promise_in_short(test),
        )
        for test in document["next_tests"]
    )
    return Grid(("test, with the motor as it is now", "tells apart", "nats"), rows, 2)


def _seen_table(found: Diagnosis) -> Grid:
    """From which size on each change would have been seen."""
    rows = []
    for one in found.resolved:
        if not is_change(one.effect):
            continue
        size = found.comparison.problem.amplitude(one.effect)
        told = "–" if one.seen_from is None else words.quantity(one.seen_from, 0.0, size.unit, size.name)
        rows.append((words.called([unchanged(one.effect)]), told))
    return Grid(("change", "seen from"), tuple(rows))
