"""The page of a run: one self-contained HTML page, its pictures those of a diagnosis that has looked no further."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.data.rows_used import few_used, in_words
from calibration.diagnosis.f_overall import f_overall_before
from calibration.diagnosis.mismatch import Detected
from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.steps.verdict import Verdict, VerdictKind
from calibration.fit.posterior import FitQuality
from calibration.report.diagnosis import figures as draw
from calibration.report.diagnosis import numbers, words
from calibration.report.origin import origins
from calibration.report.render import Grid, inline, render, versions
from configs.units import BAR


@dataclass(frozen=True)
class Told:
    """What is told of a run beside its readings.

    `what`, `outcome`: its kind and bench; how it ended, with the reason.
    `wrong`: what went wrong, a sentence each.
    `commands`: what can be done next: what for, and the command.
    `why_not`: why its readings were not held against the model; empty where they were.
    """

    name: str
    what: str
    outcome: str
    is_finished: bool
    wrong: list[str] = field(default_factory=list)
    commands: list[tuple[str, str]] = field(default_factory=list)
    why_not: str = ""


def page(told: Told, detected: Detected | None = None, quality: FitQuality | None = None) -> bytes:
    """The page, every text in it escaped; without `detected` and `quality` it says why nothing was compared."""
    filled: dict[str, Any] = {"told": told, "figures": {}, "plateaus": None, "origins": [], "used": "", "notes": []}
    filled |= {"verdict": "Its readings were not held against the model.", "why": told.why_not, "fits": None}
    if detected is not None and quality is not None:
        filled |= _against_the_model(_as_diagnosis(detected, quality), quality)
    return render("run.html.j2", filled | {"versions": versions()})


def _as_diagnosis(detected: Detected, quality: FitQuality) -> Diagnosis:
    """The first steps of a diagnosis as one, for its pictures."""
    kind = VerdictKind.CONSISTENT if quality.model_fits else VerdictKind.UNRESOLVED
    verdict = Verdict(kind, None, (), 0.0, quality.why)
    return Diagnosis(
        comparison=detected.comparison,
        base=detected.base,
        detection=detected.detection,
        places=[],
        candidates=[],
        residual_p={},
        left={},
        verdict=verdict,
    )


def _against_the_model(found: Diagnosis, quality: FitQuality) -> dict[str, Any]:
    models, recording = numbers.models(found), found.comparison.problem.recording
    figures: dict[str, bytes] = {}
    if numbers.coordinates(found) and numbers.channels(found):
        figures["plateaus"] = draw.residuals(found, models, False)
    if numbers.of_motor(found).problem.blocks.runs:
        figures["runs"] = draw.runs(found, models)
    files = found.comparison.rows_used()
    return {
        "verdict": _verdict(found, quality),
        "why": quality.why,
        "fits": quality.model_fits,
        "figures": {name: inline(one) for name, one in figures.items()},
        "markers": draw.markers_in_words(found),
        "plateaus": _plateau_table(found),
        "origins": origins([recording]),
        "used": in_words(files),
        "notes": few_used(files),
    }


def _verdict(found: Diagnosis, quality: FitQuality) -> str:
    """f_overall and whether the model explains the readings, in two sentences."""
    friction, chance = f_overall_before(found), words.p_in_words(quality.p_value)
    if not quality.model_fits or friction is None:
        return f"The model does not explain the readings ({chance}): do not rely on an f_overall of it."
    shown = words.quantity(friction["mean"], friction["sd"], "N m s")
    return f"f_overall is about {shown}. The readings do not contradict the model ({chance})."


def _plateau_table(found: Diagnosis) -> Grid:
    """Each plateau: what was read, and by how much that is more than the model says."""
    plateaus, difference = numbers.of_motor(found).problem.blocks.plateaus, numbers.models(found)[0].difference
    header: tuple[str, ...] = ("file", "row", "pressure, bar")
    columns = [plateaus.pressure / BAR]
    for channel in numbers.channels(found):
        unit, factor = numbers.UNITS[channel]
        header += (f"{channel}, {unit}", "less model")
        mine = numbers.of_motor(found).kind == numbers.KINDS[channel]
        columns += [getattr(plateaus, channel) * factor, difference[mine] * factor]
    rows = tuple(
        (file, str(row), *(f"{value:z.4g}".replace("-", "−") if np.isfinite(value) else "" for value in values))
        for file, row, values in zip(plateaus.file, plateaus.row, np.column_stack(columns), strict=True)
    )
    return Grid(header, rows)
