"""A diagnosis as a table for the terminal; it reads diagnosis/1 alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from calibration.report.diagnosis import words
from calibration.report.sets_in_words import titles
from model.effects import effects

if TYPE_CHECKING:
    from rich.table import Table


def table(found: Mapping[str, Any]) -> Table:
    """Effects, alternatives, place, friction and next tests."""
    from rich.markup import escape
    from rich.table import Table

    made = Table("what", "finding", show_header=False)
    made.add_row("verdict", f"{found['verdict']} ({words.p_in_words(found['mismatch']['p_value'])})")
    for effect in found["effects"]:
        made.add_row(effect["id"], escape(f"probability {effect['probability']:.3f}; {figures(effect)}".rstrip("; ")))
    for names in found["alternatives"][: words.MOST_ROWS]:
        made.add_row("or", titles(names))
    for place in found["located"][: words.MOST_ROWS]:
        made.add_row("where", words.place_in_words(place))
    if found["term"]:
        made.add_row("law found", f"{words.law_in_words(found['term'])} ({found['term']['balance']})")
    for row in found.get("suspect_rows", [])[: words.MOST_ROWS]:
        made.add_row("bad reading", escape(words.reading_in_words(row)))
    held_out = (found.get("improvement") or {}).get("held_out")
    if held_out:
        over = f"over {held_out['folds']} folds (cross-validated)"
        on = f"on an {held_out['scheme']}" if words.is_unseen(held_out) else over
        made.add_row("held out", escape(f"log score changed {on} by {words.gain_in_figures(held_out)}"))
    for key, said in (
        ("f_overall_before", "f_overall, base model"),
        ("f_overall_after", "f_overall, effects weighed in"),
    ):
        if found[key]:
            made.add_row(said, words.quantity(found[key]["mean"], found[key]["sd"], "N m s"))
    for one in found.get("promised", []):
        told = f"promised {one['information_nats']:.1f} nats, gave {one['delivered_nats']:.1f}"
        made.add_row("test taken", f"{one['test']}: {told}")
    for test in found["next_tests"][: words.MOST_ROWS]:
        made.add_row("next test", f"{test['test']} ({test['information_nats']:.1f} nats)")
        if test["command"]:
            made.add_row("", escape(test["command"]))
    return made


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
