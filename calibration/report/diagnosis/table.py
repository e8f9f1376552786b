"""A diagnosis as a table for the terminal; it reads diagnosis/1 alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from calibration.diagnosis.steps.confirm import Predicted
from calibration.report.diagnosis import words
from calibration.report.render import findings
from calibration.report.sets_in_words import alternatives
from calibration.report.units import CAUTION, how_taken, nats_in_words, promise_in_words, times_to_take
from model.effects import effects

if TYPE_CHECKING:
    from rich.table import Table


def table(found: Mapping[str, Any]) -> Table:
    """Effects, alternatives, place, friction and next tests."""
    said = f"{found['verdict']} ({words.p_in_words(found['mismatch']['p_value'])})"
    if found["verdict"] in ("named", "confounded"):
        said += f"; probability {found['set_probability']:.2f}, by how often such verdicts came true in blind tests"
    rows = [("verdict", said), *((one["id"], figures(one)) for one in found["effects"])]
    rows += alternatives(found, words.MOST_ROWS)
    rows += [("where", words.place_in_words(place)) for place in found["located"][: words.MOST_ROWS]]
    if found["term"]:
        rows.append(("law found", f"{words.law_in_words(found['term'])} ({found['term']['balance']})"))
    rows += [("bad reading", words.reading_in_words(row)) for row in found.get("suspect_rows", [])[: words.MOST_ROWS]]
    held_out = (found.get("improvement") or {}).get("held_out")
    if held_out:
        unseen = held_out["kind"] == Predicted.UNSEEN_RUN
        which = f"an {held_out['scheme']}" if unseen else f"unseen readings, in {held_out['folds']} folds,"
        rows.append(("held out", f"{which} predicted {words.gain_in_figures(held_out)}"))
    for key, said in (
        ("f_overall_before", "f_overall, base model"),
        ("f_overall_after", "f_overall, effects weighed in"),
    ):
        if found[key]:
            rows.append((said, words.quantity(found[key]["mean"], found[key]["sd"], "N m s")))
    for one in found.get("promised", []):
        promised, gave = (nats_in_words(one[key]) for key in ("information_nats", "delivered_nats"))
        rows.append(("test taken", f"{one['test']}: promised {promised}; gave {gave}"))
    return findings([*rows, *tests(found)])


def tests(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The tests that are asked for, each with its command or why there is none."""
    rows = []
    for test in found["next_tests"][: words.MOST_ROWS]:
        rows.append(("next test", f"{test['test']} ({promise_in_words(test)})"))
        rows += [("", times_to_take(test)), ("", how_taken(test))]
    return [*rows, ("note", CAUTION)] if rows else rows


def figures(effect: Mapping[str, Any]) -> str:
    """An effect's parameters with their uncertainties."""
    if "recordings" in effect:
        return words.of_each_in_words(effect)
    known = effects().get(effect["id"])
    units = {parameter.name: parameter.unit for parameter in known.parameters} if known else {}
    parts = (
        f"{name} {words.quantity(one['mean'], one['sd'], units.get(name, '-'), name)}"
        for name, one in effect["parameters"].items()
    )
    return ", ".join(parts)
