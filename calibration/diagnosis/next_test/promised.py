"""What a test promised, held against what it gave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.diagnosis.next_test.information import pair_weights
from calibration.diagnosis.next_test.recommend import MOST_RIVALS
from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.expected import Capture
from configs.units import BAR, STANDARD_BAR
from model.motor import read_motor
from rig.recording import Recording, RecordingFile
from rig.recording.columns import pressure_in

LEVEL, INERTIA = 0.1, 0.2  # shares by which what was taken may be off what was asked for
BESIDE = "; "  # between tests that were taken together

Names = tuple[str, ...]


class Rival(NamedTuple):
    """How a set of effects stood before a test: its log evidence and its probability [-]."""

    log_evidence: float
    probability: float


@dataclass(frozen=True)
class Promise:
    """What a test was expected to tell before it was taken, and the sets of effects that were open, likeliest first."""

    test: str
    information_nats: float
    rivals: Mapping[Names, Rival]


@dataclass(frozen=True)
class Kept:
    """A promise, and the odds that the test moved."""

    test: str
    information_nats: float
    delivered_nats: float


def kept(promise: Promise, candidates: Sequence[Candidate]) -> Kept | None:
    """What a test gave: how far it moved the log odds of two sets for the likelier of them, the mean over their pairs.

    Each pair counts for what it was probable before. That is what was promised, with the likelier set in the place of
    the true one. Negative where the test speaks for the other. None where fewer than two of the sets were weighed
    again.
    """
    now = {one.names: one.log_evidence for one in candidates}
    known = [names for names in list(promise.rivals)[:MOST_RIVALS] if names in now]  # those that it was weighed for
    if len(known) < 2:
        return None
    gave = 0.0
    for pair, weight in pair_weights([promise.rivals[names].probability for names in known]).items():
        one, other = (known[i] for i in pair)
        after = now[one] - now[other]
        before = promise.rivals[one].log_evidence - promise.rivals[other].log_evidence
        gave += weight * (after - before) * (1.0 if after >= 0.0 else -1.0)
    return Kept(promise.test, promise.information_nats, round(gave, 2))


def asked_for(
    tests: Sequence[tuple[str, float, Capture]], rivals: Mapping[Names, Rival], taken: Sequence[Recording]
) -> Promise | None:
    """The promise of the tests that new recordings hold; of several that were taken together the largest.

    `tests`: what was asked for, the nats promised [-], and what is to be taken.
    `rivals`: the sets that were open, the likeliest first.
    """
    held = [capture for one in taken for capture in captures_of(one)]
    counted = [(words, nats, sum(_is_like(wanted, one) for one in held)) for words, nats, wanted in tests]
    found = [(words if n == 1 else f"{words}, {n} times (promised of one)", nats) for words, nats, n in counted if n]
    if not found:
        return None
    return Promise(BESIDE.join(words for words, _ in found), max(nats for _, nats in found), rivals)


def in_words(capture: Capture) -> str:
    """What is taken, in words."""
    if capture.level_bar_abs is None:
        return f"a {capture.kind}"
    what = (
        "plateaus at"
        if capture.kind == "plateaus"
        else f"a {capture.kind} {'to' if capture.kind == 'spin-up' else 'from'}"
    )
    added = capture.added_inertia_kg_m2
    flywheel = f" with {added:.2g} kg m2 added" if added else ""
    return f"{what} {capture.level_bar_abs:.2f} bar abs{flywheel}"


def why_not(wanted: Sequence[Capture], taken: Recording) -> str:
    """Why a recording is none of the tests that were asked for, in a sentence."""
    held = [in_words(one) for one in captures_of(taken)]
    lacking = [f"{file.file} has no {what}" for file in taken.files if (what := _lacks(file))]
    has = "; ".join([" and ".join(held) or "no test by itself", *lacking])
    asked = ", or ".join(in_words(one) for one in wanted) or "nothing that a bench takes by itself"
    return f"{taken.folder} holds {has}. Asked for: {asked}"


def _lacks(file: RecordingFile) -> str:
    """What a file lacks to be a test that is told; empty of one that lacks nothing."""
    if file.kind == "transient" and file.is_open is None:
        return "column supply_open"
    return "reading of the pressure" if file.kind != "zero" and not _levels(file, 0.0).size else ""


def captures_of(recording: Recording) -> list[Capture]:
    """What a recording holds, as it would be asked for: runs in time, a zero, plateaus mostly at one level."""
    room = _room_bar(recording)
    found = []
    for file in recording.files:
        if file.kind == "zero":
            found.append(Capture("zero"))
            continue
        levels = _levels(file, room)
        if not levels.size:
            continue
        added = recording.added_inertia_kg_m2 + file.added_inertia_kg_m2
        if file.kind == "transient":
            is_open = file.is_open is not None and bool(file.is_open[-1])
            settled = levels[levels.size // 2 :] if is_open else levels  # the line has to fill first
            found.append(Capture("spin-up" if is_open else "coast-down", float(np.median(settled)), added))
        elif np.mean(np.abs(levels - np.median(levels)) <= LEVEL * (np.median(levels) - room)) > 0.5:
            found.append(Capture("plateaus", float(np.median(levels)), added))
    return found


def _room_bar(recording: Recording) -> float:
    """The room's pressure [bar abs]; the motor's default where nobody told it."""
    told = recording.ambient.pressure_bar_abs
    if told is None and recording.is_of_radial_piston:
        return read_motor(recording.motor).si("ambient_pressure") / BAR
    return told or STANDARD_BAR


def _levels(file: RecordingFile, room_bar: float) -> np.ndarray:
    """Absolute pressures of plateaus, or of a run while the supply is open [bar]."""
    name, gauge = pressure_in(file.columns)
    if name not in file.columns:
        return np.empty(0)
    values = file.columns[name].values + (room_bar if gauge else 0.0)
    if file.kind == "transient":
        if file.is_open is None:
            return np.empty(0)
        values = values[file.is_open]
    return values[np.isfinite(values)]


def _is_like(wanted: Capture, taken: Capture) -> bool:
    if wanted.kind != taken.kind:
        return False
    if wanted.level_bar_abs is None or taken.level_bar_abs is None:
        return True
    is_level = abs(taken.level_bar_abs - wanted.level_bar_abs) <= LEVEL * wanted.level_bar_abs
    least, most = sorted((wanted.added_inertia_kg_m2, taken.added_inertia_kg_m2))
    turns = wanted.kind != "plateaus"  # at a steady speed a flywheel does nothing
    return is_level and (not turns or most - least <= INERTIA * most)
