"""The sets of effects that a diagnosis weighed, for its report: sizes, odds, what speaks against each, f_overall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.diagnosis.document import Q95
from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.sizes.sizes import sizes_of
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.confirm import Predicted
from calibration.diagnosis.steps.misread import MISREAD
from calibration.diagnosis.steps.verdict import VerdictKind
from calibration.fit.posterior import UNINFORMED
from calibration.report.diagnosis.numbers import of_mode, of_motor
from calibration.report.diagnosis.words import gain_in_figures, quantity
from calibration.report.fit.words import percent, rounded, uncertainty
from calibration.report.sets_in_words import listed, titles
from calibration.report.units import FAMILIAR
from calibration.systems.radial_piston.predict.kinds import LINE, RUN, STANDING, VENTED
from configs.units import BAR
from model.effects import laws
from rig.recording.columns import IN_SI

MOST_SHOWN = 6  # sets
LEAST_ODDS = 1e-3  # of a set whose f_overall is shown
BESIDE_ROWS = {
    LINE: "the gauge in the runs",
    VENTED: "the gauge with the line vented",
    STANDING: "the flow with the rotor at rest",
}  # means over files


@dataclass(frozen=True)
class Interval:
    """f_overall in a model: its name, and mean, sd, 5 % and 95 % [N m s]."""

    name: str
    mean: float
    sd: float
    q05: float
    q95: float


def sizes(found: Diagnosis, one: Candidate) -> str:
    """The parameters of a set's effects with their uncertainties, as text."""
    parts = []
    for size in sizes_of(found.comparison.problem, one):
        unknown = size.unknown
        low, mean, high = unknown.value(size.z + size.sd * np.array([-1.0, 0.0, 1.0]))
        before = f"{size.effect}: " if len(one.names) > 1 else ""
        text = size.parameter.text or unknown.name
        parts.append(f"{before}{text} {quantity(mean, (high - low) / 2.0, unknown.unit, unknown.name)}")
    return "; ".join(parts)


def at_top(found: Diagnosis, one: Candidate | None) -> dict[str, str]:
    """What each effect of a set amounts to at the highest level, in words, by effect id.

    `one`: the set; without one there is nothing to say.
    """
    if one is None or not of_motor(found).problem.blocks.plateaus.size:
        return {}
    problem, state = found.comparison.problem, one.mode.prediction.state
    top = int(np.nanargmax(np.where(np.isfinite(one.mode.prediction.speed), state.pressure, np.nan)))
    chosen = problem.chosen(one.names, one.mode.z[len(problem.nuisances) :])
    first = {found.effect: found for found in reversed(sizes_of(problem, one))}
    said = {}
    for effect, values in laws.members(chosen):
        size, unit = math.nan, ""
        if effect.leak is not None:
            volume = state.gas_constant[top] * state.temperature[top] / state.pressure[top]
            size, unit = effect.leak(values, state)[top] * volume, "m3/s"
        elif effect.inlet_drop is not None:
            size, unit = effect.inlet_drop(values, state)[top], "Pa"
        elif effect.outlet_rise is not None:
            size, unit = effect.outlet_rise(values, state)[top], "Pa"
        elif effect.torque is not None and effect.amplitude.unit == "N m s2":
            size, unit = effect.torque(values, state)[top], "N m"
        z = first[effect.id].z
        sd = abs(size / z) * first[effect.id].sd if z else 0.0
        if math.isfinite(size):
            where = f"at the highest level, {state.pressure[top] / BAR:.2f} bar"
            said[effect.id] = f"{quantity(float(size), sd, unit)} {where}"
    return said


def odds(found: Diagnosis, one: Candidate) -> float:
    """How many times more probable than a set that is which the verdict rests on [-].

    Where it rests on none, the most probable set takes its place.
    """
    best = found.verdict.chosen or found.candidates[0]
    return math.inf if one.probability <= 0.0 else best.probability / one.probability


def told_by(found: Diagnosis, rival: Candidate) -> tuple[str, float]:
    """The file that speaks most against a rival of the chosen set, and its share of what all files say [-]."""
    if found.verdict.chosen is None:
        return "", 0.0
    comparison = of_motor(found)
    blocks = comparison.problem.blocks
    theirs, ours = of_mode(found, rival.mode, "").white, of_mode(found, found.verdict.chosen.mode, "").white
    good = (rival.mode.bad < 0.5) & (found.verdict.chosen.mode.bad < 0.5)
    excess = np.where(good, theirs**2 - ours**2, 0.0)
    files: dict[str, float] = {}
    for kind, index, value in zip(comparison.kind, comparison.index, excess, strict=True):
        if kind in BESIDE_ROWS:
            name = BESIDE_ROWS[kind]
        else:
            name = blocks.plateaus.file[index] if kind < RUN else blocks.runs[kind - RUN].file
        files[name] = files.get(name, 0.0) + float(value)
    total = sum(max(value, 0.0) for value in files.values())
    name = max(files, key=lambda key: files[key])
    return (name, files[name] / total) if total > 0.0 else ("", 0.0)


def frictions(found: Diagnosis, document: Mapping[str, Any]) -> list[Interval]:
    """f_overall before and after, and in each set that is not far behind."""
    before, after = document["f_overall_before"], document["f_overall_after"]
    if not before or not after:
        return []
    shown = [
        Interval(name, *(one[key] for key in ("mean", "sd", "q05", "q95")))
        for name, one in (("before: base model", before), (f"after: {_averaged_over(found)}", after))
    ]
    if found.verdict.chosen is not None:
        likely = [c for c in found.candidates if c.names and 1.0 / max(odds(found, c), 1e-300) >= LEAST_ODDS]
        shown += [_interval(found, one) for one in likely[:MOST_SHOWN] if len(likely) > 1]
    return shown


def shortlist(found: Diagnosis) -> list[Candidate]:
    """The most probable sets, the base model always among them."""
    first = found.candidates[:MOST_SHOWN]
    return first if any(not c.names for c in first) else [*first, *(c for c in found.candidates if not c.names)]


def gain_in_words(held_out: Mapping[str, Any]) -> str:
    """What the held-out rows say, in a sentence or two."""
    falls = []
    for key, before in held_out["rmse_before"].items():
        quantity = IN_SI[key]
        familiar, factor = FAMILIAR[quantity.si]
        after = held_out["rmse_after"].get(key, before)
        falls.append(f"from {before * factor:.2g} to {after * factor:.2g} {familiar} in the {quantity.channel}")
    gain = gain_in_figures(held_out)
    went = f"the error (rms) went {listed(falls)}. It predicts them "
    if held_out["kind"] == Predicted.UNSEEN_RUN:
        return f"On readings of an {held_out['scheme']}, {went}{gain}; nothing had seen that run before."
    if held_out["kind"] == Predicted.BY_CORRECTION:
        return (
            f"With a smooth correction in place of a cause, on readings that it had not seen, {went}"
            f"{gain}; cross-validated in {held_out['folds']} folds, in "
            f"{held_out['same_set_in_folds']} of which it lay along the same coordinate of the same balance."
        )
    return (
        f"On readings that it had not seen, {went}{gain}; cross-validated in {held_out['folds']} folds, in "
        f"{held_out['same_set_in_folds']} of which the same set was the most probable.{_of_figures(held_out)}"
    )


def _of_figures(held_out: Mapping[str, Any]) -> str:
    gain = held_out.get("elpd_gain_of_declared_figures")
    if gain is None:
        return ""
    return (
        " Each declared figure of motor and instruments was predicted from the readings and the other figures: that "
        f"changed by {gain:+.1f} in log likelihood.".replace("-", "−")
    )


def bias_in_words(found: Mapping[str, Any]) -> str:
    """What f_overall was biased by, in a sentence; empty where the motor has none."""
    before, after = found["f_overall_before"], found["f_overall_after"]
    if not before or not after:
        return ""
    was, value = (quantity(one["mean"], one["sd"], "N m s") for one in (before, after))
    beside = ", as before" if value == was else f"; in the base model alone it is {was}"
    if found["verdict"] == "consistent":
        is_open = any(one["effects"] for one in found.get("rivals", []))
        said = "what is not excluded is weighed in" if is_open else "nothing has to be corrected"
        return f"f_overall is {value}{beside}; {said}."
    if found["verdict"] == "unresolved":
        return f"f_overall is {value} if what is missing is smooth; it has taken part of that: do not rely on it."
    shift = before["mean"] - after["mean"]
    if abs(shift) < 0.1 * after["sd"]:
        return f"f_overall is {value}{beside}."
    sd = after["sd"]
    size = f"{uncertainty(abs(shift)) if abs(shift) < sd else rounded(abs(shift), sd)} N m s"
    share = percent(abs(shift) / after["mean"]) if after["mean"] > 0.0 else ""
    held = [effect["id"] for effect in found["effects"] if effect["id"] != MISREAD]
    if not held:
        return f"f_overall is {value}, without the readings that are off, and what is not excluded weighed in."
    names = titles(held)
    rest = " or its rivals" if found["verdict"] == "confounded" else ""
    way = "low" if shift < 0.0 else "high"
    return f"f_overall came out {size} ({share}) too {way} without {names}{rest}; with it, it is {value}."


def blind_in_words(found: Diagnosis) -> str:
    """That nothing was to be seen, in a sentence; empty where an effect would have shown or something is said."""
    if found.verdict.kind != VerdictKind.CONSISTENT or not found.resolved:
        return ""
    if any(one.seen_from is not None for one in found.resolved):
        return ""
    place = found.comparison.problem.place("f_overall")
    prior = place is not None and math.sqrt(found.base.covariance[place, place]) > UNINFORMED
    return f"This recording would show no effect of a believable size{'; f_overall is as its prior has it' * prior}."


def _averaged_over(found: Diagnosis) -> str:
    """What f_overall is averaged over once a diagnosis is made."""
    if found.verdict.chosen is not None:
        return "the sets that stand, weighed"
    if found.verdict.kind != VerdictKind.UNRESOLVED:
        return "what is not excluded, weighed in"
    return "all sets, weighed" if found.nuisances_corrected is None else "beside a smooth correction"


def _interval(found: Diagnosis, one: Candidate) -> Interval:
    nuisances = found.comparison.problem.nuisances
    i = next(i for i, unknown in enumerate(nuisances) if unknown.name == "f_overall")
    sd = math.sqrt(float(one.mode.covariance[i, i]))
    q05, low, mean, high, q95 = nuisances[i].value(one.mode.z[i] + sd * np.array([-Q95, -1.0, 0.0, 1.0, Q95]))
    return Interval(" + ".join(one.names), float(mean), float(high - low) / 2.0, float(q05), float(q95))
