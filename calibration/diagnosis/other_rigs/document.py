"""A diagnosis of another rig as diagnosis/1: plain values, numbers SI; a slide's torque_nm is in N, rad_s in m/s."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calibration.diagnosis.document import (
    FORMAT,
    MOST_PLACES,
    Q95,
    UNKNOWN,
    finite,
    held_out_as_json,
    next_tests_as_json,
    size_as_json,
)
from calibration.diagnosis.other_rigs.coordinates import Coordinates
from calibration.diagnosis.other_rigs.diagnose import RigDiagnosis
from calibration.diagnosis.other_rigs.places import same_coordinates
from calibration.diagnosis.other_rigs.words import sentence
from calibration.diagnosis.steps.candidate import Candidate

CHECK = (
    "the units of each column",
    "the motor's table: its inertia, mass or displacement",
    "the clock",
    "the tachometer's pulses per turn",
    "the sign of the drive",
    "whether the pressures are absolute or gauge",
)
FOUND_P = 0.01
STANDS_OUT = 0.5  # share of the largest score that a piece needs to belong to the place
NAMES = {
    "torque": "torque balance does not close",
    "mass": "flow balance does not close",
    "sensor": "instrument's reading departs from the model's",
}
OF_SLIDE = {"N m": "N", "rad/s": "m/s", "N m s2": "N s2/m2", "N m s": "N s/m"}


def as_json(found: RigDiagnosis) -> dict[str, Any]:
    """The diagnosis as a mapping."""
    verdict = found.verdict
    document: dict[str, Any] = {
        "format": FORMAT,
        "rig": found.problem.kind,
        "verdict": verdict.kind,
        "mismatch": {"p_value": found.detection.p_value, "beyond_the_draws": found.detection.extrapolated},
        "located": [] if verdict.kind == "consistent" or found.not_described else _places(found),
        "set_probability": verdict.set_probability,
        "effects": _effects(found),
        "alternatives": [list(names) for names in verdict.alternatives],
        "term": None,
        "improvement": {"held_out": held_out_as_json(found.held_out)},
        "f_overall_before": None if found.not_described else _friction([found.candidates_of(())]),
        "f_overall_after": None if found.not_described else _friction(_weighed(found)),
        "next_tests": next_tests_as_json(found.next_tests),
        "suspect_rows": [],
        "left": _left(found),
        "nuisances": _nuisances(found),
        "noise": [
            {"readings": one.label, "scale": scale, "correlation": rho}
            for one, scale, rho in zip(
                [r for r in found.problem.readings if r.value.size],
                found.detection.scale,
                found.detection.correlation,
                strict=True,
            )
        ],
        "friction_unit": "N s/m" if found.problem.slides else "N m s",
        "files": found.problem.files,
        "check": list(CHECK) if found.not_described else [],
        "why": verdict.why,
    }
    document["sentence"] = sentence(document)
    return finite(document)


def _places(found: RigDiagnosis) -> list[dict[str, Any]]:
    places = []
    detection = found.detection
    for force, log_p, scores in zip(found.free, detection.force_log_p, detection.force_scores, strict=True):
        p = min(1.0, len(found.free) * math.exp(max(float(log_p), -690.0)))
        if p >= FOUND_P:
            continue
        size = np.abs(scores)
        out = np.flatnonzero(size >= STANDS_OUT * size.max())
        where = (float(force.places[out, 0].min()), float(force.places[out, 1].max()))
        places.append(
            (
                float(log_p),
                {
                    "channel": force.channel,
                    "balance": force.balance,
                    "coordinate": force.coordinate,
                    "where": list(where),
                    "unit": force.unit,
                    "p_value": p,
                    "sentence": f"The {NAMES[force.balance]} along {force.coordinate}, most between "
                    f"{where[0]:.3g} and {where[1]:.3g} {force.unit} (seen in the {force.channel}).",
                    "same_as": list(same_coordinates(found.problem, force.coordinate)),
                },
            )
        )
    return [place for _, place in sorted(places, key=lambda pair: pair[0])][:MOST_PLACES]


def _effects(found: RigDiagnosis) -> list[dict[str, Any]]:
    if found.verdict.kind == "unresolved":
        return [dict(UNKNOWN)]
    chosen = found.chosen
    if chosen is None or found.verdict.kind == "consistent":
        return []
    listed = []
    for name in chosen.names:
        rest = tuple(n for n in chosen.names if n != name)
        without = next((c for c in found.candidates if c.names == rest), None)
        listed.append(
            {
                "id": name,
                "probability": min(1.0, sum(c.probability for c in found.candidates if name in c.names)),
                "log10_bayes_factor": None
                if without is None
                else (chosen.log_evidence - without.log_evidence) / math.log(10.0),
                "parameters": _parameters(found, chosen, name),
            }
        )
    return sorted(listed, key=lambda e: -float(e["log10_bayes_factor"] or 0.0))


def _parameters(found: RigDiagnosis, chosen: Candidate, name: str) -> dict[str, dict[str, Any]]:
    at = Coordinates(found.problem, chosen.names)
    first = at.n_flat + len(found.problem.unknowns)
    out = {}
    for i, (effect, unknown, low, high) in enumerate(at.of_effects, start=first):
        if effect != name:
            continue
        x, sd = float(chosen.mode.point[i]), math.sqrt(max(float(chosen.mode.covariance[i, i]), 0.0))
        unit = OF_SLIDE.get(unknown.unit, unknown.unit) if found.problem.slides else unknown.unit
        out[unknown.name] = {**size_as_json(unknown, x, sd, low, high), "unit": unit}
    return out


def _weighed(found: RigDiagnosis) -> list[Candidate]:
    if found.chosen is None:
        return [found.candidates_of(())]
    kept = {found.chosen.names, *found.verdict.alternatives}
    return [c for c in found.candidates if c.names in kept]


def _friction(weighed: list[Candidate]) -> dict[str, float] | None:
    """The viscous coefficient averaged over sets [N m s], of a slide [N s/m]."""
    parts = [
        (c.probability, c.mode.estimates["viscous_friction"]) for c in weighed if "viscous_friction" in c.mode.estimates
    ]
    total = sum(p for p, _ in parts)
    if not parts:
        return None
    share = [p / total if total > 0.0 else 1.0 / len(parts) for p, _ in parts]
    mean = sum(w * e.mean for w, (_, e) in zip(share, parts, strict=True))
    variance = sum(w * (e.sd**2 + (e.mean - mean) ** 2) for w, (_, e) in zip(share, parts, strict=True))
    sd = math.sqrt(variance)
    return {"mean": mean, "sd": sd, "q05": max(mean - Q95 * sd, 0.0), "q95": mean + Q95 * sd}


def _left(found: RigDiagnosis) -> dict[str, float] | None:
    names = found.chosen.names if found.chosen is not None else ()
    if names not in found.left:
        return None
    return {"p_value": found.residual_p[names], "share_of_mismatch": found.left[names]}


def _nuisances(found: RigDiagnosis) -> dict[str, dict[str, Any]]:
    """Every unknown that is no effect, with the chosen set or the base model: an offset of the drive stands here."""
    fit = found.chosen.mode if found.chosen is not None else found.base
    return {
        label: {"mean": one.mean, "sd": one.sd, "unit": one.unit}
        for label, one in fit.estimates.items()
        if label.partition(".")[0] not in fit.names
    }
