"""What a diagnosis says, in the words of a person and as a table for the terminal; it reads diagnosis/1 alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from model.effects import effects

if TYPE_CHECKING:
    from rich.table import Table

MOST_ROWS = 6


def sentence(found: Mapping[str, Any]) -> str:
    """The verdict in one sentence.

    Parameters
    ----------
    found : mapping
        A diagnosis/1.
    """
    named = [effect["id"] for effect in found["effects"]]
    p = found["mismatch"]["p_value"]
    if found["verdict"] == "consistent":
        return f"The model explains the recording (p = {p:.2g}); nothing has to be added."
    if found["verdict"] == "named":
        return " ".join(_of(effect) for effect in found["effects"])
    if found["verdict"] == "confounded":
        rivals = [titles(named), *(titles(names) for names in found["alternatives"])]
        return f"Something is left out (p = {p:.2g}), and this recording cannot tell {' from '.join(rivals)}."
    return f"Something is left out (p = {p:.2g}), and no effect in the list explains it."


def titles(names: Sequence[str]) -> str:
    """Effects as people call them.

    Parameters
    ----------
    names : sequence of str
        Effect ids.
    """
    return " with ".join(effects()[name].title if name in effects() else name for name in names) or "nothing"


def table(found: Mapping[str, Any]) -> Table:
    """Effects, alternatives, place, friction and next tests.

    Parameters
    ----------
    found : mapping
        A diagnosis/1.
    """
    from rich.table import Table

    made = Table("what", "finding", show_header=False)
    made.add_row("verdict", f"{found['verdict']} (p = {found['mismatch']['p_value']:.2g})")
    for effect in found["effects"]:
        made.add_row(effect["id"], f"probability {effect['probability']:.3f}; {_figures(effect)}")
    for names in found["alternatives"][:MOST_ROWS]:
        made.add_row("or", titles(names))
    for place in found["located"][:MOST_ROWS]:
        made.add_row("where", str(place["sentence"]))
    if found["term"]:
        made.add_row("law found", f"{found['term']['expression']} {found['term']['unit']} ({found['term']['balance']})")
    held_out = (found.get("improvement") or {}).get("held_out")
    if held_out:
        gain = f"{held_out['elpd_gain']:.1f} +- {held_out['elpd_gain_se']:.1f}"
        made.add_row("held out", f"log score gained {gain} over {held_out['folds']} folds (cross-validated)")
    for key, words in (
        ("f_overall_before", "f_overall, base model"),
        ("f_overall_after", "f_overall, effects weighed in"),
    ):
        if found[key]:
            made.add_row(words, f"{found[key]['mean']:.4f} +- {found[key]['sd']:.4f} N m s")
    for test in found["next_tests"][:MOST_ROWS]:
        made.add_row("next test", f"{test['test']} ({test['information_nats']:.1f} nats)")
    return made


def _of(effect: Mapping[str, Any]) -> str:
    """An effect's own sentence with its figures."""
    known = effects().get(effect["id"])
    if known is None:
        return "An effect that is in no list."
    units = {parameter.name: parameter.unit for parameter in known.parameters}
    words = {
        name: f"{one['mean']:.3g} ± {one['sd']:.2g} {units.get(name, '')}" for name, one in effect["parameters"].items()
    }
    text = known.sentence
    for name, shown in words.items():
        text = text.replace("{" + name + "}", shown.removesuffix(" -").strip())
    return text


def _figures(effect: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {one['mean']:.3g} +- {one['sd']:.2g}" for name, one in effect["parameters"].items())
