"""Where the mismatch is: which balance, seen in which channel, along which coordinate.

Whether a place is one at all is a test of a free-form force: those of the detection, and beside them forces along
pressure and angle and the instruments' errors along their own range, their number priced. With a strong mismatch many
pass: what is off along speed shows along time as well. So the smooth torques, flows and errors of `correction` are
weighed by their evidence. A place that adds nothing to the clearest is its shadow, and left out; one that explains as
much cannot be told from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import ndtr, ndtri

from calibration.diagnosis.steps.correction import Key, Process, evidence, processes, stands_out
from calibration.diagnosis.steps.detect import Detection, log_tail
from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import Linearized, freed, linearize
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Balance, Force, hats, spans
from calibration.likelihood.signatures import project

FOUND_P = 0.01  # after the number of forces tested is priced
STANDS_OUT = 0.5  # share of the largest score that a piece needs to belong to the place
LEAST_LOG_P = -690.0
DECIDES = 5.0  # nats of evidence that tell two places apart
ADDS = 10.0  # ... that make a second place beside the clearest, at least
CROOKED = 0.05  # share of the clearest's evidence that a second place must have: the problem is not quite linear
MOST_ROWS = 3
PIECES = 5  # of a force along pressure, or of an instrument's range
LEFT = 0.3  # share of a reading that forces must leave to itself, or nothing is said of it
NAMES = {"torque": "torque error", "mass": "flow error", "sensor": "instrument's error"}
METERS = {
    "pressure": "pressure gauge",
    "flow": "flow meter",
    "speed": "tachometer",
    "force": "force sensor",
    "torque": "torque sensor",
}
CLEAREST, AS_WELL, BESIDE = 0, 1, 2  # ranks


class Kind(StrEnum):
    """What is said of a place."""

    BALANCE = "balance"  # that a balance, or a reading along time, does not close along a coordinate
    METER = "meter"  # that an instrument errs along its own range
    STEP = "step"  # that something is off from a moment on
    ROW = "row"  # that a reading stands out


@dataclass(frozen=True)
class Place:
    """One place, as in diagnosis/1; numbers SI.

    `recording`, `file`: of several recordings the one that it is in, and the run in time or the file; else empty.
    """

    kind: Kind
    channel: str
    balance: str
    coordinate: str
    where: tuple[float, float]
    unit: str
    p_value: float
    sentence: str
    same_as: tuple[str, ...]
    recording: str = ""
    file: str = ""


@dataclass(frozen=True)
class _Tested:
    """A force that passed its test, with its p-value and its pieces' scores; whether the detection had it."""

    force: Force
    p: float
    scores: np.ndarray
    first: bool

    @property
    def key(self) -> Key:
        return self.force.channel, self.force.balance, self.force.coordinate, self.force.recording


def locate(
    comparison: Compared, mode: Mode, detection: Detection, free: Sequence[Force], acts_in: str = ""
) -> list[Place]:
    """Places of a mismatch, the clearest first.

    `acts_in`: where the effect that explains it acts, when one does: then a flow is the instrument's or the balance's.
    """
    problem = linearize(comparison, mode, detection.u)
    smooth = {one.key: one for one in processes(problem)}
    tested = []
    seen = list(zip(detection.force_log_p, detection.force_scores, strict=True))
    for force, (log_p, scores) in zip(free, seen, strict=True):
        p = min(1.0, len(free) * math.exp(max(log_p, LEAST_LOG_P)))
        tested.append(_Tested(force, p, scores, True))
    had = {one.key for one in tested}
    further = [force_along(one.of) for key, one in smooth.items() if key not in had]
    angle = comparison.places.angle_force(mode)
    further += [angle] if angle is not None else []
    price = len(free) + len(further) + 1  # the single rows are one more
    for force in further:
        log_p, scores = _tail(problem, force.columns)
        tested.append(_Tested(force, min(1.0, price * math.exp(max(log_p, LEAST_LOG_P))), scores, False))
    passed = [one for one in tested if one.p < FOUND_P]
    ranks, best = _ranks(problem, passed, smooth, price)
    places = _said(problem, passed, ranks, smooth if best else {}, acts_in)
    beside = [one.force.columns for one in passed if one.first] + ([best.hats] if best else [])
    return [*places, *_rows(linearize(comparison, mode, detection.u, every=True), beside, price)]


def _ranks(
    problem: Linearized, passed: Sequence[_Tested], smooth: dict[Key, Process], price: float
) -> tuple[list[int | None], Process | None]:
    """Each tested force's rank, None for a shadow; and the smooth process of most evidence, where it has enough."""
    gains = {one.key: evidence(problem, smooth[one.key]) for one in passed if one.key in smooth}
    top = max(gains, key=lambda key: gains[key], default=None)
    if top is None or gains[top] < DECIDES:  # too faint to tell places apart
        return [CLEAREST if one.first else None for one in passed], None
    best, least = smooth[top], max(ADDS, CROOKED * gains[top])
    ranks: list[int | None] = []
    for one in passed:
        if one.key in gains:
            if gains[one.key] >= gains[top] - DECIDES:
                ranks.append(CLEAREST if one.first else AS_WELL)
            else:
                ranks.append(BESIDE if evidence(problem, smooth[one.key], best.white) >= least else None)
            continue
        adds = -_tail(problem, one.force.columns, best.hats)[0] - math.log(price / FOUND_P) > least - ADDS
        rest = evidence(problem, best, problem.columns(one.force.columns))
        if adds and rest >= DECIDES:
            ranks.append(BESIDE)
        else:
            ranks.append(None if rest >= DECIDES else CLEAREST)
    return ranks, best


def _said(
    problem: Linearized,
    passed: Sequence[_Tested],
    ranks: Sequence[int | None],
    smooth: dict[Key, Process],
    acts_in: str,
) -> list[Place]:
    comparison, mode = problem.comparison, problem.mode
    ordered = sorted(
        ((rank, one) for rank, one in zip(ranks, passed, strict=True) if rank is not None),
        key=lambda pair: (pair[0], pair[1].p),
    )
    alone = any(rank == CLEAREST for rank, _ in ordered)
    found = []
    for rank, one in ordered:
        force = one.force
        as_well = rank == AS_WELL
        if as_well and force.balance != "sensor" and alone:
            continue  # said by same_as
        same = comparison.places.same_coordinates(mode, force.coordinate)
        if rank in (CLEAREST, AS_WELL):
            alike = (o.force for r, o in ordered if r in (CLEAREST, AS_WELL) and o.force.balance == force.balance)
            names = (a.coordinate for a in alike if a.channel == force.channel and a.coordinate != force.coordinate)
            same = tuple(dict.fromkeys([*same, *(name for name in names if name != "phase")]))
        where = stands_out(problem, smooth[one.key]) if one.key in smooth else None
        found.append(_place(one, where or _where(one), same, acts_in, as_well and alone))
    return found


def _where(one: _Tested) -> tuple[float, float]:
    size = np.abs(one.scores)
    out = np.flatnonzero(size >= max(STANDS_OUT * size.max(), -float(ndtri(0.01))))
    if not out.size:
        out = np.array([int(np.argmax(size))])
    return float(one.force.places[out, 0].min()), float(one.force.places[out, 1].max())


def _place(one: _Tested, where: tuple[float, float], same: tuple[str, ...], acts_in: str, as_well: bool) -> Place:
    force = one.force
    balance = "sensor" if acts_in == "sensor" else force.balance
    by_a_meter = "; by what is named, an instrument's error" if balance != force.balance else ""
    meter = METERS.get(force.channel, f"{force.channel} sensor")
    between = f"between {where[0]:.3g} and {where[1]:.3g} {force.unit}".rstrip()
    span = f"most {between}"
    of = f" of {force.recording}" if force.recording else ""
    kind = Kind.BALANCE
    if force.balance == "sensor" and force.coordinate == "time":
        sentence = f"The {meter}'s reading departs from the model's with time, {span}."
    elif force.balance == "sensor":
        kind, verb = Kind.METER, "would do as well" if as_well else "is seen"
        sentence = f"An error of the {meter}{of} along its own range {verb}, {span}."
    else:
        largest = f"largest {between}"
        along = f"depends on {force.coordinate}{of}, {largest}"
        if force.coordinate == "phase":
            along = f"in {force.file}{of} is {largest} after its start"
        elif force.coordinate == "angle":
            along = f"depends on the shaft's angle{of}: something comes with every turn"
        sentence = f"The {NAMES.get(balance, f'{balance} error')} {along} (seen in the {force.channel}{by_a_meter})."
    return Place(
        kind,
        force.channel,
        balance,
        force.coordinate,
        where,
        force.unit,
        one.p,
        sentence,
        same,
        force.recording,
        force.file,
    )


def _tail(problem: Linearized, columns: np.ndarray, beside: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """Log tail probability of a force, nuisances and another force free beside it, and its pieces' scores."""
    J = problem.J if beside is None else np.hstack([problem.J, freed(problem.columns(beside))])
    B = problem.columns(columns)
    P, b = B.T @ project(J, B), B.T @ project(J, problem.y)
    value, vector = np.linalg.eigh(P)
    use = value > 1e-6 * max(float(np.max(np.einsum("ij,ij->j", B, B), initial=0.0)), 1e-12)
    Q = float(np.sum((vector[:, use].T @ b) ** 2 / value[use]))
    scores: np.ndarray = b / np.sqrt(np.maximum(np.diag(P), 1e-12))
    return log_tail(Q, int(use.sum())), scores


def _rows(problem: Linearized, beside: Sequence[np.ndarray], price: float) -> list[Place]:
    """Single readings that stand out though every force found is free beside them, one after the other."""
    comparison = problem.comparison
    rows = comparison.rows
    J = np.hstack([problem.J, *(freed(problem.columns(columns)) for columns in beside)])
    found: list[Place] = []
    if not rows:
        return found
    count = int(comparison.known[: len(rows)].sum())
    each = problem.columns(np.eye(comparison.read.size, len(rows)))
    norms = np.linalg.norm(each, axis=0)
    for _ in range(MOST_ROWS):
        rest = project(J, each)
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", each, rest), 1e-12))
        seen = (size > LEFT * norms) & (norms > 0.0)  # a reading that sets a force says nothing of itself
        score = np.where(seen, rest.T @ problem.y / size, 0.0)
        i = int(np.argmax(np.abs(score)))
        p = min(1.0, price * count * 2.0 * float(ndtr(-abs(score[i]))))
        if p >= FOUND_P:
            break
        found.append(_row_place(rows[i].file, rows[i].row, rows[i].channel, p))
        J = np.column_stack([J, freed(each[:, [i]])])
    return found


def force_along(one: Balance) -> Force:
    """A free-form force or error in a few pieces."""
    low, top = float(np.nanmin(one.values)), float(np.nanmax(one.values))
    edges = np.linspace(low, top + 1e-9 * (top - low), PIECES + 1)

    columns = one.columns(lambda x: hats(np.nan_to_num(x, nan=-np.inf), edges)) * one.scale
    unit = one.along.unit
    return Force(one.channel, one.balance, one.along.name, unit, columns, spans(edges), recording=one.recording)


def rows_as_places(bad: Sequence[tuple[str, int, str, float]]) -> list[Place]:
    """Single readings that nothing explains, as places.

    `bad`: file, row, channel and the probability that the reading is bad.
    """
    # By Markov's inequality a Bayes factor of b has p < 1/b; the prior odds of a bad reading, 1 : 99, price 99 of them.
    return [_row_place(file, row, channel, 1.0 - probability) for file, row, channel, probability in bad]


def _row_place(file: str, row: int, channel: str, p: float) -> Place:
    sentence = f"The {channel} in {file}, row {row}, stands out from everything else."
    return Place(Kind.ROW, channel, "sensor", "row", (float(row), float(row)), "1", p, sentence, (), file=file)
