"""The benchmark's pieces at a tiny size: they run and give sane figures. Nothing here asserts a time."""

import importlib
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration.fit.sampling import Settings
from model.motor import read_motor

BENCH = Path(__file__).resolve().parents[1] / "bench"
MOTOR = read_motor("ptm3600")


@pytest.fixture
def bench(monkeypatch):
    """The benchmark's modules by name; they stand beside its script, as Python finds them when it is run."""
    monkeypatch.syspath_prepend(str(BENCH))
    return importlib.import_module


def quiet(words):
    """In place of a progress bar."""


# Times


def test_tasks_are_timed_in_turn_after_a_first_call_apart(bench):
    calls = []
    found = bench("timing").round_robin({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=2)
    assert set(found) == {"a", "b"}
    assert all(0.0 < t.least <= t.median <= t.most for t in found.values())
    runs = [name for i, name in enumerate(calls) if i == 0 or calls[i - 1] != name]
    assert runs == ["a", "b"] * 3


def test_one_core_gives_the_cores_back(bench):
    import numba

    before = numba.get_num_threads()
    with bench("timing").one_core():
        assert numba.get_num_threads() == 1
    assert numba.get_num_threads() == before


# Rows


def test_a_rate_is_better_when_it_is_higher_and_a_time_when_it_is_lower(bench):
    row = bench("results").Row
    assert row("t", "w", ours=2.0, peer=6.0, unit="s").ratio == 3.0
    assert row("t", "w", ours=6.0, peer=2.0, unit="1/s", more_is_better=True).ratio == 3.0


def test_a_goal_is_met_missed_or_absent(bench):
    row = bench("results").Row
    assert row("t", "w", 1.0, 300.0, "s", ratio_goal=300.0).met is True
    assert row("t", "w", 1.0, 299.0, "s", ratio_goal=300.0).met is False
    assert row("t", "w", 0.4, None, "s", most=0.3).met is False
    assert row("t", "w", 0.4, None, "s").met is None


def test_the_page_keeps_what_stands_around_its_block(bench):
    results = bench("results")
    block = results.page_block([results.Row("Topic", "thing", 1.0, 2.0, "s")], {"cores": 2})
    page = f"before\n{results.BEGIN}\nold\n{results.END}\nafter\n"
    renewed = results.with_block(page, block)
    assert renewed.startswith("before\n") and renewed.endswith("\nafter\n") and "old" not in renewed
    assert "| thing | 1 | 2 | s | 2 |" in renewed
    assert results.with_block(renewed, block) == renewed
    with pytest.raises(ValueError, match="no block"):
        results.with_block("a page without marks", block)


def test_the_shipped_page_has_the_block(bench):
    page = (BENCH.parents[1] / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert "new block" in bench("results").with_block(page, "new block")


# Solvers


def test_the_steady_speed_is_within_a_hundred_ppm_where_the_march_is_off_by_three_per_mille(bench):
    ours, march = bench("operating_point").speed_errors(MOTOR, np.array([2.0e5]))
    assert ours < 1e-4
    assert 1e-3 < march < 1e-2


def test_the_march_is_slower_than_a_point_of_a_batch(bench):
    found = bench("operating_point").against_march(MOTOR, sets=4, rounds=1)
    assert all(row.unit == "µs" and row.ratio > 1.0 for row in found)


@pytest.mark.long
def test_scipy_agrees_with_the_transient_in_a_short_spin_up(bench):
    peer, spin_up = bench("scipy_peer"), bench("spin_up")
    true = spin_up.ours(MOTOR, 0.05, refine=16)
    for method in peer.METHODS:
        end = peer.spin_up(peer.problem(MOTOR, spin_up.PRESSURE), 0.05, method, 1e-7)
        assert spin_up.error(end, true) < 1e-5


def test_tuning_takes_the_coarsest_tolerance_that_is_good_enough(bench):
    peer = bench("scipy_peer")
    good = peer.tune(lambda method, rtol: rtol, lambda result: result, 1e-4, "LSODA")
    assert (good.rtol, good.error, good.reached) == (1e-4, 1e-4, True)
    never = peer.tune(lambda method, rtol: rtol, lambda result: 1.0, 1e-4, "LSODA")
    assert (never.rtol, never.reached) == (peer.LADDER[-1], False)


# Samplers


def test_all_samplers_draw_from_a_normal_distribution(bench):
    draws = bench("draws")
    target = draws.gaussian(2)
    chain, seconds = draws.ours(target, Settings(seed=1, effective_samples=200, most_steps=25, walkers=16))
    assert seconds > 0.0
    assert chain.flat().std(axis=0) == pytest.approx([math.sqrt(0.2)] * 2, rel=0.2)
    start = np.random.default_rng(1).normal(scale=math.sqrt(0.2), size=(16, 2))
    vectorised, tau = draws.stretch(target, start, 600)
    assert 5.0 < tau < 100.0
    assert vectorised.effective == pytest.approx(600 * 16 / tau)
    assert draws.stretch_alone(target, start, 5, tau).effective == pytest.approx(5 * 16 / tau)
    nested = draws.nested(target, 20.0)
    assert nested.effective > 100.0 and "stopped" not in nested.note


# The whole


def test_help_starts_in_a_process_of_its_own(bench):
    row = bench("cold_start").help_row(1)
    assert row.ours > 0.0 and row.unit == "s"


def test_a_command_that_fails_says_what_it_said(bench):
    with pytest.raises(RuntimeError, match="ended with 3: too bad"):
        bench("cold_start")._run(["-c", "import sys; sys.stderr.write('too bad'); sys.exit(3)"])


@pytest.mark.long
@pytest.mark.slow
def test_the_quick_benchmark_writes_its_figures_and_its_page(bench, tmp_path):
    results = bench("results")
    figures, page = tmp_path / "bench.json", tmp_path / "page.md"
    page.write_text(f"# Page\n{results.BEGIN}\n{results.END}\n", encoding="utf-8")
    command = [sys.executable, str(BENCH / "run.py"), "--quick", "--json", str(figures), "--page", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["quick"] is True and found["machine"]["cores"] >= 1
    assert all(row["ours"] > 0.0 for row in found["rows"])
    text = page.read_text(encoding="utf-8")
    assert all(row["what"] in text for row in found["rows"])
