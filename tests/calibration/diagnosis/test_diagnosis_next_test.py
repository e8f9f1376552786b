"""What a further test is expected to tell, how often it has to be made, and with what instrument."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from calibration.data.blocks import levels
from calibration.data.runs_in_time import placeholders
from calibration.diagnosis.next_test.information import densities, given_of, log_density, repeats_needed
from calibration.diagnosis.next_test.recommend import MOST, MOST_APART, NextTest, propose, ranked, weigh
from calibration.diagnosis.next_test.refitted import gained
from calibration.diagnosis.sizes.not_excluded import behind_friction
from calibration.diagnosis.steps.candidate import Candidate, vanishes
from calibration.likelihood.descent import find
from calibration.likelihood.expected import Expected, Test
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.next_tests.planned import FLYWHEEL, _gauge_s, planned
from calibration.systems.radial_piston.next_tests.readings import _left_open, _straight_on, expected_readings
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.unknowns.priors import Unknown
from calibration.work.side_by_side import SideBySide
from model import layout as at
from rig.recording import Column, read_recording
from tests.diagnosis_recordings import add_coast_down, sweep


@pytest.fixture(scope="module")
def comparison(tmp_path_factory) -> Comparison:
    return Comparison(Problem(sweep(tmp_path_factory.mktemp("swept"), 31, {})))


@pytest.fixture(scope="module")
def base(comparison) -> Mode:
    return find(comparison, ())


def rival(comparison: Comparison, base: Mode, name: str) -> Candidate:
    mode = find(comparison, (name,), base)
    return Candidate((name,), mode, mode.log_evidence, math.log(0.5))


def test_what_hardly_anything_speaks_against_is_told_where_f_overall_would_be_another(comparison, base):
    place = comparison.problem.place("f_overall")
    sd = math.sqrt(base.covariance[place, place])

    def candidate(names: tuple[str, ...], sds: float, probability: float) -> Candidate:
        z = base.z.copy()
        z[place] += sds * sd
        return Candidate(names, replace(base, names=names, z=z), base.log_evidence, math.log(probability))

    nothing, dry = candidate((), 0.0, 0.4), candidate(("coulomb_friction",), -5.0, 0.03)
    others = [
        candidate(("leakage",), 1.0, 0.1),  # f_overall stays
        candidate(("windage",), 5.0, 0.01),  # the recording speaks against it
        candidate(("coulomb_friction", "windage"), 5.0, 0.1),
        replace(candidate(("load_friction",), 5.0, 0.1), refused=vanishes("load_friction")),
    ]
    assert behind_friction(comparison, nothing, [nothing, dry, *others]) == [dry]


def normal(mean: float, shared: float, own: float) -> Expected:
    return Expected(np.array([mean]), np.array([[math.sqrt(shared)]]), np.zeros((1, 1)), np.array([[own]]))


def even(one: Expected, other: Expected, repeats: int = 1) -> float:
    """Nats between two explanations that are as probable."""
    return given_of(densities([one, other], repeats), [0.5, 0.5])[0]


def test_the_density_of_straight_readings_is_the_normal_one():
    rng = np.random.default_rng(3)
    slopes, rest = rng.standard_normal((5, 2)), rng.standard_normal((5, 5))
    one = Expected(rng.standard_normal(5), slopes, 0.1 * rest @ rest.T, np.eye(5))
    read = rng.standard_normal(5)
    for repeats in (1, 4):
        law = multivariate_normal(one.mean, slopes @ slopes.T + one.inexact + one.own / repeats)
        told = log_density(one, read, repeats) - 2.5 * math.log(2.0 * math.pi)
        assert told == pytest.approx(law.logpdf(read), abs=1e-9)


def test_an_effect_that_may_be_gone_is_hardly_told_from_nothing():
    """Its size is 1 +- 0.5 and what it reads goes with the square: straight on, half of it would do."""

    def at(place: np.ndarray) -> np.ndarray:
        return 100.0 * np.maximum(1.0 + 0.5 * place, 0.0) ** 2

    zero, one = np.zeros((1, 1)), np.eye(1)
    nothing_, effect = normal(0.0, 0.0, 1.0), Expected(np.array([100.0]), np.array([[100.0]]), zero, one, at)
    assert given_of(densities([nothing_, effect]), [0.9, 0.1])[0] < 6.0
    told = given_of(densities([nothing_, effect]), [0.1, 0.9])[0]
    assert told > 1000.0  # where it is there it is told for certain


def test_what_a_test_gives_is_what_it_gives_with_half_of_the_probability():
    """Of three explanations the second is as probable as not; only the third is far off."""
    read = [normal(place, 0.0, 1.0) for place in (0.0, 1.0, 20.0)]
    whole, each, where_true = given_of(densities(read), [0.3, 0.6, 0.1])
    assert each == {(0, 1): 0.5, (0, 2): 200.0, (1, 2): 180.5}
    # of the second: 0.5 beside the first, 180.5 beside the third, and 180 between these two
    weights = np.array([0.18, 0.06, 0.03])
    assert whole == pytest.approx(float(weights @ [0.5, 180.5, 180.0]) / weights.sum())
    assert where_true[1] == whole < where_true[0]
    assert where_true[2] == pytest.approx(float(weights @ [19.5, 180.5, 200.0]) / weights.sum())
    assert given_of(densities(read), [0.0, 0.0, 0.0]) == given_of(densities(read), [0.2, 0.2, 0.2])


def test_repeats_do_not_average_out_what_is_not_known_of_the_motor():
    hidden = normal(0.0, 1.0, 1.0), normal(1.0, 1.0, 1.0)
    assert repeats_needed(lambda n: even(*hidden, n)) is None
    noisy = normal(0.0, 0.0, 1.0), normal(1.0, 0.0, 1.0)
    needed = repeats_needed(lambda n: even(*noisy, n))
    assert needed == math.ceil(2.0 * math.log(150.0))


def test_a_better_test_than_certainty_still_ranks_first():
    two = [NextTest("a", (("x",), ("y",)), 30.0, 1), NextTest("b", (("x",), ("y",)), 300.0, 1)]
    assert [one.test for one in ranked(two)] == ["b", "a"]


def test_tests_of_other_instruments_come_last_however_much_they_tell():
    own = [NextTest(f"own {i}", (("x",), ("y",)), 1.0 + i) for i in range(6)]
    others = [NextTest(f"other {i}", (("x",), ("y",)), 100.0, 1, "a gauge") for i in range(5)]
    found = ranked([*others, *own])
    assert [bool(one.needs) for one in found] == [False] * MOST + [True] * MOST_APART


def test_what_tells_next_to_nothing_is_left_out():
    assert ranked([NextTest("a", (("x",), ("y",)), 0.01)]) == []


def test_the_bench_plans_runs_plateaus_a_reversed_sweep_and_a_zero(comparison):
    words = [plan.words for plan in planned(comparison)]
    for part in (
        "coast-down from",
        "flywheel",
        "spin-up to",
        "ten plateaus",
        "after an hour",
        "reversed sweep",
        "zero:",
    ):
        assert any(part in one for one in words), part


@pytest.mark.parametrize(("venting_time", "is_slow"), [(2.0, True), (0.5, False), (None, False)])
def test_a_line_that_empties_slowly_is_to_be_vented(comparison, venting_time, is_slow):
    """What a line holds drives the motor while it coasts down, and hides its friction."""
    line = {} if venting_time is None else {"venting_time": venting_time}
    vented = [plan for plan in planned(comparison, line=line) if "the line vented within 0.1 s" in plan.words]
    assert [(one.needs, one.capture) for one in vented] == [("a valve at the motor that vents", None)] * is_slow


@pytest.mark.parametrize(("fastest_rpm", "level"), [(300.0, "3.11 bar abs"), (495.0, "2.6 bar abs"), (560.0, "")])
def test_no_level_is_planned_at_which_the_motor_turns_faster_than_it_may(comparison, fastest_rpm, level):
    """The article's motor is made for 600 rpm; without load its speed goes with the pressure above the ambient."""
    other = copy.copy(comparison)
    other.problem = copy.copy(comparison.problem)
    plateaus = comparison.problem.blocks.plateaus
    speed = plateaus.speed * fastest_rpm * (math.pi / 30.0) / np.nanmax(plateaus.speed)
    other.problem.blocks = replace(comparison.problem.blocks, plateaus=replace(plateaus, speed=speed))
    words = [plan.words for plan in planned(other) if plan.words.startswith("ten plateaus at")]
    assert len(words) == (4 if level else 3)
    assert not level or words[0] == f"ten plateaus at {level}"


@pytest.mark.parametrize("lowest", [0.05, math.nan])
def test_no_level_is_planned_at_which_the_rotor_may_stand_on_another_day(comparison, lowest):
    """A few rpm, or a rotor that stood once, at the lowest level: the room's pressure is another one then."""
    other = copy.copy(comparison)
    other.problem = copy.copy(comparison.problem)
    plateaus = comparison.problem.blocks.plateaus
    second, first = sorted(levels(plateaus), key=lambda group: plateaus.pressure[group[0]])[1::-1]
    speed = plateaus.speed.copy()
    speed[first[0]] = lowest * np.nanmax(speed)
    other.problem.blocks = replace(comparison.problem.blocks, plateaus=replace(plateaus, speed=speed))
    words = [plan.words for plan in planned(other)]
    for group, is_planned in ((first, False), (second, True)):
        assert (_ten_at(plateaus, group) in words) is is_planned
    assert _ten_at(plateaus, first) in [plan.words for plan in planned(comparison)]


def _ten_at(plateaus, group):
    return f"ten plateaus at {math.floor(np.mean(plateaus.pressure[group]) / 1e3) / 100:g} bar abs"


def test_a_test_s_words_its_command_and_its_model_have_one_level(comparison):
    plans = [plan for plan in planned(comparison) if plan.capture and plan.capture.level_bar_abs]
    assert {plan.capture.kind for plan in plans} == {"coast-down", "spin-up", "plateaus"}
    for plan in plans:
        said = re.search(r"(?:from|to|at) ([\d.]+) bar abs", plan.words)[1]
        assert f"--level-bar-abs {said}" in plan.capture.command
        shown = np.nanmax(plan.recording.files[0].columns["pressure_bar_abs"].values)
        assert shown == pytest.approx(float(said), abs=1e-4)


def test_a_flywheel_is_declared_in_the_planned_recording(comparison):
    heavy = next(plan for plan in planned(comparison) if "flywheel" in plan.words)
    inertia = comparison.problem.motor.si("inertia")
    assert heavy.recording.added_inertia_kg_m2 == pytest.approx(FLYWHEEL * inertia)
    problem = Problem(heavy.recording)
    assert problem.split(np.zeros(len(problem.nuisances)))[0][at.J] == pytest.approx((1.0 + FLYWHEEL) * inertia)


def test_beside_a_flywheel_the_words_say_what_is_on_the_shaft_in_all(comparison):
    mounted = Comparison(Problem(replace(comparison.problem.recording, added_inertia_kg_m2=0.015)))
    heavy = next(plan for plan in planned(mounted) if "flywheel" in plan.words)
    assert heavy.words.endswith("with a flywheel of 0.03 kg m2 in all")
    assert heavy.capture.added_inertia_kg_m2 == heavy.recording.added_inertia_kg_m2 == 0.03


@pytest.mark.long
def test_two_losses_of_pressure_are_parted_by_gauges_at_their_places(comparison, base):
    rivals = [rival(comparison, base, name) for name in ("inlet_throttling", "exhaust_back_pressure")]
    rivals = [with_size(comparison, one, 1.0) for one in rivals]
    found = propose(comparison, rivals, base)
    apart = [one for one in found if one.needs]
    assert apart
    assert all("gauge" in one.needs for one in apart)
    assert all(one.repeats == 1 for one in apart if one.information_nats > 50.0)
    assert [bool(one.needs) for one in found] == sorted(bool(one.needs) for one in found)


def nothing(base: Mode) -> Candidate:
    return Candidate((), base, base.log_evidence, math.log(0.5))


def test_what_a_test_tells_of_an_improbable_rival_counts_for_little(comparison, base):
    """A far one is told by anything: by itself that is no reason to take a test."""

    def at(place: float) -> Expected:
        return normal(place, 0.0, 1.0)

    rivals = [nothing(base), *(replace(nothing(base), names=(name,)) for name in ("windage", "leakage"))]
    test = Test("a test", "", lambda modes: [at(0.0), at(0.5), at(10.0)])
    alike = weigh(test, rivals).told
    rare = weigh(test, [*rivals[:2], replace(rivals[2], log_probability=math.log(1e-6))]).told
    assert alike.information_nats > 25.0 and rare.information_nats < 1.0
    lowest, highest = alike.range_nats
    assert lowest <= alike.information_nats <= highest


def with_size(comparison: Comparison, one: Candidate, z: float) -> Candidate:
    """The rival with its effect of ordinary size."""
    k = len(comparison.problem.nuisances)
    point = one.mode.z.copy()
    point[k] = z
    changed = Mode(*(point if name == "z" else value for name, value in vars(one.mode).items()))
    return Candidate(one.names, changed, one.log_evidence, one.log_probability, one.refused)


def test_the_same_explanation_twice_is_not_told_apart(comparison, base):
    one = rival(comparison, base, "windage")
    assert propose(comparison, [one, one], base) == []


def test_the_best_test_is_checked_by_refits_until_it_is_the_best_by_them(comparison, base, monkeypatch):
    """What is not the best, needs another instrument or promises little is not."""
    places = {"far": 14.0, "near": 8.0, "little": 1.0, "with a balance": 20.0}
    by_refits = {"far": 6.0, "near": 7.0}
    refits = []

    def of(words: str) -> Test:
        needs = "a balance" if "balance" in words else ""
        return Test(words, needs, lambda modes: [normal(place, 0.0, 1.0) for place in (0.0, places[words])])

    def by_refit(seen, test, modes, base, pairs, side_by_side):
        refits.append(test.words)
        assert pairs == [(0, 1), (1, 0)]
        return np.full(2, by_refits[test.words])

    def tests(modes):
        return map(of, places)

    monkeypatch.setattr(comparison, "tests", tests)
    monkeypatch.setattr("calibration.diagnosis.next_test.recommend.gained", by_refit)
    rivals = [nothing(base), rival(comparison, base, "windage")]
    found = propose(comparison, rivals, base)
    assert refits == ["far", "near"]
    assert [(one.test, one.information_nats) for one in found] == [
        ("near", 7.0),
        ("far", 6.0),
        ("little", 0.5),
        ("with a balance", 200.0),
    ]
    assert [one.repeats for one in found] == [1, 1, 11, 1]
    by_refits["near"] = 2.0
    assert [one.test for one in propose(comparison, rivals, base)][:2] == ["far", "near"]


def test_what_refits_say_of_a_test_is_what_was_reckoned_where_all_is_straight(tmp_path):
    comparison = Comparison(Problem(sweep(tmp_path, 34, {"pressure_gauge_offset": {"offset_pa": 4000.0}})))
    base = find(comparison, ())
    modes = [base, rival(comparison, base, "pressure_gauge_offset").mode]
    test = next(test for test in comparison.tests(modes) if test.words.startswith("zero: "))
    read = test.expected(modes)
    pairs = [(0, 1), (1, 0)]
    for (true, other), gain in zip(pairs, gained(comparison, test, modes, base, pairs, SideBySide(0)), strict=True):
        reckoned = log_density(read[true], read[true].mean) - log_density(read[other], read[true].mean)
        # half of what noise that is drawn once moves the odds by
        assert abs(gain - reckoned) < 0.5 * math.sqrt(2.0 * reckoned)


@pytest.mark.long
def test_tests_are_proposed_with_runs_in_time_in_the_recording_too(tmp_path):
    sweep(tmp_path, 31, {})
    comparison = Comparison(Problem(add_coast_down(tmp_path, 32, {})))
    base = find(comparison, ())
    rivals = [with_size(comparison, rival(comparison, base, name), 1.0) for name in ("windage", "coulomb_friction")]
    found = propose(comparison, rivals, base)
    assert found
    for test in found:
        assert math.isfinite(test.information_nats)
        assert test.repeats is None or test.repeats >= 1


def test_a_run_is_promised_with_the_line_that_the_recording_shows(tmp_path):
    """A line that empties as slowly as the rotor slows down hides what brakes it."""
    sweep(tmp_path, 33, {})
    comparison = Comparison(Problem(add_coast_down(tmp_path, 33, {})))
    (test,) = [one for one in planned(comparison) if one.words.endswith("of three times the inertia")]
    place = comparison.problem.place("coast_down.csv.venting_time")
    modes = [find(comparison, names) for names in ((), ("coulomb_friction",))]

    def promised(seconds: float) -> float:
        z = float(comparison.problem.nuisances[place].z(seconds))
        here = [replace(one, z=np.where(np.arange(one.z.size) == place, z, one.z)) for one in modes]
        return even(*expected_readings(test, comparison, here))

    assert promised(0.3) < 0.5 * promised(0.03)


def test_a_gauge_that_repeats_itself_is_as_slow_as_it_measures(tmp_path):
    sweep(tmp_path, 33, {})
    recording = add_coast_down(tmp_path, 33, {})
    (run,) = [file for file in recording.files if file.kind == "transient"]
    time = run.columns["time_s"].values
    held = 1.5 + 0.01 * np.floor(time / 0.05)
    column = Column(held, np.zeros(held.size, np.int8))
    files = [replace(run, columns={**run.columns, "pressure_bar_abs": column})]
    assert _gauge_s(replace(recording, files=tuple(files))) == pytest.approx(0.05, abs=0.006)


def test_one_explanation_has_nothing_to_be_parted_from(comparison, base):
    assert propose(comparison, [rival(comparison, base, "windage")], base) == []


def test_a_test_that_separates_nothing_is_not_proposed():
    """Its mean over the pairs may be rounded up to what is worth a test while no pair reaches it."""
    assert ranked([NextTest("reversed sweep", (), 0.1)]) == []


def test_a_run_in_which_the_rotor_would_not_turn_is_not_proposed(comparison, base):
    """A start at a pressure that hardly differs from the room's."""
    spin_up = next(plan for plan in planned(comparison) if plan.words.startswith("spin-up"))
    (run,) = spin_up.recording.files
    name = next(name for name in run.columns if name.startswith("pressure_bar"))
    pressure = run.columns[name]
    faint = replace(
        pressure, values=np.where(pressure.values > 1.1, placeholders(np.full(run.rows, 1.02)), pressure.values)
    )
    files = (replace(run, columns={**run.columns, name: faint}),)
    plan = replace(spin_up, recording=replace(spin_up.recording, files=files))
    rivals = [nothing(base), rival(comparison, base, "windage")]
    test = Test(plan.words, "", partial(expected_readings, plan, comparison), plan.capture)
    assert weigh(test, rivals) is None


@pytest.mark.parametrize(("pulses", "is_told"), [(60.0, True), (2.0, False)])
def test_a_run_of_which_the_tachometer_shows_too_little_is_not_proposed(tmp_path, pulses, is_told):
    """A coast-down takes a turn or two: two pulses in each are none that show its course."""
    place = sweep(tmp_path, 31, {}).folder / "recording.toml"
    head = "[channels.speed_rpm]\n"
    place.write_text(place.read_text().replace(head, f"{head}pulses_per_rev = {pulses}\n"))
    read = Comparison(Problem(read_recording(tmp_path)))
    mode = find(read, ())
    coast_down = next(plan for plan in planned(read) if plan.words.startswith("coast-down"))
    test = Test(coast_down.words, "", partial(expected_readings, coast_down, read), coast_down.capture)
    assert (weigh(test, [nothing(mode), rival(read, mode, "windage")]) is not None) is is_told


@pytest.mark.parametrize(("window_s", "readings"), [(0.005, range(390, 410)), (0.1, None)])
def test_a_run_is_planned_as_the_bench_would_record_it(comparison, base, window_s, readings):
    """Two seconds of a spin-up and a few readings of the gauge; refused where too few readings fall in it."""
    seen = comparison.problem.recording
    name = next(name for name in seen.channels if name.startswith("speed"))
    told = replace(seen, channels={**seen.channels, name: replace(seen.channels[name], window_s=window_s)})
    there = Comparison(Problem(told))
    plan = next(plan for plan in planned(there) if plan.words.startswith("spin-up"))
    if readings is None:
        with pytest.raises(FloatingPointError, match="readings of the speed where 20 are needed"):
            expected_readings(plan, there, [base])
    else:
        (read,) = expected_readings(plan, there, [base])
        assert read.mean.size in readings


def test_a_gauge_that_drifts_from_day_to_day_promises_less(comparison, base):
    """At rest it reads the ambient, its noise and its error: what is known of that is worth less another day."""
    seen = comparison.problem.recording
    name = next(name for name in seen.channels if name.startswith("pressure"))
    found = {}
    for drift_sd in (0.0, 0.004):
        figures = replace(seen.channels[name], serial="G-7", drift_sd=drift_sd)
        there = Comparison(Problem(replace(seen, channels={**seen.channels, name: figures})))
        plan = next(plan for plan in planned(there) if plan.words.startswith("zero"))
        (found[drift_sd],) = expected_readings(plan, there, [base])
    added = found[0.004].own - found[0.0].own
    noise_bar = math.hypot(seen.channels[name].noise_sd, seen.channels[name].resolution / math.sqrt(12.0))
    one = (0.004 / noise_bar) ** 2 * 10.0  # the mean of ten readings, in its noise
    assert np.max(added) == pytest.approx(one, rel=0.05)
    assert np.count_nonzero(np.abs(added) > 1e-9) == 1


@pytest.mark.parametrize(
    "unknown",
    [
        Unknown("roller_friction", "1", "lognormal", 0.008, 2.0, ""),
        Unknown("offset_pa", "Pa", "size", 0.0, 500.0, ""),
        Unknown("ambient_pressure", "Pa", "normal", 101325.0, 150.0, ""),
    ],
)
def test_what_is_against_a_step_is_that_of_readings_straight_in_the_quantity_and_of_the_prior(unknown):
    """A sweep reads the quantity itself: along the tangent a step of four sds would cost far more, or less."""

    def value(z: float) -> float:
        return float(unknown.value(np.asarray(z)))

    noise = 0.4 * (value(0.5) - value(-0.5))
    read = value(1.2) + noise

    def against(z: float) -> float:
        return 0.5 * ((read - value(z)) / noise) ** 2 + 0.5 * z**2

    mode = float(minimize_scalar(against, bounds=(0.0, 3.0), method="bounded", options={"xatol": 1e-10}).x)
    slope = (value(mode + 1e-4) - value(mode - 1e-4)) / 2e-4 / noise
    sd = 1.0 / math.sqrt(slope**2 + 1.0)
    left = _left_open([unknown], np.array([mode]), np.array([[sd**2]]), np.array([False]), np.array([[sd]]))
    none = 0.5 * float(np.sum(left(np.zeros(1)) ** 2))
    for place in (-2.0, -1.0, 1.0, 4.0):
        z = float(_straight_on([unknown], np.array([mode]), np.array([sd * place]))[0])
        found = 0.5 * float(np.sum(left(np.array([place])) ** 2)) - none
        assert found == pytest.approx(against(z) - against(mode), rel=1e-3, abs=1e-3)


def test_an_explanation_that_can_read_like_the_true_one_is_not_told_apart():
    """However bent the way there, and though the rotor would stand on a part of it."""

    def bent(place: np.ndarray) -> np.ndarray:
        size = 8e4 * math.exp(-2.0 * float(place[0]))
        return np.full(4, math.nan) if place[0] > 6.0 else np.full(4, size)

    slopes = np.full((4, 1), -16e4)
    rival = Expected(bent(np.zeros(1)), slopes, np.zeros((4, 4)), np.eye(4), bent)
    true = Expected(np.full(4, 8.0), np.zeros((4, 0)), np.zeros((4, 4)), np.eye(4))
    there = math.log(8e4 / 8.0) / 2.0  # sds away, and each step in a straight line goes half of one
    assert log_density(true, true.mean) == pytest.approx(0.0)
    assert -0.5 * there**2 - 4.0 < log_density(rival, true.mean) < -0.5 * there**2
