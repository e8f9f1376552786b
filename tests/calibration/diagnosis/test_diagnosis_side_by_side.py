"""Sets refitted side by side: the same to the bit, whatever becomes of the processes."""

from __future__ import annotations

import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.diagnosis.mismatch import detect_mismatch
from calibration.diagnosis.steps.search import Search
from calibration.likelihood import descent
from calibration.likelihood.descent import find
from calibration.likelihood.mode import cost_of
from calibration.likelihood.signatures import signatures
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.work.side_by_side import SideBySide
from model.motor import read_motor
from tests import diagnosis_recordings as recordings

pytestmark = pytest.mark.long

DRAG = {"windage": {"drag_nm_s2": 2e-4}}


def test_a_motor_can_be_sent_to_another_process() -> None:
    motor = read_motor("ptm3600")
    assert pickle.loads(pickle.dumps(motor)) == motor  # noqa: S301 - our own bytes


def test_processes_answer_in_order_and_elsewhere() -> None:
    with SideBySide(2) as side_by_side:
        side_by_side.begin(["calibration.diagnosis.steps.name"])
        assert side_by_side(divmod, [(7, 2), (9, 4), (1, 1)]) == [(3, 1), (2, 1), (1, 0)]
        assert os.getpid() not in side_by_side(os.getpid, [(), ()])
    with SideBySide(1) as alone:
        assert alone(os.getpid, [(), ()]) == [os.getpid()] * 2


def test_what_a_killed_process_was_to_do_is_done_all_the_same() -> None:
    with SideBySide(2) as side_by_side:
        side_by_side.begin(["calibration.diagnosis.steps.name"])
        assert side_by_side(_die_elsewhere, [(os.getpid(),), (os.getpid(),)]) == [os.getpid()] * 2
        assert side_by_side(os.getpid, [(), ()]) == [os.getpid()] * 2


def _die_elsewhere(home: int) -> int:
    if os.getpid() != home:
        os.kill(os.getpid(), 9)
    return home


def test_what_a_turn_knows_of_those_before_does_not_hang_on_the_processes() -> None:
    for workers in (1, 2):
        with SideBySide(workers) as side_by_side:
            side_by_side.begin(["calibration.diagnosis.steps.name"])
            taken, known = [], []

            def ask(turn: int, taken=taken, known=known) -> tuple[int, int]:
                known.append(len(taken))
                return turn, 2

            side_by_side.in_turn(divmod, 6, ask, lambda turn, answer, taken=taken: taken.append((turn, answer)), 3)
        assert known == [0, 0, 0, 1, 2, 3]
        assert taken == [(turn, divmod(turn, 2)) for turn in range(6)]


def test_the_turns_of_a_killed_process_are_done_all_the_same() -> None:
    with SideBySide(2) as side_by_side:
        side_by_side.begin(["calibration.diagnosis.steps.name"])
        taken: list[int] = []
        side_by_side.in_turn(
            _die_elsewhere, 5, lambda turn: (os.getpid(),), lambda turn, answer: taken.append(answer), 3
        )
    assert taken == [os.getpid()] * 5


def test_the_base_model_is_the_same_to_the_bit_in_threads(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    recording = recordings.add_coast_down(tmp_path, 3, DRAG)
    alone, beside = (detect_mismatch(recording, np.random.default_rng(1), workers=count) for count in (1, 2))
    assert np.array_equal(alone.base.z, beside.base.z) and np.array_equal(alone.base.D, beside.base.D)
    assert alone.detection.p_value == beside.detection.p_value


def test_sets_are_the_same_to_the_bit_side_by_side(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    found, ends = [one for one in signatures(comparison, base) if one.effect in ("windage", "leakage")], []
    for workers in (1, 2):
        with SideBySide(workers) as side_by_side:
            side_by_side.begin(["calibration.diagnosis.steps.name"])
            search = Search(comparison, base, side_by_side)
            search.singles(found, base.u, -np.inf)
        ends.append({names: (mode.log_evidence, mode.z.tobytes()) for names, mode in search.modes.items()})
    assert len(ends[0]) > 2
    assert ends[0] == ends[1]


def test_a_search_far_behind_ends_early(tmp_path: Path, monkeypatch) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    right = find(comparison, ("windage",), base)
    finished, descend = [], descent._descend
    monkeypatch.setattr(
        descent, "_descend", lambda *given, **more: finished.append("correlated" in more) or descend(*given, **more)
    )
    for ahead, ends in ((200.0, True), (0.0, False)):
        again = find(comparison, ("windage",), base, best=cost_of(comparison, right) - ahead)
        assert any(finished) is not ends
        finished.clear()
    assert np.array_equal(again.z, right.z)


def test_what_is_close_behind_the_best_set_is_looked_for_from_its_point(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    search = Search(comparison, base)
    both = find(comparison, ("coulomb_friction", "windage"), base)
    alone = find(comparison, ("windage",), both)
    short = replace(alone, z=np.append(base.z, 0.0), log_evidence=both.log_evidence - 40.0)  # a search that ended early
    far = replace(base, z=np.append(base.z, 0.0), names=("inertia",))
    search.modes |= {both.names: both, alone.names: short, far.names: far}
    search.again()
    assert search.modes[("windage",)].log_evidence > alone.log_evidence - 0.5
    assert search.modes[far.names] is far  # far behind, and no part of it
    assert search.modes[both.names] is both
