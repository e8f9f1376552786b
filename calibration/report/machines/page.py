"""The report of a diagnosis of another rig: one self-contained HTML page that reads top down."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.data.rows_used import few_used
from calibration.diagnosis.result import Diagnosis
from calibration.report import style
from calibration.report.fit.words import probability
from calibration.report.machines import words
from calibration.report.machines.picture import picture
from calibration.report.origin import origins
from calibration.report.render import HTML, PNG, Grid, inline, render, step_times, versions
from calibration.report.sets_in_words import in_a_row
from calibration.report.units import CAUTION, promise_in_short
from model.effects import effects

MOST = 12  # rows of a table


def report(found: Diagnosis, document: Mapping[str, Any]) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``."""
    drawn = style.png(picture(found))
    return {HTML: render("rig_diagnosis.html.j2", context(found, document) | {"picture": inline(drawn)}), PNG: drawn}


def context(found: Diagnosis, document: Mapping[str, Any]) -> dict[str, Any]:
    """The texts and tables of the page."""
    recording = found.comparison.problem.recording
    return {
        "name": recording.folder.resolve().name,
        "origins": origins([recording]),
        "rig": str(document["rig"]).replace("_", " "),
        "kind": document["verdict"],
        "verdict": words.sentence(document),
        "why": document["why"],
        "findings": Grid(("parameter", "mean ± sd", "5 %", "95 %"), tuple(_parameters(document))),
        "places": Grid(
            ("where the model is off", "p"),
            tuple((p["sentence"], _p(p["p_value"])) for p in document["located"][:MOST]),
        ),
        "candidates": Grid(
            ("set", "what it leaves, p", "share of the mismatch left", "probability"), tuple(_sets(found))
        ),
        "held_out": words.held_out_in_words(document),
        "friction": Grid(("viscous friction, or its like", "mean ± sd"), tuple(words.friction_in_words(document))),
        "caution": CAUTION,
        "tests": Grid(("test", "tells", "nats"), tuple(_tests(document)), 2),
        "nuisances": Grid(("what is free beside it", "mean ± sd"), tuple(_nuisances(document))),
        "noise": Grid(
            ("readings", "noise over the declared", "correlation of neighbours"),
            tuple((n["readings"], f"{n['scale']:.2f}", f"{n['correlation']:.2f}") for n in document["noise"]),
        ),
        "notes": list(dict.fromkeys([*few_used(document["files"]), *recording.warnings])),
        "files": Grid(
            ("file", "rows used", "why not the rest"),
            tuple((one["file"], f"{one['rows_used']} of {one['rows']}", one["why"]) for one in document["files"]),
        ),
        "seconds": step_times(found.seconds),
        "versions": versions(),
        "sha256": recording.sha256,
    }


def _p(value: float) -> str:
    return words.chance_in_words(value).removeprefix("p = ").removeprefix("p ")


def _tests(document: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (t["test"], in_a_row([one.split("+") for one in t["separates"]], "and"), promise_in_short(t))
        for t in document["next_tests"][:MOST]
    ]


def _nuisances(document: Mapping[str, Any]) -> list[tuple[str, ...]]:
    free = document["nuisances"].items()
    return [(name, f"{one['mean']:.4g} ± {one['sd']:.2g} {one['unit']}") for name, one in free]


def _parameters(document: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            f"{effects()[effect['id']].title}: {name}" if effect["id"] in effects() else name,
            f"{one['mean']:.4g} ± {one['sd']:.2g} {one['unit']}".removesuffix(" -"),
            f"{one['q05']:.4g}",
            f"{one['q95']:.4g}",
        )
        for effect in document["effects"]
        for name, one in effect["parameters"].items()
    ]


def _sets(found: Diagnosis) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for one in found.candidates[:MOST]:
        p, left = found.residual_p.get(one.names), found.left.get(one.names)
        rows.append(
            (
                " + ".join(one.names) or "base model: nothing left out",
                f"refused: {one.refused}" if one.refused else "not tested" if p is None else _p(p),
                "" if left is None else f"{left:.1%}",
                probability(one.probability) if one.probability >= 1e-3 else f"{one.probability:.0e}",
            )
        )
    return rows
