"""The search behind a diagnosis: the valley of f_overall, runs in time, the vented gauge, unseen runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.challenge.second_rig import draw, make_recording
from calibration.data.joined import GAP_S
from calibration.diagnosis import as_json, diagnose, together
from calibration.diagnosis.mismatch import detect_mismatch, fit_base
from calibration.diagnosis.steps.confirm import summed_up
from calibration.diagnosis.steps.detect import MISMATCH_P, detect
from calibration.diagnosis.steps.name import screen
from calibration.diagnosis.steps.search import Search
from calibration.diagnosis.steps.unseen import predict_unseen
from calibration.likelihood import descent
from calibration.likelihood.descent import find
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import signatures
from calibration.studies.nulls_draw import null_recording
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.places.forces import forces
from calibration.systems.radial_piston.predict.carried import carried
from calibration.systems.radial_piston.predict.in_time import Plan, Pulses, Sampled
from calibration.systems.radial_piston.predict.kinds import RUN, VENTED
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.systems.radial_piston.predict.supply import FORMS, WANDERS, Course
from calibration.work.step_clock import StepClock
from model import layout as at
from model.effects import effects
from model.effects.effect import unknown_state
from model.motor import read_motor
from model.solvers.transient import Supply, rest_state
from rig.recording import Recording, RecordingError, read_recording
from tests import diagnosis_recordings as recordings

LEAK = {"leakage": {"conductance_kg_s_pa2": 4e-14}}
DRAG = {"windage": {"drag_nm_s2": 2e-4}}


def with_zero(folder: Path, reading_bar: float) -> Recording:
    """A recording with ten readings of the vented gauge added to it."""
    (folder / "zero.csv").write_text(
        "time_s,pressure_bar_abs\n" + "".join(f"{i},{reading_bar + 0.001 * (-1) ** i:.4f}\n" for i in range(10)),
        encoding="utf-8",
    )
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    both = '{ file = "sweep.csv", kind = "steady" }, { file = "zero.csv", kind = "zero" }'
    text = text.replace('{ file = "sweep.csv", kind = "steady" }', both)
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return read_recording(folder)


def delay(comparison: Comparison, base: Mode, line: str) -> float:
    """By how much a line follows its valve late on the average [s]: its moment, and both its lags."""
    names = [one.name for one in comparison.problem.nuisances]
    places = [names.index(f"{line}_{what}") for what in ("late", "time", "valve")]
    return sum(float(comparison.problem.nuisances[i].value(base.z[i])) for i in places)


def test_a_step_along_the_valley_keeps_the_plateaus_speeds(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 1, {})))
    mode = find(comparison, ())
    f = Function(comparison, ())
    moved = mode.z.copy()
    moved[[u.name for u in comparison.problem.nuisances].index("port_lap")] += 0.5
    expected = mode.prediction.speed + mode.D[comparison.n : 2 * comparison.n] @ (moved - mode.z)
    straight = np.linalg.norm(f(moved).speed - expected)
    end = f.along_valley(mode.z, moved, mode.prediction, mode.D)
    assert np.linalg.norm(f(end).speed - expected) < 0.5 * straight
    changed = [u.name for u, a, b in zip(comparison.problem.nuisances, end, moved, strict=True) if a != b]
    assert set(changed) <= {"f_overall", "inertia"}


def test_a_step_along_the_valley_keeps_the_friction_over_the_inertia_on_the_shaft(tmp_path: Path) -> None:
    """A coast-down shows that ratio."""
    problem = Problem(replace(recordings.sweep(tmp_path, 1, {}), added_inertia_kg_m2=0.015))
    comparison = Comparison(problem)
    mode = find(comparison, ())
    moved = mode.z.copy()
    moved[problem.place("port_lap")] += 0.5
    end = Function(comparison, ()).along_valley(mode.z, moved, mode.prediction, mode.D)
    before, after = (problem.split(z)[0] for z in (mode.z, end))
    assert after[at.F_OVERALL] != pytest.approx(before[at.F_OVERALL], rel=1e-4)
    assert after[at.F_OVERALL] / after[at.J] == pytest.approx(before[at.F_OVERALL] / before[at.J])


def test_an_unknown_of_one_run_is_differentiated_with_that_run_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = {"coulomb_friction": {"torque_nm": 0.1}}
    recordings.sweep(tmp_path, 1, chosen)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 1, chosen)))
    problem, f = comparison.problem, Function(comparison, ("coulomb_friction",))
    z = np.zeros(f.low.size)
    z[-1] = 0.5
    given = (z, f(z), np.zeros((comparison.read.size, z.size)), np.zeros(5))
    alone = f.derivatives(*given)
    mine = [i for i in range(f.k) if problem.run_of(i) is not None]
    names = {problem.nuisances[i].name for i in mine}
    assert {f"coast_down.csv.{x}" for x in ("supply", "venting_late", "venting_time", "gauge_late")} < names
    assert all(name.startswith("coast_down.csv.") for name in names)
    monkeypatch.setattr(Problem, "run_of", lambda self, i: None)
    whole, plateaus = f.derivatives(*given), slice(0, 2 * comparison.n)
    assert np.array_equal(alone[plateaus.stop :], whole[plateaus.stop :])
    assert np.all(alone[plateaus, mine] == 0.0)
    assert np.any(alone[plateaus.stop :, mine] != 0.0, axis=0).all()


def test_a_step_in_the_quantities_themselves_is_straight_again_when_it_is_taken_back(tmp_path: Path) -> None:
    f = Function(Comparison(Problem(recordings.sweep(tmp_path, 1, {}))), ("coulomb_friction",))
    move = np.random.default_rng(1).normal(0.0, 0.3, f.low.size)
    z = np.linspace(-1.0, 1.0, f.low.size)
    assert f.straight(z, f.advance(z, move)) == pytest.approx(move, abs=1e-12)


def test_a_long_way_along_the_valley_of_roller_and_dry_friction_costs_nothing(tmp_path: Path) -> None:
    """Roller friction is log-normal: what it does to the speeds is straight in the factor, not in its logarithm."""
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 1, {})))
    mode = find(comparison, ("coulomb_friction",), first={("coulomb_friction", "torque_nm"): 0.2})
    f = Function(comparison, ("coulomb_friction",))
    place = [u.name for u in comparison.problem.nuisances].index("roller_friction")
    white, misses = comparison.whitener(mode.prediction, mode.u), {}
    move = np.zeros(f.low.size)
    move[place] = 0.5
    moved = f.advance(mode.z, move)
    expected = comparison.raw(mode.prediction) + mode.D @ move
    for name, end in (("curved", f.along_valley(mode.z, moved, mode.prediction, mode.D)), ("straight", mode.z + move)):
        misses[name] = np.linalg.norm(white(comparison.raw(f(end)) - expected)[comparison.n : 2 * comparison.n])
    assert misses["curved"] < 0.1 * misses["straight"]


def test_what_may_stand_in_for_a_member_is_seen_where_the_set_fits(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 3, DRAG)))
    mode = find(comparison, ("windage",))
    found = signatures(comparison, mode)
    beside = {name: gain for name, gain, _ in screen(comparison, mode, found, mode.u, -np.inf)}
    instead = {name: gain for name, gain, _ in screen(comparison, mode, found, mode.u, -np.inf, without="windage")}
    assert max(beside.values()) < 3.0
    nearest = sorted(instead, key=lambda name: -instead[name])[:2]
    assert set(nearest) == {"inlet_throttling", "exhaust_back_pressure"}
    assert min(instead[name] for name in nearest) > 20.0


@pytest.mark.parametrize(
    ("name", "truth", "rival", "behind"),
    [
        # The middle of the one's prior is all of it; the other's shape is no part of its size.
        ("flow_density_correction", {"share": 1.0}, "flow_scale", "leakage"),
        ("stribeck_friction", {"torque_nm": 0.3, "speed_rad_s": 15.0}, "windage", "inlet_throttling"),
    ],
)
def test_a_member_is_left_out_whole_whatever_its_prior(
    name: str, truth: dict[str, float], rival: str, behind: str, tmp_path: Path
) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 3, {name: truth})))
    mode = find(comparison, (name,), base_of(comparison))
    found = signatures(comparison, mode)
    gains = {one: gain for one, gain, _ in screen(comparison, mode, found, mode.u, -np.inf, without=name)}
    assert gains[rival] > gains[behind] + 20.0


def test_a_set_is_searched_from_the_starts_that_give_readings(tmp_path: Path, monkeypatch) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    wanted = find(comparison, ("windage",), base)
    begin = descent._begin

    def stalls(comparison, f, start, *rest):
        if start is None:
            raise ArithmeticError("stalls")
        return begin(comparison, f, start, *rest)

    monkeypatch.setattr(descent, "_begin", stalls)
    assert np.array_equal(find(comparison, ("windage",), None, base).z, wanted.z)
    with pytest.raises(ArithmeticError, match="the model with windage gives no reading"):
        find(comparison, ("windage",))


@pytest.mark.long
def test_a_torque_fixed_to_the_shaft_predicts_a_run_in_which_the_shaft_stood_elsewhere(tmp_path: Path) -> None:
    truth = {"once_per_rev_torque": {"sine_nm": 0.15, "cosine_nm": 0.0}}
    (tmp_path / "seen").mkdir()
    recordings.sweep(tmp_path / "seen", 4, truth)
    seen = Comparison(Problem(recordings.add_coast_down(tmp_path / "seen", 4, truth)))
    base = base_of(seen)
    chosen = find(seen, ("once_per_rev_torque",), base)
    for turned, sine in (("as it was", 0.15), ("half a turn on", -0.15)):
        folder = tmp_path / turned
        folder.mkdir()
        other = {"once_per_rev_torque": {"sine_nm": sine, "cosine_nm": 0.0}}
        recordings.sweep(folder, 5, other)
        unseen = recordings.add_coast_down(folder, 5, other)
        assert predict_unseen(seen, base, chosen, unseen).gain > 0.0


@pytest.mark.long
def test_a_rival_that_the_screen_at_the_base_model_does_not_see_is_refitted(tmp_path: Path) -> None:
    """Too much air, and a meter that reads low: together they leave the base model a flow that is off by little."""
    both = LEAK | {"flow_offset": {"offset_m3_s": -1.2e-4}}
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 5, both)))
    base = base_of(comparison)
    search = Search(comparison, base)
    search.modes[("flow_offset", "flow_scale")] = find(comparison, ("flow_offset", "flow_scale"), base)
    search.swap()
    assert ("flow_offset", "leakage") in search.modes
    best = max(mode.log_evidence for mode in search.modes.values())
    assert search.modes[("flow_offset", "leakage")].log_evidence > best - 3.0


@pytest.mark.long
def test_a_pair_that_the_linear_model_does_not_see_is_named(tmp_path: Path) -> None:
    """A leak and Stribeck friction: at a leak and windage the linear model gives the friction nothing."""
    make_recording(draw("development", 18, "unseen-2"), tmp_path / "recording")
    found = diagnose(read_recording(tmp_path / "recording"))
    assert found.verdict.chosen is not None
    assert found.verdict.chosen.names == ("leakage", "stribeck_friction")


@pytest.mark.long
def test_a_set_is_not_left_far_behind_a_loud_base_model(tmp_path: Path) -> None:
    """A torque that no effect has: near the declared noise a search ended 1000 nats behind where it began."""
    make_recording(draw("development", 310_003, "follow-ups"), tmp_path / "recording")
    comparison, base = fit_base([read_recording(tmp_path / "recording")], StepClock(lambda _: None))
    search = Search(comparison, base)
    search.also([("windage",), ("leakage",)])
    assert all(mode.log_evidence > base.log_evidence - 10.0 for mode in search.modes.values())
    assert len(search.modes) == 3


@pytest.mark.parametrize(
    ("in_time", "promised", "count"), [(True, 19, 0), (True, 21, 2), (False, -1, 0), (False, 1, 2)]
)
def test_what_promises_far_less_than_a_member_is_worth_is_not_refitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_time: bool, promised: float, count: int
) -> None:
    """Both members are worth 40 nats: with runs in time half of that has to be in view."""
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 5, LEAK)))
    comparison.in_time = in_time
    base = base_of(comparison)
    both = find(comparison, ("flow_offset", "leakage"), base)
    search = Search(comparison, base)
    search.modes[both.names] = replace(both, log_evidence=base.log_evidence + 80.0)
    for name in both.names:
        search.modes[(name,)] = replace(base, names=(name,), log_evidence=base.log_evidence + 40.0)
    monkeypatch.setattr("calibration.diagnosis.steps.search.screen", lambda *_, **__: [("windage", promised, {})])
    tried: list[tuple[str, ...]] = []
    monkeypatch.setattr(search, "_refit", lambda jobs: tried.extend(job.names for job in jobs))
    search.swap()
    assert len(tried) == count


def test_each_single_effect_that_may_stand_beside_the_best_is_refitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six are refitted at first; of the others those that promise at most 6.6 nats less than the best has gained."""
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 5, LEAK)))
    base = base_of(comparison)
    search = Search(comparison, base)
    names = sorted(effect.id for effect in comparison.problem.effects_that_could() if not effect.hidden)
    promised = [*(9.0 - i for i in range(6)), -1.5, -1.7]
    canned = [(name, gain, {}) for name, gain in zip(names, promised, strict=False)]
    monkeypatch.setattr("calibration.diagnosis.steps.search.screen", lambda *_, **__: canned)
    tried: list[str] = []

    def gain_five(jobs: list[Any]) -> None:
        for (name,) in (job.names for job in jobs):
            tried.append(name)
            search.modes[(name,)] = replace(base, names=(name,), log_evidence=base.log_evidence + 5.0)

    monkeypatch.setattr(search, "_refit", gain_five)
    search.singles([], base.u)
    assert tried == names[:7]


@pytest.mark.parametrize("seed", [2, 5])
def test_much_heat_from_the_walls_is_found_though_a_little_would_be_none(tmp_path: Path, seed: int) -> None:
    """A little heat slows the motor more than much of it: from none, a search stays at none."""
    comparison = Comparison(Problem(recordings.sweep(tmp_path, seed, {"wall_heat_exchange": {"extra_share": 28.0}})))
    base = base_of(comparison)
    search = Search(comparison, base)
    search.singles(signatures(comparison, base), base.u)
    found = search.modes[("wall_heat_exchange",)]
    assert found.log_evidence > find(comparison, ("wall_heat_exchange",), base).log_evidence + 5.0
    assert found.log_evidence == max(mode.log_evidence for mode in search.modes.values())


def test_what_the_pulses_add_is_much_the_same_near_by(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 2, {})))
    f = Function(comparison, ())
    z = np.zeros(f.k)
    before, used = f(z).runs[0], comparison.used[0]
    names = [u.name for u in comparison.problem.nuisances]
    for name in ("f_overall", "inertia", "coast_down.csv.venting_time"):
        moved = z.copy()
        moved[names.index(name)] += 0.05
        comparison.see_pulses(z)
        kept = f(moved).runs[0]
        comparison.see_pulses(moved)
        anew = f(moved).runs[0]
        assert np.linalg.norm((anew - kept)[used]) < 0.2 * np.linalg.norm((anew - before)[used]), name


@pytest.mark.parametrize(
    "names",
    [
        ("coulomb_friction",),
        ("windage",),
        ("load_friction",),
        ("friction_warm_up",),
        ("inlet_throttling",),
        ("exhaust_back_pressure",),
        ("coulomb_friction", "exhaust_back_pressure"),
        ("exhaust_back_pressure", "flow_density_correction"),
        ("inlet_throttling", "leakage"),
        ("exhaust_back_pressure", "load_friction", "pressure_gauge_offset", "windage"),
    ],
    ids="+".join,
)
def test_derivatives_are_those_of_plateaus_solved_in_full(tmp_path: Path, names: tuple[str, ...]) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 11, {})))
    f = Function(comparison, names)
    z, u = np.full(f.low.size, 0.3), np.zeros(5)
    here = f(z)
    steps = f.derivatives(z, here, np.zeros((comparison.read.size, z.size)), u, f)
    white = comparison.whitener(here, u)
    near, full = (white(f.derivatives(z, here, steps, u, of)) for of in (f, lambda z, *, around=None: f(z)))
    size, wrong = np.linalg.norm(full, axis=0), np.linalg.norm(near - full, axis=0)
    assert np.all(wrong <= 1e-3 * size + 1e-6)
    assert np.any(size > 1.0)


def test_two_starts_end_at_the_same_evidence(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    ends = [find(comparison, ("coulomb_friction",), start).log_evidence for start in (base, None)]
    assert abs(ends[0] - ends[1]) < 0.5


@pytest.mark.long
@pytest.mark.slow
def test_a_search_ends_at_one_place_behind_a_line_that_empties_slowly(tmp_path: Path) -> None:
    """From a model without effects, from a rival and from its own end."""
    make_recording(draw("development", 540021, "follow-ups"), tmp_path)
    comparison, base = fit_base(read_recording(tmp_path), StepClock(lambda _: None), 1)
    inlet, exhaust = (find(comparison, (name,), base) for name in ("inlet_throttling", "exhaust_back_pressure"))
    for start in (exhaust, inlet):
        assert find(comparison, inlet.names, start).log_evidence == pytest.approx(inlet.log_evidence, abs=0.2)
    assert find(comparison, exhaust.names, inlet).log_evidence == pytest.approx(exhaust.log_evidence, abs=0.2)


def test_a_set_whose_search_ended_short_is_refitted_from_a_close_one_that_holds_it(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 5, {"inlet_throttling": {"loss_pa_s2_m6": 8e9}})))
    base, inlet = base_of(comparison), ("inlet_throttling",)
    single, pair, other = (find(comparison, one, base) for one in (inlet, (*inlet, "windage"), ("leakage",)))
    search = Search(comparison, base)
    short = replace(single, z=np.append(base.z, 0.1), log_evidence=base.log_evidence)
    search.modes |= {inlet: short, pair.names: pair, other.names: replace(other, log_evidence=pair.log_evidence + 1.0)}
    search.again()
    assert search.modes[inlet].log_evidence == pytest.approx(single.log_evidence, abs=0.1)


@pytest.mark.parametrize("kind", ["coast-down", "start from rest"])
def test_the_mean_torque_follows_a_torque_that_is_fixed_to_the_shaft(tmp_path: Path, kind: str) -> None:
    """What it adds to a run, by the mean torque and with every pulse of the cylinders."""
    once = {"once_per_rev_torque": {"sine_nm": 0.03, "cosine_nm": -0.04}}
    recordings.sweep(tmp_path, 2, {})
    recording = recordings.add_coast_down(tmp_path, 2, {})
    problem = Problem(recording)
    split = problem.split(np.zeros(len(problem.nuisances)))
    if kind == "start from rest":
        line = np.array([[0.0, 2e5, 1.0]])
        plan = problem.plan(0, split, {})
        at = replace(plan.at, time=np.arange(0.0, 0.6, 0.005))
        plan = replace(plan, line=line, at=at, start=rest_state(problem.motor, 0.1))
        plans = [replace(plan, chosen=chosen) for chosen in ({}, once)]
    else:
        plans = [problem.plan(0, split, chosen) for chosen in ({}, once)]
    mean, pulses = ([f(plan) for plan in plans] for f in (Plan.mean_speed, Plan.with_pulses))
    count = 80 if kind == "start from rest" else plans[0].at.begin.size
    # Late in a coast-down it moves the phase of the pulses, which the mean torque does not have.
    by = [(found[1] - found[0])[-count:][: count // 2] for found in (mean, pulses)]
    assert np.max(np.abs(by[1])) > 0.2
    assert np.sqrt(np.mean((by[0] - by[1]) ** 2)) < 0.25 * np.sqrt(np.mean(by[1] ** 2))


def test_a_torque_turned_on_is_that_of_an_angle_turned_back() -> None:
    effect = effects()["once_per_rev_torque"]
    angle, values = np.linspace(0.0, 6.0, 7), {"sine_nm": 0.3, "cosine_nm": -0.2}
    here = replace(unknown_state(angle), angle=angle)
    there = replace(here, angle=angle + 0.7)
    assert effect.torque is not None and effect.turned is not None
    assert effect.torque(effect.turned(values, 0.7), here) == pytest.approx(effect.torque(values, there), abs=1e-12)


def test_of_a_coast_down_only_what_follows_the_closing_valve_is_compared(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    run = Problem(recordings.add_coast_down(tmp_path, 2, {})).blocks.runs[0]
    closed = run.valve[1].start_s - 0.5 * run.unseen_s[1]  # the last row that says open
    assert not run.used[run.begin < closed - 1e-9].any()
    assert np.flatnonzero(run.used)[0] == np.flatnonzero(run.begin >= closed - 1e-9)[0]


@pytest.mark.long
def test_a_line_that_empties_late_is_no_missing_physics(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 4, {})
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 4, {}, late=0.004)))
    base = base_of(comparison)
    (run,) = comparison.problem.blocks.runs
    vented = run.valve[1].start_s + delay(comparison, base, "coast_down.csv.venting")
    assert vented == pytest.approx(0.1 + 0.004, abs=0.0015)
    detection = detect(
        comparison, base, signatures(comparison, base), forces(comparison, base), np.random.default_rng(1)
    )
    assert detection.p_value > 0.01


@pytest.mark.parametrize("bend", [-0.3, 0.0, 0.3, 0.5])
def test_a_line_empties_through_a_valve_that_opens_evenly(bend: float) -> None:
    own = {f"venting_form_{k}": 0.0 for k in range(len(FORMS))} | {"venting_late": 0.01, "venting_bend": bend}
    own |= {"venting_time": 0.04, "venting_valve": 0.015}
    time, valve = np.linspace(0.0, 0.3, 3001), (Supply(-1.0, 2e5, True), Supply(0.0, 1e5, False))
    opened = np.clip((time - 0.01) / 0.03, 0.0, 1.0)
    left = np.ones(time.size)
    for k in range(1, time.size):  # dx/dt = -open x^(1 - bend) / time, by the midpoint
        rate, mean_open = left[k - 1], 0.5 * (opened[k - 1] + opened[k])
        middle = max(rate - 0.5 * 1e-4 * mean_open / 0.04 * max(rate, 0.0) ** (1.0 - bend), 0.0)
        left[k] = max(rate - 1e-4 * mean_open / 0.04 * middle ** (1.0 - bend), 0.0)
    assert Course(valve, own, 1.0, AT_ONCE).share(time) == pytest.approx(left, abs=2e-4)


@pytest.mark.parametrize(("lead", "droop"), [(0.0, 0.0), (0.4, 0.0), (0.0, 0.1), (-0.2, 0.2)])
def test_a_line_fills_through_two_lags_and_a_regulator_that_droops(lead: float, droop: float) -> None:
    slow, fast = 0.1, 0.02
    own = line_of_no_deviations() | {"opening_time": slow, "opening_valve": fast}
    own |= {"opening_late": 0.01, "opening_lead": lead, "opening_droop": droop}
    time, valve = np.linspace(0.0, 0.6, 6001), (Supply(-1.0, 1e5, False), Supply(0.0, 2e5, True))
    turning = 0.2 + 0.1 * (np.arange(24) + 0.5) / 24  # the rotor breaks away at 0.2 s, and has settled at 0.3 s
    called = np.clip((time - 0.2) / 0.1, 0.0, 1.0)
    wanted = np.where(time > 0.01, 1.0 + droop * (1.0 - called), 0.0)
    regulated, line = np.zeros(time.size), np.zeros(time.size)
    for k in range(1, time.size):
        regulated[k] = regulated[k - 1] + 1e-4 / slow * (wanted[k - 1] - regulated[k - 1])
        line[k] = line[k - 1] + 1e-4 / fast * (lead * wanted[k - 1] + (1.0 - lead) * regulated[k - 1] - line[k - 1])
    assert Course(valve, own, 1.0, turning).share(time) == pytest.approx(np.maximum(line, 0.0), abs=2e-3)


AT_ONCE = np.zeros(24)


def line_of_no_deviations() -> dict[str, float]:
    """A line that fills as its lags alone have it."""
    deviations = [*(f"opening_form_{k}" for k in range(len(FORMS))), *(f"wander_{k}" for k in range(WANDERS))]
    return dict.fromkeys([*deviations, "opening_late", "opening_lead", "opening_droop"], 0.0)


def base_of_null(folder: Path, seed: int) -> dict[str, float]:
    """Most probable nuisances of a recording by the second rig in which nothing is missing [prior sds]."""
    nothing = {"category": "none", "ids": [], "effects": [], "sizes": {}, "place": {}, "total_sds": {}}
    truth = replace(draw("development", seed, "follow-ups"), **nothing, near_nuisance=False, with_transients=True)
    make_recording(truth, folder / "null")
    comparison, base = fit_base(read_recording(folder / "null"), lambda *_: None)
    return {one.name: float(z) for one, z in zip(comparison.problem.nuisances, base.z, strict=True)}


@pytest.mark.long
def test_a_line_that_a_slow_valve_vents_is_no_surprise(tmp_path: Path) -> None:
    found = base_of_null(tmp_path, 740149)  # valve 0.055 s, line 0.22 L
    forms = [found[f"coast_down.csv.venting_form_{k}"] for k in range(len(FORMS))]
    assert np.abs(forms).max() < 2.0


@pytest.mark.long
def test_a_rotor_that_is_caught_while_its_line_fills_is_no_surprise(tmp_path: Path) -> None:
    found = base_of_null(tmp_path, 740093)  # moves at 0.02 s, stands from 0.09 to 0.48 s
    assert abs(found["spin_up.csv.begun"]) < 2.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [820007, 830004])  # a droop of 0.11 bar; a line that fills to a half at once
def test_a_line_that_a_regulator_fills_is_no_surprise(tmp_path: Path, seed: int) -> None:
    found = base_of_null(tmp_path, seed)
    assert max(abs(z) for name, z in found.items() if "opening" in name or "wander" in name) < 3.0


def test_a_line_has_no_kink_where_its_two_lags_are_alike() -> None:
    """A search that comes there would find no way on."""
    own = line_of_no_deviations() | {"opening_time": 0.03}
    time, valve = np.linspace(0.0, 0.3, 61), (Supply(-1.0, 1e5, False), Supply(0.0, 2e5, True))

    def slope(fast: float) -> np.ndarray:
        low, high = (
            Course(valve, own | {"opening_valve": fast + by}, 1.0, AT_ONCE).share(time) for by in (-1e-7, 1e-7)
        )
        return (high - low) / 2e-7

    slopes = [slope(0.03 * share) for share in (0.99, 0.9995, 1.0, 1.0005, 1.01)]
    assert np.abs(slopes[0]).max() > 1.0
    for one in slopes[1:]:
        assert one == pytest.approx(slopes[0], abs=0.02 * np.abs(slopes[0]).max())


@pytest.mark.long
def test_air_that_enters_late_is_no_missing_physics(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 6, {})
    comparison = Comparison(Problem(recordings.add_spin_up(tmp_path, 6, {}, late=0.006)))
    base = base_of(comparison)
    # Where the rotor stood makes a start a millisecond or so later.
    (run,) = comparison.problem.blocks.runs
    opened = run.valve[1].start_s + delay(comparison, base, "spin_up.csv.opening")
    assert opened == pytest.approx(0.05 + 0.006, abs=0.003)
    detection = detect(
        comparison, base, signatures(comparison, base), forces(comparison, base), np.random.default_rng(1)
    )
    assert detection.p_value > 0.05


def test_a_run_of_a_few_samples_is_left_aside(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    recordings.add_coast_down(tmp_path, 2, {})
    file = tmp_path / "coast_down.csv"
    closed = Problem(read_recording(tmp_path)).blocks.runs[0].valve[1].start_s
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if float(row.partition(",")[0]) <= closed + 0.012]
    file.write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")
    assert Problem(read_recording(tmp_path)).blocks.runs == ()


@pytest.mark.long
def test_drag_is_found_with_its_size_in_a_coast_down(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = base_of(comparison)
    found = find(comparison, ("windage",))
    assert found.log_evidence > base.log_evidence + 10.0
    k = len(comparison.problem.nuisances)
    said = comparison.problem.chosen(("windage",), found.z[k:])["windage"]["drag_nm_s2"]
    sd = np.sqrt(found.covariance[k, k]) * 1e-4
    assert abs(said - 2e-4) < 4.0 * sd + 0.1 * 2e-4
    assert np.sum(found.r[comparison.kind == RUN] ** 2) < 2.0 * np.sum(comparison.kind == RUN)


@pytest.mark.long
def test_a_vented_gauge_that_reads_high_is_named(tmp_path: Path) -> None:
    high = {"pressure_gauge_offset": {"offset_pa": 5000.0}}
    recordings.sweep(tmp_path, 4, high)
    recording = with_zero(tmp_path, 1.01325 + 0.05)
    assert np.sum(Comparison(Problem(recording)).kind == VENTED) == 1
    found = as_json(diagnose(recording, 1))
    assert found["verdict"] in ("named", "confounded")
    assert "pressure_gauge_offset" in {e["id"] for e in found["effects"]}


def test_a_vented_gauge_that_reads_right_is_consistent(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    assert as_json(diagnose(with_zero(tmp_path, 1.0135), 1))["verdict"] == "consistent"


@pytest.mark.long
def test_what_pulls_a_nuisance_is_handed_over_to_the_effect_that_has_its_form(tmp_path: Path) -> None:
    """An inertia 0.9 too large is a nuisance pulled by six sds and a share of it: the two multiply to the same."""
    heavy = {"inertia": {"share": 0.9}}
    recordings.sweep(tmp_path, 5, heavy)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 5, heavy)))
    place, k = comparison.problem.place("inertia"), len(comparison.problem.nuisances)
    assert place is not None
    base = base_of(comparison)
    assert abs(base.z[place]) > descent.PULLED
    found = find(comparison, ("inertia",), base)
    nuisance, (_, unknown) = comparison.problem.nuisances[place], comparison.problem.effect_unknowns(("inertia",))[0]
    factors = float(nuisance.value(found.z[place]) / nuisance.value(0.0)), 1.0 + float(unknown.value(found.z[k]))
    assert factors[0] * factors[1] == pytest.approx(1.9, rel=0.05)
    assert abs(found.z[place]) < 2.0 and factors[1] > 1.6


def test_an_unseen_run_speaks_for_the_effect_that_is_there(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path / "seen", 6, LEAK)))
    base, leak = find(comparison, ()), find(comparison, ("leakage",))
    unseen = recordings.sweep(tmp_path / "unseen", 7, LEAK)
    told = predict_unseen(comparison, base, leak, unseen)
    assert told.gain > told.gain_se > 0.0 and told.scheme == "unseen run unseen"
    assert told.after["flow_m3_s"] < told.before["flow_m3_s"]
    clean = predict_unseen(comparison, base, leak, recordings.sweep(tmp_path / "clean", 8, {}))
    assert clean.gain < 0.0 < told.gain


def test_a_run_of_another_motor_is_not_predicted(tmp_path: Path) -> None:
    seen = recordings.sweep(tmp_path / "seen", 6, LEAK)
    other = replace(recordings.sweep(tmp_path / "unseen", 7, LEAK), motor="another")
    told: list[str] = []
    with pytest.raises(RecordingError, match="of the motor another, not of the motor ptm3600"):
        diagnose(seen, 1, told.append, hold_out=other)
    assert told == []  # before anything is fitted


def test_errors_on_an_unseen_run_are_of_the_readings_that_there_are(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path / "seen", 6, {})))
    base = find(comparison, ())
    unseen = recordings.sweep(tmp_path / "unseen", 7, LEAK)
    place = tmp_path / "unseen" / "sweep.csv"
    head, *rows = place.read_text().splitlines()
    flow = head.split(",").index("flow_l_min")
    empty = [
        ",".join("" if i == flow and k % 4 else cell for i, cell in enumerate(row.split(",")))
        for k, row in enumerate(rows)
    ]
    place.write_text("\n".join([head, *empty]) + "\n")
    whole, some = (predict_unseen(comparison, base, base, one) for one in (unseen, read_recording(tmp_path / "unseen")))
    assert some.before["flow_m3_s"] == pytest.approx(whole.before["flow_m3_s"], rel=0.35)  # shared by all rows: half


@pytest.mark.parametrize("added", [0.0, 0.015, -0.002])
def test_with_another_flywheel_the_rotor_keeps_its_inertia(tmp_path: Path, added: float) -> None:
    recordings.sweep(tmp_path, 5, {})
    seen = Problem(replace(recordings.add_coast_down(tmp_path, 5, {}), added_inertia_kg_m2=0.003))
    there = Problem(replace(seen.recording, added_inertia_kg_m2=0.003 + added))
    place = seen.place("inertia")
    assert place is not None
    z = np.zeros(len(seen.nuisances))
    z[place] = 1.3
    mode: Any = SimpleNamespace(z=z, covariance=np.diag(np.full(z.size, 0.04)))
    found, covariance, new = carried(seen, mode, there)
    rotor = seen.nuisances[place].value(z[place])
    for problem, at_z, flywheel in ((seen, z, 0.003), (there, found, 0.003 + added)):
        assert problem.split(at_z)[0][at.J] == pytest.approx(rotor + flywheel)
    assert not new.any() and np.array_equal(found, z) and np.array_equal(covariance, mode.covariance)


def test_with_a_flywheel_the_effect_and_the_nuisance_are_the_rotors_alike(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    problem = Problem(replace(recordings.add_coast_down(tmp_path, 5, {}), added_inertia_kg_m2=0.015))
    place = problem.place("inertia")
    assert place is not None
    z = np.zeros(len(problem.nuisances))
    by_effect = problem.predict(z, {"inertia": {"share": 0.4}})
    z[place] = problem.nuisances[place].z(1.4 * read_motor("ptm3600").si("inertia"))
    by_nuisance, bare = problem.predict(z, {}), problem.predict(np.zeros(z.size), {})
    assert by_effect.runs[0] == pytest.approx(by_nuisance.runs[0], rel=1e-9, nan_ok=True)
    assert np.nanmax(np.abs(by_effect.runs[0] - bare.runs[0])) > 0.1  # rad/s


def test_of_several_runs_each_is_held_out_whole(tmp_path: Path) -> None:
    coasted = []
    for i in range(3):
        recordings.sweep(tmp_path / str(i), 5, {})
        coasted.append(recordings.add_coast_down(tmp_path / str(i), 5, {}))
    for count, parts in ((2, 6), (3, 3)):
        comparison = Comparison(Problem(together(coasted[:count])))
        of_runs = [mask for mask in comparison.folds()[0] if np.any(comparison.kind[mask] >= RUN)]
        assert len(of_runs) == parts
        assert np.array_equal(np.sum(of_runs, axis=0) > 0, comparison.kind >= RUN)
    errors = [comparison.read[mask] for mask in of_runs]
    scheme = summed_up(comparison, of_runs, 0, [1.0, 2.0, 3.0], {"before": errors, "after": errors}).scheme
    assert scheme == "pressure levels and whole runs, selection repeated in each fold"


def test_recordings_of_one_bench_are_diagnosed_together(tmp_path: Path) -> None:
    one, other = recordings.sweep(tmp_path / "one", 9, {}), recordings.sweep(tmp_path / "other", 10, {})
    both = together([one, other])
    assert [file.file for file in both.files] == ["one/sweep.csv", "other/sweep.csv"]
    assert both.files[1].start_s > float(one.files[0].columns["time_s"].values[-1])
    assert Problem(both).blocks.plateaus.size == 2 * Problem(one).blocks.plateaus.size


def test_rows_without_a_time_take_none_on_the_clock_of_recordings_together(tmp_path: Path) -> None:
    one = recordings.sweep(tmp_path / "one", 9, {})
    file = one.files[0]
    bare = replace(file, columns={name: column for name, column in file.columns.items() if name != "time_s"})
    first, second = together([replace(one, files=(bare,)), replace(one, folder=tmp_path / "other")]).files
    assert second.start_s - first.start_s == GAP_S


def test_recordings_of_other_weather_are_not_mixed(tmp_path: Path) -> None:
    one, other = recordings.sweep(tmp_path / "one", 9, {}), recordings.sweep(tmp_path / "other", 10, {})
    elsewhere = replace(other, ambient=replace(other.ambient, pressure_bar_abs=0.95))
    with pytest.raises(RecordingError, match=r"\[ambient\]"):
        together([one, elsewhere])


def test_a_level_that_was_seen_to_turn_is_not_given_up_as_standing() -> None:
    """Seeds whose lowest level is close to a stall, where a search once ended with it standing and its readings bad."""
    for seed in (900030, 900000):
        nothing, _ = null_recording("declared", False, np.random.default_rng(seed))
        base = base_of(Comparison(Problem(nothing)))
        assert np.all(base.bad < 0.5)
        assert np.sum(base.r**2) < 80.0  # of 52 readings


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(1400052, id="beside a level that stands, with a reading that is noise"),
        pytest.param(1400988, id="held by the lap, whatever the roller friction"),
    ],
)
def test_a_search_that_ends_with_a_turning_level_at_rest_makes_it_turn(seed: int) -> None:
    """Nulls that were called mismatches: the search had ended 1400 nats short, and the speed seemed all noise."""
    draw, test = (np.random.default_rng(one) for one in np.random.SeedSequence((seed, 0, 0)).spawn(2))
    nothing, _ = null_recording("declared", False, draw)
    first = detect_mismatch(nothing, test)
    assert np.sum(first.base.r**2) < 80.0  # of 52 readings
    assert first.detection.p_value > MISMATCH_P


class _TurnsBack(Plan):
    """A shaft that comes to rest and turns back, as one may by which pressure is left in a cylinder."""

    def mean_speed(self) -> np.ndarray:
        return 5.0 - 2.0 * self.time

    def simulated(self, finer: int = 1) -> SimpleNamespace:
        time = np.linspace(self.time[0], self.time[-1], (self.time.size - 1) * finer + 1)
        return SimpleNamespace(time=time, angle=5.0 * time - time**2 + 0.01 * np.sin(30.0 * time))


def test_a_shaft_that_turns_back_has_pulses_all_the_same() -> None:
    time = np.linspace(0.0, 5.0, 101)
    places = np.arange(time.size - 1)
    motor = read_motor("ptm3600").vector()
    at = Sampled(slice(0, 100), time, places, places + 1, 0.0)
    nothing = np.zeros(0)
    planned = _TurnsBack(
        motor, np.zeros(5), np.zeros((0, 3)), at, np.zeros(23), {}, 0.0, 0.0, 0.0, 0.0, 0.0, nothing, nothing
    )
    assert np.all(np.isfinite(Pulses(planned).beside(planned)))
