"""What a comparison says, in the words of a person; it reads comparison/1 alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from calibration.report.diagnosis.table import tests
from calibration.report.diagnosis.words import p_in_words, quantity, reading_in_words
from calibration.report.fit.words import probability
from calibration.report.render import findings
from calibration.report.sets_in_words import listed, titles
from model.effects import effects

if TYPE_CHECKING:
    from rich.table import Table

MOST_ROWS = 6
F_OVERALL = "f_overall"
LEAST = 1e-3  # probability that is told as such


def sentence(found: Mapping[str, Any]) -> str:
    """The answer as a person would say it."""
    return f"{_answer(found)}{_stands_out(found)}"


def _stands_out(found: Mapping[str, Any]) -> str:
    """The readings that are taken for bad, in a sentence after a space; empty where there are none."""
    rows = [reading_in_words(row) for row in found["suspect_rows"]]
    if not rows:
        return ""
    more = [f"{len(rows) - MOST_ROWS} more"] * (len(rows) > MOST_ROWS)
    return f" Taken for bad: {listed([*rows[:MOST_ROWS], *more])}."


def _answer(found: Mapping[str, Any]) -> str:
    verdict, p = found["verdict"], p_in_words(found["mismatch"]["p_value"])
    first, *others = found["explanations"] or [None]
    both = f" Both have {titles(first['shared'])}." if first and first["shared"] else ""
    if verdict == "unchanged":
        sure = chance(found["unchanged_probability"])
        return f"Nothing changed, by what these recordings tell: the probability of it is {sure} ({p}).{both}"
    if verdict == "unresolved":
        return (
            f"The recordings do not go together ({p}), and no change and no effect in the list explains it. "
            "Diagnose each by itself."
        )
    said = [called(one["changed"]) or "nothing" for one in (first, *others[: MOST_ROWS - 1])]
    if verdict == "changed":
        return f"What changed is {said[0]}: {moves(found, first)}.{both}"
    may = "Something changed" if verdict == "confounded" else "Something may have changed"
    either = ", or ".join(dict.fromkeys(said))
    if_first = f" If it is the first: {moves(found, first)}." if first["changed"] else ""
    return f"{may} ({p}), and these recordings cannot tell which it is: {either}.{if_first}"


def mismatch(found: Mapping[str, Any]) -> str:
    """How far the readings are from one motor that did not change, in a sentence."""
    return f"Readings as far from one motor that did not change: {p_in_words(found['mismatch']['p_value'])}."


def called(names: Sequence[str]) -> str:
    """Changes as a person calls them."""
    return listed([_called(name) for name in names])


def _called(name: str) -> str:
    if name in effects():
        return f"“{effects()[name].title}” ({name})"
    return name if name == F_OVERALL else f"the {bare(name)}"


def bare(name: str) -> str:
    """The name of a parameter of the motor, for an axis."""
    return name if name == F_OVERALL else name.replace("_", " ")


def chance(value: float) -> str:
    """A probability that is never shown as certain, nor as nothing."""
    return probability(value) if value >= LEAST else f"below {LEAST:g}"


def called_set(one: Mapping[str, Any]) -> str:
    """A set of changes, and of effects that both recordings have."""
    changed = f"{called(one['changed'])} changed" if one["changed"] else "nothing changed"
    return f"{changed}; both with {titles(one['shared'])}" if one["shared"] else changed


def moves(found: Mapping[str, Any], explanation: Mapping[str, Any]) -> str:
    """What the changes of a set are, with their figures."""
    parameters = {one["id"]: one["parameters"] for one in found["changes"]}
    return "; ".join(
        f"{parameter} {moved_in_words(parameter, one)}"
        for name in explanation["changed"]
        for parameter, one in parameters[name].items()
    )


def moved_in_words(parameter: str, one: Mapping[str, Any]) -> str:
    """A quantity before and after."""
    before, after, change = (figure(parameter, one, key) for key in ("before", "after", "change"))
    share, mean = "", one["before"]["mean"]
    if abs(mean) > one["before"]["sd"] and mean * one["after"]["mean"] > 0.0:  # no share of what lies about 0
        share = f", {100.0 * one['change']['mean'] / mean:+.1f} %".replace("-", "−")
    return f"was {before} and is {after} (a change of {change}{share})"


def figure(parameter: str, one: Mapping[str, Any], key: str) -> str:
    """A mean with its sd and unit."""
    unit = "-" if one["unit"] == "1" else one["unit"]
    return quantity(one[key]["mean"], one[key]["sd"], unit, parameter)


def table(found: Mapping[str, Any]) -> Table:
    """The answer, its rivals and the figures, for the terminal."""
    rows = [("verdict", f"{found['verdict']} ({p_in_words(found['mismatch']['p_value'])})")]
    if found["unchanged_probability"] is not None:
        rows.append(("nothing changed", f"probability {chance(found['unchanged_probability'])}"))
    rows += [("bad reading", reading_in_words(row)) for row in found["suspect_rows"][:MOST_ROWS]]
    sets = found["explanations"][:MOST_ROWS]
    rows += [("explanation", f"{called_set(one)} ({chance(one['probability'])})") for one in sets]
    for change in found["changes"][:MOST_ROWS]:
        for parameter, one in change["parameters"].items():
            words = f"{parameter}: {figure(parameter, one, 'before')} -> {figure(parameter, one, 'after')}"
            rows.append((f"if {called([change['id']])}", f"{words} (probability {chance(change['probability'])})"))
    return findings([*rows, *tests(found)])
