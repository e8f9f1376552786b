"""What a diagnosis of a machine says, in words and as a table for the terminal; a slide has its own units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from calibration.report.render import findings
from calibration.report.sets_in_words import alternatives, in_a_row, shared_and_rest, titles
from calibration.report.units import CAUTION, promise_in_words, times_to_take
from model.effects import effects
from rig.recording.columns import IN_SI

if TYPE_CHECKING:
    from rich.table import Table

LEAST_P = 1e-6  # a p-value below it is told as such: the tail that it comes from is not known better
LEFT_P = 0.01
MOST_ROWS = 6


def sentence(document: Mapping[str, Any]) -> str:
    """What is said, in a sentence or two."""
    chance = chance_in_words(document["mismatch"]["p_value"])
    named = [effect["id"] for effect in document["effects"]]
    if document["verdict"] == "consistent":
        return f"No missing effect was detected ({chance}): {document['why']}."
    if document["check"]:
        why = str(document["why"])
        return f"{why[:1].upper()}{why[1:]} ({chance}). Nothing was looked for. Check {'; '.join(document['check'])}."
    if document["verdict"] == "unresolved":
        return f"The model does not fit ({chance}), and no listed effect explains why: {document['why']}."
    if document["verdict"] == "named":
        words = f"Missing in the model ({chance}): {', '.join(_effect(one) for one in document['effects'])}."
    else:
        shared, each = shared_and_rest([named, *document["alternatives"]])
        rivals = in_a_row(each[: MOST_ROWS + 1], "or")
        fits = "may not fit" if [] in each else "does not fit"
        why = f"what there is beside {titles(shared)}" if shared else "why"
        words = f"The model {fits} ({chance}), and this recording cannot tell {why}: {rivals}."
    left = document["left"]
    if left and left["p_value"] < LEFT_P:
        share = f"{left['share_of_mismatch']:.1%} of the mismatch"
        words += f" It leaves {share}, which has no name ({chance_in_words(left['p_value'])})."
    return words


def chance_in_words(p: float) -> str:
    """A p-value as it is told."""
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"


def table(document: Mapping[str, Any]) -> Table:
    """Effects, rivals, place, held-out errors, friction and next tests."""
    rows = [("verdict", f"{document['verdict']} ({chance_in_words(document['mismatch']['p_value'])})")]
    rows += [
        (one["id"], f"probability {one['probability']:.3f}; {_figures(one)}".rstrip("; "))
        for one in document["effects"]
    ]
    rows += alternatives(document, MOST_ROWS)
    rows += [("where", place["sentence"]) for place in document["located"][:MOST_ROWS]]
    for i, said in enumerate(held_out_in_words(document)):
        rows.append((f"held out, {document['improvement']['held_out']['scheme']}" if i == 0 else "", said))
    rows += friction_in_words(document)
    for test in document["next_tests"][:MOST_ROWS]:
        rows += [("next test", f"{test['test']} ({promise_in_words(test)})"), ("", times_to_take(test))]
    return findings([*rows, ("note", CAUTION)] if document["next_tests"] else rows)


def held_out_in_words(document: Mapping[str, Any]) -> list[str]:
    """The errors on held-out readings by channel, and the gain; nothing where none were held out."""
    held_out = document["improvement"]["held_out"]
    if not held_out:
        return []
    said = []
    for key, before in held_out["rmse_before"].items():
        unit, factor = _unit(key)
        after, size = held_out["rmse_after"][key], held_out["rms_of_readings"][key]
        shares = f": from {before / size:.1%} to {after / size:.1%} of the readings" if before < size else ""
        said.append(f"error from {before * factor:.3g} to {after * factor:.3g}{unit}{shares}")
    gain = f"{held_out['elpd_gain']:.1f} ± {held_out['elpd_gain_se']:.1f}"
    of_figures = held_out.get("elpd_gain_of_declared_figures")
    more = f", and {of_figures:.1f} over the declared figures" if of_figures is not None else ""
    return [*said, f"log likelihood of unseen readings {gain}, in {held_out['folds']} block(s){more}"]


def _unit(key: str) -> tuple[str, float]:
    """The unit that an error is told in, behind a space, and the factor to it; a speed as effects have theirs."""
    known = IN_SI.get(key)
    if known is None:
        return "", 1.0
    return (f" {known.si}", 1.0) if known.channel == "speed" else (f" {known.unit}", 1.0 / known.to_si)


def friction_in_words(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Viscous friction of the base model and after, with their names."""
    named = (("f_overall_before", "viscous friction, base"), ("f_overall_after", "viscous friction, after"))
    return [
        (words, f"{document[key]['mean']:.4g} ± {document[key]['sd']:.2g} {document['friction_unit']}")
        for key, words in named
        if document[key]
    ]


def _effect(effect: Mapping[str, Any]) -> str:
    figures = _figures(effect)
    return effects()[effect["id"]].title + (f" ({figures})" if figures else "")


def _figures(effect: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} {one['mean']:.3g} ± {one['sd']:.2g} {one['unit']}".removesuffix(" -")
        for name, one in effect["parameters"].items()
    )
