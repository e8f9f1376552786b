"""What a diagnosis says, in the words of a person; it reads diagnosis/1 alone."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from calibration.diagnosis.steps.locate import Kind
from calibration.report.fit.words import p_in_words, rounded, uncertainty
from calibration.report.sets_in_words import in_a_row, listed, shared_and_rest, titles
from calibration.report.units import FAMILIAR, RAISED, for_people, powers
from configs.units import BAR
from model.effects import effects

MOST_ROWS = 6
ERRORS = {"torque": "torque error", "mass": "flow error", "sensor": "error of an instrument"}
OTHER_WAY = {"low": "high", "smaller": "larger"}
VARIABLES = (("omega", "ω", "rad/s"), ("P", "P", "Pa"), ("t", "t", "s"), ("theta", "θ", "rad"))


def sentence(found: Mapping[str, Any], at_top: Mapping[str, str] | None = None, excluded: str = "") -> str:
    """The verdict as a person would say it.

    `at_top`: what an effect amounts to at the highest level, by its id, for laws whose figure says nothing to a person.
    `excluded`: what is excluded, in a sentence, for a verdict that names.
    """
    verdict, chance = found["verdict"], p_in_words(found["mismatch"]["p_value"])
    if verdict == "consistent":
        likely = [one["effects"] for one in found.get("rivals", []) if one["effects"]]
        also = f" Still possible: {in_a_row(likely, 'and')}." if likely else ""
        rows = listed([reading_in_words(row) for row in found.get("suspect_rows", [])[:MOST_ROWS]])
        stands_out = f" Noise with heavy tails would explain what stands out: {rows}." if rows else ""
        return f"No missing effect was detected ({chance}).{also}{stands_out}"
    if verdict == "named":
        said = [effect_in_words(one, at_top or {}) for one in found["effects"]]
        if any(one["id"] == "bad_reading" for one in found["effects"]):
            said.append(f"{listed([reading_in_words(row) for row in found.get('suspect_rows', [])[:MOST_ROWS]])}.")
        return " ".join([*said, excluded]).strip()
    if verdict == "confounded":
        return _confounded(found, chance)
    if found.get("check"):
        why = str(found["why"])
        return f"{why[:1].upper()}{why[1:]} ({chance}). Nothing was looked for. Check {'; '.join(found['check'])}."
    words = f"The model does not fit ({chance}), and no effect in the list explains why."
    if found["located"]:
        words += f" {place_in_words(found['located'][0])}"
    if found["term"]:
        words += f" A law found there: {law_in_words(found['term'])}."
    return words


def _confounded(found: Mapping[str, Any], chance: str) -> str:
    """What fits, the most probable first, and what would decide."""
    named = [effect["id"] for effect in found["effects"]]
    shared, (first, *others) = shared_and_rest([named, *found["alternatives"]])
    rest = len(others) - (MOST_ROWS - 1)
    more = f", or one of {rest} more" if rest > 0 else ""
    fits = "may not fit" if [] in others else "does not fit"
    beside = f"Every explanation has {titles(shared)}. Beside {'them' if len(shared) > 1 else 'it'}, most likely"
    likely = beside if shared else "Most likely"
    also = in_a_row(others[: MOST_ROWS - 1], "or")
    said = f"The model {fits} ({chance}). {likely} {titles(first)}; also possible: {also}{more}."
    if not found["next_tests"]:
        return f"{said} No test is known that would decide."
    return f"{said} To decide: {found['next_tests'][0]['test']}."


def reading_in_words(row: Mapping[str, Any]) -> str:
    """A reading by its place."""
    return f"{str(row['file'])[:40]}, row {row['row']}: {row['channel']}"


def place_in_words(place: Mapping[str, Any]) -> str:
    """Where the model is off, in a sentence."""
    sentence = str(place["sentence"])
    if place["kind"] in (Kind.ROW, Kind.STEP) or place["coordinate"] in ("phase", "angle"):
        return sentence
    if place["kind"] == Kind.METER:
        return f"{sentence.partition(', most between')[0]}, most between {span_in_words(place, 'and')}."
    alike = f"; this recording cannot tell that from {listed(place['same_as'])}" if place["same_as"] else ""
    between = "" if place["coordinate"] == "direction" else f", largest between {span_in_words(place, 'and')}"
    of = f" of {place['recording']}" if place["recording"] else ""
    return f"The {ERRORS[place['balance']]} depends on {place['coordinate']}{of}{between}{alike}."


def span_in_words(place: Mapping[str, Any], between: str = "to") -> str:
    """From where to where, in a person's unit. `between`: the word between the two figures."""
    if place["coordinate"] == "row":
        return f"row {place['where'][0]:g}"
    unit, factor = {**FAMILIAR, "Pa": ("bar abs", 1.0 / BAR)}.get(place["unit"], (place["unit"], 1.0))
    low, high = (float(f"{factor * float(end):.3g}") for end in place["where"])
    return f"{low:g} {between} {high:g} {unit}".removesuffix(" 1")


def law_in_words(term: Mapping[str, Any]) -> str:
    """A law found from the data, with its unit."""
    text = str(term["expression"])
    units = [f"{symbol} in {unit}" for name, symbol, unit in VARIABLES if re.search(rf"\b{name}\b", text)]
    for name, symbol, _ in VARIABLES:
        text = re.sub(rf"\b{name}\b", symbol, text)
    text = text.replace("+ -", "− ").replace("*", "·").replace("··", "^")
    return ", ".join([f"{text} {powers(str(term['unit']))}", *units])


def quantity(mean: float, sd: float, unit: str, name: str = "") -> str:
    """A figure with its uncertainty and unit, the uncertainty to two digits.

    `mean`, `sd`: the figure [own unit].
    `unit`: its unit; - where it has none.
    `name`: the parameter's name: shares and scales are told in percent.
    """
    mean, sd, unit = for_people(mean, sd, unit, name)
    size = max(abs(mean), sd)
    if not math.isfinite(size) or size == 0.0:
        return f"{mean:.3g} {unit}".strip()
    power = math.floor(math.log10(size))
    if sd <= 0.0:
        plain = f"{float(f'{mean:.2g}'):g}"
        digits, _, small = (plain if 1e-4 <= size < 1e4 else f"{mean:.2g}").partition("e")
        return f"{digits}{f'·10{str(int(small)).translate(RAISED)}' if small else ''} {unit}".strip().replace("-", "−")
    if -3 <= power <= 4 and sd < (1000.0 if unit == "%" else 100.0):
        return f"{rounded(mean, sd)} ± {uncertainty(sd)} {unit}".strip()
    scaled = 10.0**-power
    figures = f"{rounded(mean * scaled, sd * scaled)} ± {uncertainty(sd * scaled)}"
    return f"({figures})·10{str(power).translate(RAISED)} {unit}".strip()


def effect_in_words(effect: Mapping[str, Any], at_top: Mapping[str, str]) -> str:
    """An effect's own sentence with its figures."""
    known = effects().get(effect["id"])
    if known is None:
        return "An effect that is in no list."
    if "recordings" in effect:
        return f"{known.title[:1].upper()}{known.title[1:]}, of each recording by itself: {of_each_in_words(effect)}."
    text, units = powers(known.sentence), {parameter.name: parameter.unit for parameter in known.parameters}
    for name, one in effect["parameters"].items():
        mean = one["mean"]
        if name == known.amplitude.name and "(negative: " in text:
            text, mean = _signed(text, mean), abs(mean)
        shown = quantity(mean, one["sd"], units.get(name, "-"), name)
        text = text.replace("{" + name + "}", shown)
    if known.id == "bad_reading":
        text = text.replace("1 stand out", "One reading stands out")
    if effect["id"] in at_top:
        text = text.replace(" - ", " − ") + f" That is {at_top[effect['id']]}."
    return text


def of_each_in_words(effect: Mapping[str, Any]) -> str:
    """The parameters of an effect in each recording, along the dates."""
    units = {parameter.name: parameter.unit for parameter in effects()[effect["id"]].parameters}
    said = []
    for one in effect["recordings"]:
        figures = (
            f"{name} {quantity(size['mean'], size['sd'], units[name], name)}"
            for name, size in one["parameters"].items()
        )
        when = f" ({one['date']})" if one["date"] else ""
        said.append(f"{one['recording']}{when}: {', '.join(figures)}")
    return "; ".join(said)


def steps_in_words(seconds: Mapping[str, float]) -> str:
    """The time of each step, those of a kind together, in a line. `seconds`: ``seconds`` of a diagnosis [s]."""
    kinds: dict[str, float] = {}
    for step, one in seconds.items():
        kind = step.partition(" of ")[0]
        kinds[kind] = kinds.get(kind, 0.0) + one
    parts = [f"{step} {one:.1f} s" for step, one in kinds.items()]
    return f"{', '.join(parts)}; {sum(kinds.values()):.1f} s in all"


def gain_in_figures(held_out: Mapping[str, Any]) -> str:
    """Whether unseen readings are predicted better than by the base model, and by how much."""
    gain, error = held_out["elpd_gain"], held_out["elpd_gain_se"]
    figures = f"{rounded(gain, error)} ± {uncertainty(error)}" if error > 0.0 else f"{gain:.1f}".replace("-", "−")
    sign = "+" if gain > 0.0 else ""
    return f"{'worse' if gain < 0.0 else 'better'} than the base model ({sign}{figures} in log likelihood)"


def stability_in_words(shares: Sequence[float]) -> str:
    """How often the terms of a law were found again, in a sentence; empty where that is not known."""
    if not shares:
        return ""
    told = listed([f"{100.0 * share:.0f} %" for share in shares])
    each = "its terms were" if len(shares) > 1 else "it was"
    return f"Of recordings drawn from this one, level by level and part by part, {each} found again in {told}."


def _signed(text: str, value: float) -> str:
    """A sentence that tells of both signs, made to tell of one."""
    other = re.search(r" \(negative: (\w+)\)", text)
    if other is None:
        return text
    text = text.replace(other.group(0), "")
    return re.sub(rf"\b{OTHER_WAY[other.group(1)]}\b", other.group(1), text) if value < 0.0 else text
