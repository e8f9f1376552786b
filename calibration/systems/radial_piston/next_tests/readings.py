"""What a planned test would read under each explanation that is open."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from calibration.data.runs import RunInTime
from calibration.data.runs_in_time import placeholders
from calibration.likelihood.expected import MODEL_SD, Expected, Taken, directions
from calibration.likelihood.function import Function, Predicts
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.next_tests.planned import Planned
from calibration.systems.radial_piston.predict.carried import carried, of_any_day
from calibration.systems.radial_piston.predict.supply import OF_THE_BENCH
from calibration.unknowns.priors import OfRun, Unknown, drift_of
from model.layout import RPM
from rig.recording import DOWN_TO, LEAST_IN_A_RUN, UP_TO, Column, Recording, captured_s
from rig.recording.columns import OF_CHANNEL

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison
    from calibration.systems.radial_piston.noise import Whitener

LEAST_TOLD = 1e-3  # of a prior's own precision: what a recording tells less of, it does not tell
SEED = 1  # of the noise that is drawn, the same for each rival
PLANNED = "planned"  # folder of a recording that nobody has taken yet
TANGENT = 1e-3  # step of a derivative [-]
LEAST_LEFT = 0.02  # of a quantity that may not vanish, or of its usual size, to which a step leads at most


def expected_readings(
    plan: Planned, seen: Comparison, rivals: Sequence[Mode], line: Mapping[str, float] | None = None
) -> list[Expected]:
    """What a test would read under each rival, with all that the recording leaves open of it.

    The motor, the effects and the errors of instruments that have a serial number are known as well as the recording
    tells, but for a drift that is declared. What is new on another day, such as the room or the shaft's angle, is
    anybody's guess; so is the line, about what a run of the recording says of the bench's. Raises ArithmeticError when
    the rotor would not turn in a run in time, or the bench's tachometer gives too few readings of it.

    `line`: what a run says of it, of `line_of`; of this recording's own, when left out.
    """
    there, points = _another_day(plan, seen, rivals, line)
    common = there.whitener(_mean(there, rivals[0].names)(points[0][0]), rivals[0].u)
    return [_expected(there, common, one, *point) for one, point in zip(rivals, points, strict=True)]


def as_taken(plan: Planned, seen: Comparison, rivals: Sequence[Mode], line: Mapping[str, float] | None = None) -> Taken:
    """A test as if it had been taken on another day, where each rival is true; else as `expected_readings` says.

    Noise is drawn: what a rival does not explain may pass for noise that is louder, or alike from one sample to the
    next, and how far it does so shows in noise alone.
    """
    there, points = _another_day(plan, seen, rivals, line)
    k = len(there.problem.nuisances)
    there.see_pulses(points[0][0][:k])
    read = []
    for one, (z, _, _) in zip(rivals, points, strict=True):
        f = Function(there, one.names)
        predicted, rng = f(f.clip(z)), np.random.default_rng(SEED)
        noise = there.drawn_noise(predicted, np.where(there.noise.free, rivals[0].u, 0.0), rng)
        true = copy(there)
        true.read = np.where(there.known, there.raw(predicted) + noise, np.nan)
        read.append(true)
    return Taken(read, [z[:k] for z, _, _ in points])


def _another_day(
    plan: Planned, seen: Comparison, rivals: Sequence[Mode], line: Mapping[str, float] | None
) -> tuple[Comparison, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """A test's recording, and of each rival what is known there: its point, covariance [-], and which of it is new."""
    of_that_day = replace(plan.recording, folder=plan.recording.folder / PLANNED, sha256="", origin={})
    there, line = seen.of(of_that_day), line_of(seen, rivals[0]) if line is None else line
    stays = of_any_day(seen.problem)
    first = _on_this_bench(line, there, carried(seen.problem, rivals[0], there.problem, stays)[0])
    if there.problem.blocks.runs:  # which samples are compared hangs on the speeds that are read
        likely = _mean(there, rivals[0].names)(first)
        there = seen.of(_as_captured(of_that_day, there.problem.blocks.runs[0], likely.runs[0]))
        if not there.problem.blocks.runs:
            raise FloatingPointError("the rotor would not turn")
    found = []
    for one in rivals:
        z, covariance, new = carried(seen.problem, one, there.problem, stays)
        # no rival's own: a line tells nothing of the motor
        found.append((_on_this_bench(line, there, z), covariance, new))
    return there, found


def line_of(seen: Comparison, likeliest: Mode) -> dict[str, float]:
    """How the line fills and empties in the last run of a recording that does so: what of it, and its unknown [-]."""
    return {
        unknown.of.what: float(value)
        for unknown, value in zip(seen.problem.nuisances, likeliest.z, strict=False)
        if isinstance(unknown.of, OfRun) and unknown.of.what in OF_THE_BENCH
    }


def _on_this_bench(line: Mapping[str, float], there: Comparison, z: np.ndarray) -> np.ndarray:
    """A point there [-] with the bench's line."""
    z = z.copy()
    for i, unknown in enumerate(there.problem.nuisances):
        if isinstance(unknown.of, OfRun) and unknown.of.what in line:
            z[i] = line[unknown.of.what]
    return z


def _expected(
    there: Comparison, common: Whitener, one: Mode, z: np.ndarray, covariance: np.ndarray, new: np.ndarray
) -> Expected:
    """What a test would read under a rival, from its point and covariance there, and which of its unknowns are new."""
    f, mean = Function(there, one.names), _mean(there, one.names)
    looked_at = there.known
    unknowns = [*there.problem.nuisances, *(unknown for _, unknown in there.problem.effect_unknowns(one.names))]
    open_ = directions(np.where(new[:, None] | new, 0.0, covariance))

    def white(difference: np.ndarray) -> np.ndarray:
        found: np.ndarray = common(np.nan_to_num(difference))[looked_at]
        return found

    def at(place: np.ndarray) -> np.ndarray:
        found = mean(f.clip(_straight_on(unknowns, z, open_ @ place)))
        return white(there.raw(found)) if there.is_told(found) else np.full(int(looked_at.sum()), np.nan)

    here = mean(z)
    if not there.is_told(here):
        raise FloatingPointError(f"the model with {' and '.join(one.names) or 'nothing added'} gives no reading of it")
    J = white(f.derivatives(z, here, np.zeros((there.read.size, z.size)), one.u, mean))
    raw = there.raw(here)
    inexact = white(
        np.column_stack([np.where(there.kind == 0, raw, 0.0), np.where(there.kind > 0, raw, 0.0)]) * MODEL_SD
    )
    own = J[:, new] @ covariance[np.ix_(new, new)] @ J[:, new].T + np.eye(int(looked_at.sum()))
    for i, unknown in enumerate(there.problem.nuisances):
        drift = None if new[i] else drift_of(there.problem.recording, unknown)
        if drift is not None:  # in an sd of the offset
            own += (drift.b / unknown.b) ** 2 * np.outer(J[:, i], J[:, i])
    return Expected(
        white(raw), J @ open_, inexact @ inexact.T, own, at, _left_open(unknowns, z, covariance, new, open_)
    )


def _left_open(
    unknowns: Sequence[Unknown], z: np.ndarray, covariance: np.ndarray, new: np.ndarray, open_: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """From a place along the directions in which a recording leaves a rival open [-] to what there is against it.

    What it says is straight in the quantities, a prior in its own coordinate. At the point the two pull alike.

    `z`, `covariance`: the point there and what it is known by [-]. `new`: what the recording does not tell.
    `open_`, shape (n, k): directions there [-].
    Returns the residuals, of `Expected.left`.
    """
    known = np.flatnonzero(~new)
    precision, unit = np.linalg.eigh(
        np.linalg.pinv(covariance[np.ix_(known, known)], hermitian=True) - np.eye(known.size)
    )
    told = precision > LEAST_TOLD
    J = np.sqrt(precision[told])[:, None] * unit[:, told].T
    r = (unit[:, told].T @ z[known]) / np.sqrt(precision[told])

    def left(place: np.ndarray) -> np.ndarray:
        move = open_ @ place
        return np.append(r - J @ move[known], _straight_on(unknowns, z, move)[known])

    return left


def _straight_on(unknowns: Sequence[Unknown], z: np.ndarray, move: np.ndarray) -> np.ndarray:
    """A step that is straight in the quantities themselves, not in their priors' coordinates [-].

    `z`, `move`, shape (n,): where from, and how far along the tangent [-].
    """
    found = z + move
    for i, one in enumerate(unknowns):
        if one.kind == "normal" or move[i] == 0.0:
            continue
        here, ahead, behind = (float(one.value(np.asarray(at))) for at in (z[i], z[i] + TANGENT, z[i] - TANGENT))
        to = here + (ahead - behind) / (2.0 * TANGENT) * move[i]
        if one.kind == "lognormal":
            to = max(to, LEAST_LEFT * here)
        elif one.kind == "loguniform":
            to = min(max(to, one.a * (1.0 + LEAST_LEFT)), one.b * (1.0 - LEAST_LEFT))
        elif one.kind == "halfsize":
            to = max(to, one.a + LEAST_LEFT * one.b)
        found[i] = one.z(to)
    return found


def _mean(there: Comparison, names: tuple[str, ...]) -> Predicts:
    """Predictions by the mean torque: nobody can count on the phase of the pulses."""
    return functools.partial(Function(there, names), smooth=True)


def _as_captured(recording: Recording, planned: RunInTime, speed: np.ndarray) -> Recording:
    """With the speeds that are likely, as long as the bench would record it.

    Raises FloatingPointError when the bench would refuse it: too few readings of the tachometer would fall in the
    event.
    """
    (run,) = recording.files
    name = OF_CHANNEL["speed"].column
    held, told = run.columns[name], np.isfinite(speed)
    time, is_open = run.columns["time_s"].values, run.columns["supply_open"].values > 0.5
    likely = np.interp(time, planned.time[told], speed[told]) if told.any() else np.zeros(time.size)
    shown = np.where(held.values > 0.0, np.maximum(likely * RPM, 0.1), 0.0)

    moved = int(np.argmax(is_open != is_open[0]))
    after = shown[moved:]
    over = after >= UP_TO * after[-1] if is_open[moved] else after <= DOWN_TO * shown[moved - 1]
    length = int(np.argmax(over)) if over.any() else over.size
    pulses = recording.channels[name].pulses_per_rev
    sample_s = float(time[1] - time[0])
    turns = float(np.sum(after[:length])) / 60.0 * sample_s
    readings = turns * pulses if pulses else length
    if readings < LEAST_IN_A_RUN:
        raise FloatingPointError(f"{readings:.0f} readings of the speed where {LEAST_IN_A_RUN} are needed")
    kept = min(moved + math.ceil(captured_s(length * sample_s) / sample_s), run.rows)
    columns = {**run.columns, name: replace(held, values=placeholders(shown))}
    cut = {key: Column(one.values[:kept], one.censor[:kept]) for key, one in columns.items()}
    return replace(recording, files=(replace(run, rows=kept, columns=cut),))
