"""What changed between two recordings, as comparison/1: plain values, each with its unit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calibration.data.dates import as_text
from calibration.diagnosis import changes
from calibration.diagnosis.changes import Answer, Moved
from calibration.diagnosis.document import next_tests_as_json, suspect_rows
from calibration.diagnosis.result import Diagnosis, several_of
from calibration.diagnosis.steps.candidate import Candidate
from calibration.systems.several.sharing import OF_THE_MOTOR_CHANGED
from calibration.unknowns.effects import changed, unchanged
from rig.recording.safe_text import finite

FORMAT = "comparison/1"
MOST_SETS = 12
LEAST = 1e-3  # probability of a change that is told without being in a set that the verdict lists


def as_json(found: Diagnosis) -> dict[str, Any]:
    """A comparison as a mapping."""
    problem, verdict = several_of(found).problem, found.verdict
    said = changes.answer(found)
    listed = _listed(found, said)
    names = dict.fromkeys(name for one in listed for name in changes.changes_in(one.names))
    weighed = dict.fromkeys(name for one in found.candidates for name in changes.changes_in(one.names))
    further = [name for name in weighed if changes.probability_of(found, name) > LEAST or name == changed("f_overall")]
    return finite(
        {
            "format": FORMAT,
            "recordings": [{"recording": day, "date": as_text(problem.dates[day])} for day in problem.days],
            "verdict": said.value,
            "mismatch": {"p_value": found.detection.p_value, "beyond_the_draws": found.detection.extrapolated},
            "unchanged_probability": None if said is Answer.UNRESOLVED else changes.unchanged_probability(found),
            "explanations": [_explanation(one) for one in listed],
            "changes": [_change(found, name, name in names) for name in dict.fromkeys([*names, *further])],
            "sets": [_explanation(one) for one in found.candidates[:MOST_SETS]],
            "next_tests": next_tests_as_json(found.next_tests),
            "suspect_rows": suspect_rows(found),
            "why": verdict.why,
            "files": found.comparison.rows_used(),
        }
    )


def _listed(found: Diagnosis, said: Answer) -> list[Candidate]:
    """The sets that the verdict says, the one that it rests on first."""
    if said is Answer.UNRESOLVED:
        return []
    by_names = {one.names: one for one in found.candidates}
    chosen = found.verdict.chosen
    first = by_names[()] if chosen is None else chosen
    return [first, *(by_names[names] for names in found.verdict.alternatives if names in by_names)]


def _explanation(one: Candidate) -> dict[str, Any]:
    mine = changes.changes_in(one.names)
    return {
        "changed": [unchanged(name) for name in mine],
        "shared": [name for name in one.names if name not in mine],
        "probability": one.probability,
        "log_evidence": one.log_evidence,
        "refused": None if one.refused is None else str(one.refused),
    }


def _change(found: Diagnosis, name: str, is_listed: bool) -> dict[str, Any]:
    one = changes.best_with(found, name)
    figures = [] if one is None else changes.moved(found, one, name)
    return {
        "id": unchanged(name),
        "of": "motor" if name in OF_THE_MOTOR_CHANGED else found.comparison.problem.effect(name).acts_in,
        "listed": is_listed,
        "probability": changes.probability_of(found, name),
        "refused": None if one is None or one.refused is None else str(one.refused),
        "log10_bayes_factor": None if one is None else _factor(found, one, name),
        "parameters": {moved.quantity.name: _moved(moved) for moved in figures},
    }


def _factor(found: Diagnosis, one: Candidate, name: str) -> float | None:
    """Against the same set without the change."""
    rest = tuple(other for other in one.names if other != name)
    without = next((c for c in found.candidates if c.names == rest), None)
    return None if without is None else (one.log_evidence - without.log_evidence) / math.log(10.0)


def _moved(moved: Moved) -> dict[str, Any]:
    told = {"before": moved.before, "after": moved.after, "change": moved.change}
    return {"unit": moved.quantity.unit} | {key: _summary(draws) for key, draws in told.items()}


def _summary(draws: np.ndarray) -> dict[str, float]:
    q05, q95 = np.quantile(draws, [0.05, 0.95])
    return {"mean": float(draws.mean()), "sd": float(draws.std()), "q05": float(q05), "q95": float(q95)}
