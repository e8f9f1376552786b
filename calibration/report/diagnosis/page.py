"""The report of `spinbench diagnose`: one self-contained HTML page that reads top down, and one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from calibration.data.rows_used import few_used, in_words_of
from calibration.diagnosis.document import NOTHING, next_tests_as_json
from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.steps.misread import MISREAD
from calibration.diagnosis.steps.verdict import VerdictKind
from calibration.report import along_dates, style
from calibration.report.diagnosis import figures as draw
from calibration.report.diagnosis import numbers, sets, words
from calibration.report.fit.words import LEAST_P, figure, percent, probability, rounded
from calibration.report.origin import name_of, origins
from calibration.report.render import HTML, PNG, Grid, inline, render, step_times, versions
from calibration.report.sets_in_words import in_a_row, title, titles
from calibration.report.units import CAUTION, FAMILIAR, how_taken, on_an_axis, promise_in_short
from model.effects import effects
from model.effects.effect import EffectParameter
from rig.recording import Recording
from rig.recording.columns import IN_SI
from rig.recording.origin import parsed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JSON = "diagnosis.json"
PLURAL = {"plateau": "plateaus", "zero": "zeros", "run in time": "runs in time"}
CERTAIN = 1e6  # odds that are told no further
MOST = 12  # rows of a table
CLEAR = 0.6  # share of what speaks against a rival, from which one file is said to do it


@dataclass(frozen=True)
class OwnPage:
    """The page of one of several recordings.

    `holds`: what was measured there, in words.
    `is_this`: whether it is the page that this stands on.
    """

    name: str
    file: str
    holds: str
    is_this: bool

    @property
    def address(self) -> str:
        """The file as a link has it."""
        return quote(self.file)


def holds(recording: Recording) -> str:
    """What was measured, in words."""
    count = {kind: sum(one.rows for one in recording.files if one.kind == kind) for kind in ("steady", "zero")}
    said = {"plateau": count["steady"], "zero": count["zero"]}
    said["run in time"] = sum(one.kind == "transient" for one in recording.files)
    words = [f"{n} {one}" if n == 1 else f"{n} {PLURAL[one]}" for one, n in said.items() if n]
    heavy = recording.added_inertia_kg_m2
    return ", ".join([*words, *([f"with a flywheel of {heavy:.3g} kg m²"] if heavy else [])])


def report(found: Diagnosis, document: Mapping[str, Any], pages: Sequence[OwnPage] = ()) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``.

    `pages`: of several recordings that of each, for links to them.
    """
    models, curves, intervals = numbers.models(found), numbers.curves(found), sets.frictions(found, document)
    figures: dict[str, bytes] = {}
    if numbers.coordinates(found) and numbers.channels(found):
        figures["units"] = draw.residuals(found, models, False)
        figures["whitened"] = draw.residuals(found, models, True)
    if numbers.of_motor(found).problem.blocks.runs:
        figures["runs"] = draw.runs(found, models)
    if np.isfinite(numbers.of_motor(found).problem.blocks.standing.pressure).any():
        figures["held"] = draw.held_rotor(found, models)
    if curves:
        figures["forces"] = draw.forces(curves)
    if len(found.candidates) > 1:
        figures["odds"] = draw.ranked(found)
    if intervals:
        figures["friction"] = draw.friction(found, intervals)
    if panels := _panels(document):
        figures["along"] = along_dates.picture(panels)
    filled = context(found, document)
    if pages:
        filled["name"] = " and ".join(one.name for one in pages)
    pictures = {name: inline(one) for name, one in figures.items()}
    return {
        HTML: page(filled | {"figures": pictures, "models": [one.name for one in models], "pages": pages}),
        PNG: style.png(draw.essentials(found, models, curves, intervals, filled["verdict"])),
    }


def picture(found: Diagnosis, document: Mapping[str, Any]) -> Figure:
    """The one picture of a diagnosis."""
    said = words.sentence(document, sets.at_top(found, found.verdict.chosen), _excluded(found, document))
    intervals = sets.frictions(found, document)
    return draw.essentials(found, numbers.models(found), numbers.curves(found), intervals, said)


def page(filled: Mapping[str, Any]) -> bytes:
    """The page, every text in it escaped."""
    return render("diagnosis.html.j2", filled)


def context(found: Diagnosis, document: Mapping[str, Any]) -> dict[str, Any]:
    """The texts and tables of the page."""
    problem, held_out = numbers.of_motor(found).problem, document["improvement"]["held_out"]
    return {
        "name": name_of([problem.recording]),
        "origins": origins([problem.recording]),
        "motor": problem.motor.name,
        "description": problem.motor.description,
        "kind": document["verdict"],
        "verdict": words.sentence(document, sets.at_top(found, found.verdict.chosen), _excluded(found, document)),
        "certainty": _certainty(found, document),
        "rivals": _rivals(found, document),
        "used": in_words_of([problem.recording], found.comparison.rows_used()),
        "suspects": _suspect_table(document),
        "places": _place_table(document),
        "markers": draw.markers_in_words(found),
        "unseen": document["not_observable"],
        "stability": words.stability_in_words(found.term.stability) if found.term else "",
        "law": words.law_in_words(document["term"]) if document["term"] else "",
        "candidates": _candidate_table(found),
        "held_out": sets.gain_in_words(held_out) if held_out else "",
        "scheme": held_out["scheme"] if held_out else "",
        "errors": _error_table(held_out) if held_out else None,
        "bias": sets.bias_in_words(document),
        "blind": sets.blind_in_words(found),
        "reference": _reference(found),
        "frictions": _friction_table(found, document),
        "resolves": _resolve_table(found),
        "tests": _test_table(found, False),
        "apart": _test_table(found, True),
        "caution": CAUTION,
        "promised": _promise_table(document),
        "notes": [*few_used(document.get("files", [])), *dict.fromkeys(problem.blocks.measured.notes)],
        "seconds": step_times(found.seconds),
        "instruments": _instrument_table(found),
        "versions": versions(),
        "sha256": problem.recording.sha256,
        "pages": (),
    }


def _panels(document: Mapping[str, Any]) -> list[along_dates.Panel]:
    """The size of each effect that each recording has for itself, along the dates."""
    made = []
    for effect in document["effects"]:
        if "recordings" not in effect:
            continue
        size, points = effects()[effect["id"]].amplitude, []
        factor, unit = on_an_axis(size.unit, size.name)
        for one in effect["recordings"]:
            told = one["parameters"][size.name]
            mean, low, high = (factor * told[key] for key in ("mean", "q05", "q95"))
            points.append(along_dates.Point(one["recording"], parsed(one["date"]), mean, low, high))
        made.append(along_dates.Panel(effects()[effect["id"]].title, size.text or size.name, unit, points))
    return made


def _certainty(found: Diagnosis, document: Mapping[str, Any]) -> str:
    p = document["mismatch"]["p_value"]
    beyond = " (beyond the draws: from a fitted tail)" if document["mismatch"].get("beyond_the_draws") else ""
    if document["verdict"] == "consistent":
        return f"A recording that the model explains would look worse than this one in {percent(p)} of all cases."
    chance = percent(p) if p >= LEAST_P else "less than one in a million"
    said = f"If nothing were left out, a mismatch as large would come by chance in {chance} of all cases{beyond}."
    if document["verdict"] == "unresolved":
        return said
    share, known = (
        probability(one).replace("> ", "above ") for one in (found.verdict.set_probability, document["set_probability"])
    )
    if found.verdict.chosen is None:
        return (
            f"{said} The probability that these readings alone are off is {known}, as such verdicts have turned out in "
            "blind tests."
        )
    this = "the first of these sets" if document["verdict"] == "confounded" else "this set"
    more = "" if () in found.verdict.alternatives else ", alone or with more,"
    return (
        f"{said} The probability that {this} is there{more} is {known}, by how often sets came true in blind tests "
        f"({share} among all that were weighed)."
    )


def _excluded(found: Diagnosis, document: Mapping[str, Any]) -> str:
    """The nearest set that a named verdict excludes, with the file that speaks most against it."""
    chosen = found.verdict.chosen
    if document["verdict"] != "named" or chosen is None:
        return ""
    rivals = (c for c in found.candidates if c.names and not set(chosen.names) <= set(c.names) and not c.refused)
    one = next((c for c in rivals if len(c.names) <= len(chosen.names)), None)
    if one is None:
        return ""
    odds = sets.odds(found, one)
    file, share = sets.told_by(found, one)
    is_clear = share >= CLEAR and numbers.of_motor(found).problem.blocks.runs and not _are_several(document)
    by = f", by {file} above all" if is_clear else ""
    return f"Excluded with odds of {_odds(odds)}{by}: {titles(one.names)}."


def _are_several(document: Mapping[str, Any]) -> bool:
    """Whether a diagnosis is of several recordings, whose files stand with their names."""
    return len({one["file"].rpartition("/")[0] for one in document["files"]}) > 1


def _rivals(found: Diagnosis, document: Mapping[str, Any]) -> list[str]:
    """What each set of a confounded verdict would say, were it alone."""
    if document["verdict"] != "confounded":
        return []
    listed = [tuple(e["id"] for e in document["effects"]), *(tuple(names) for names in document["alternatives"])]
    by_names = {frozenset(c.names): c for c in found.candidates}
    said: list[str] = []
    for names in listed[:MOST]:
        one = by_names.get(frozenset(names) - {MISREAD})
        size = f": {sets.sizes(found, one)}" if one is not None and one.names else ""
        size += "".join(f"; that is {there}" for there in sets.at_top(found, one).values())
        said.append(f"Either {titles(names)}{size}." if not said else f"Or {titles(names)}{size}.")
    return said


def _reference(found: Diagnosis) -> str:
    """The set that odds are of, in words."""
    if found.verdict.chosen is not None:
        return "the set that the verdict rests on"
    return "the likeliest set" + " (the verdict rests on none)" * (found.verdict.kind == VerdictKind.UNRESOLVED)


def _suspect_table(document: Mapping[str, Any]) -> Grid:
    rows = tuple(
        (row["file"], row["channel"], str(row["row"]), probability(row["probability"]))
        for row in document.get("suspect_rows", [])
    )
    return Grid(("file", "channel", "row", "probability of being bad"), rows, 2)


def _place_table(document: Mapping[str, Any]) -> Grid:
    rows = tuple(
        (
            words.ERRORS[place["balance"]],
            place["channel"]
            + f" in {place['file']}" * (place["coordinate"] == "phase")
            + (f" of {place['recording']}" if place["recording"] else ""),
            place["coordinate"],
            "" if place["coordinate"] == "direction" else words.span_in_words(place),
            ", ".join(place["same_as"]) or "nothing",
            words.p_in_words(place["p_value"]).removeprefix("p = ").removeprefix("p "),
        )
        for place in document["located"]
    )
    return Grid(("what is off", "seen in", "along", "where", "cannot be told from", "p"), rows, 5)


def _candidate_table(found: Diagnosis) -> Grid:
    rows = []
    for one in found.candidates[:MOST]:
        p = found.residual_p.get(one.names)
        left = "not tested" if p is None else words.p_in_words(p)
        rows.append(
            (
                " + ".join(one.names) or "base model: nothing left out",
                sets.sizes(found, one) or "",
                f"refused: {one.refused}" if one.refused else left,
                _odds(sets.odds(found, one)),
                probability(one.probability) if one.probability >= 1e-3 else words.quantity(one.probability, 0.0, ""),
            )
        )
    return Grid(("set", "size", "what it leaves", "odds", "probability"), tuple(rows), 3)


def _error_table(held_out: Mapping[str, Any]) -> Grid:
    rows = []
    for key, before in held_out["rmse_before"].items():
        quantity = IN_SI[key]
        familiar, factor = FAMILIAR[quantity.si]
        after = held_out["rmse_after"].get(key, before)
        rows.append((quantity.channel, f"{before * factor:.3g} {familiar}", f"{after * factor:.3g} {familiar}"))
    return Grid(("held-out error, rms", "before", "after"), tuple(rows))


def _friction_table(found: Diagnosis, document: Mapping[str, Any]) -> Grid:
    rows = tuple(
        (
            one.name,
            words.quantity(one.mean, one.sd, "N m s"),
            rounded(one.q05, one.sd),
            rounded(one.q95, one.sd),
        )
        for one in sets.frictions(found, document)
    )
    return Grid(("f_overall", "mean ± sd", "5 %", "95 %"), rows)


def _resolve_table(found: Diagnosis) -> Grid:
    """What the recording can tell of each effect: from which size on it is seen, and told from its nearest rival."""

    def told(size: float | None, parameter: EffectParameter) -> str:
        return "-" if size is None else words.quantity(size, 0.0, parameter.unit, parameter.name)

    rows = tuple(
        (
            title(one.effect),
            told(one.seen_from, effects()[one.effect].amplitude),
            told(one.told_from, effects()[one.effect].amplitude),
            f"{title(one.nearest)}: {one.rho:.2f}" if one.nearest else "",
        )
        for one in found.resolved
    )
    return Grid(("effect", "seen from", "named from", "most like it: correlation"), rows)


def _test_table(found: Diagnosis, apart: bool) -> Grid:
    """Tests with what they would tell and how often they have to be taken; those that need something else apart."""
    rows = tuple(
        (
            f"{test.test}: {how_taken(told)}",
            in_a_row([names or (NOTHING,) for names in test.separates], "and"),
            promise_in_short(told),
            "some pair stays open" if test.repeats is None else str(test.repeats),
        )
        for test, told in zip(found.next_tests, next_tests_as_json(found.next_tests), strict=True)
        if bool(test.needs) == apart
    )
    return Grid(("test", "tells apart", "nats", "times to take it"), rows, 2)


def _promise_table(document: Mapping[str, Any]) -> Grid:
    """Tests that were asked for and taken: what each promised and what it gave."""
    rows = tuple(
        (one["test"], f"{one['information_nats']:.1f}", f"{one['delivered_nats']:.1f}")
        for one in document.get("promised", [])
    )
    return Grid(("test", "promised, nats", "given, nats"), rows, 1)


def _instrument_table(found: Diagnosis) -> Grid:
    rows = tuple(
        (
            column,
            figure(one.noise_sd),
            figure(one.bias_sd),
            f"{figure(100 * one.scale_sd)} %",
            figure(one.resolution),
        )
        for column, one in found.comparison.problem.recording.channels.items()
    )
    return Grid(("column", "noise, 1 sd", "offset, 1 sd", "scale, 1 sd", "resolution"), rows)


def _odds(odds: float) -> str:
    """Odds of the set that the verdict rests on against another, to two digits."""
    larger = odds if odds >= 1.0 else 1.0 / max(odds, 0.1 / CERTAIN)
    told = float(f"{larger:.2g}")
    shown = "over 10⁶" if larger > CERTAIN else f"{told:.0f}" if told >= 10.0 else f"{told:g}"
    return f"{shown} : 1" if odds >= 1.0 else f"1 : {shown}"
