"""What is no effect of the list: the place, the law and the smooth correction, of a drag that nobody has named.

The mismatches are added to the readings of a recording of the model itself, as the model made linear has them.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.diagnosis import diagnose
from calibration.diagnosis.steps.correction import corrections, hold_out, nuisances_beside
from calibration.diagnosis.steps.detect import detect
from calibration.diagnosis.steps.discover import STABLE, discover
from calibration.diagnosis.steps.locate import Place, locate
from calibration.likelihood.descent import find
from calibration.likelihood.mode import Mode, robust_weights
from calibration.likelihood.signatures import signatures
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.noise import SPREAD
from calibration.systems.radial_piston.places.forces import TorqueAnswer, forces, torque_column
from calibration.systems.radial_piston.places.further_forces import not_observable
from calibration.systems.radial_piston.places.terms import forms
from calibration.systems.radial_piston.predict.problem import Problem
from rig.recording import read_recording
from tests.diagnosis_recordings import add_coast_down, sweep

ENGAGES = 30.0  # rad/s
DRAG = 0.2  # N m
U = np.zeros(SPREAD.size)

Changed = tuple[Comparison, Mode]


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Changed:
    """A sweep of the model itself."""
    comparison = Comparison(Problem(sweep(tmp_path_factory.mktemp("swept"), 21, {})))
    return comparison, find(comparison, ())


@pytest.fixture(scope="module")
def coasted(tmp_path_factory) -> Changed:
    """The same with a coast-down, which parts speed from pressure."""
    folder = tmp_path_factory.mktemp("coasted")
    sweep(folder, 21, {})
    comparison = Comparison(Problem(add_coast_down(folder, 22, {})))
    return comparison, find(comparison, ())


def added(of: Changed, change: np.ndarray) -> Changed:
    """The recording with a change of its readings [SI]."""
    comparison = copy.copy(of[0])
    comparison.read = comparison.read + change
    r = of[1].r + comparison.whitener(of[1].prediction, of[1].u)(change)
    return comparison, replace(of[1], r=r)


def dragged(of: Changed, law: Callable[[np.ndarray], np.ndarray]) -> Changed:
    comparison, base = of
    speeds = [base.prediction.runs[i][used] for i, used in enumerate(comparison.used)]
    steady, *runs = [law(speed)[:, None] for speed in (np.nan_to_num(base.prediction.speed), *speeds)]
    return added(of, TorqueAnswer(comparison, torque_column(comparison, base))(steady, runs)[:, 0])


def clutch(omega: np.ndarray) -> np.ndarray:
    return DRAG * (omega > ENGAGES)


def places_of(of: Changed) -> list[Place]:
    free = forces(*of)
    return locate(*of, detect(*of, [], free, np.random.default_rng(0), draws=20), free)


def test_a_drag_that_sets_in_is_found_with_its_threshold_and_its_stability(coasted):
    found = discover(*dragged(coasted, clutch), U, np.random.default_rng(1))
    assert found is not None
    assert found.unit == "N m"
    assert len(found.stability) <= 2
    assert min(found.stability) >= STABLE
    size, threshold = map(float, re.fullmatch(r"([\d.]+)\*\(omega > ([\d.]+)\)", found.expression).groups())
    assert size == pytest.approx(DRAG, rel=0.1)
    assert threshold == pytest.approx(ENGAGES, abs=2.2)  # there is no level between 28.3 and 32.8 rad/s


def test_a_flow_that_sets_in_is_a_law_of_the_flow_balance(swept):
    comparison, base = swept
    change = np.zeros(comparison.read.size)
    change[: comparison.n] = 1.5e-4 * (base.prediction.speed > ENGAGES)
    found = discover(*added(swept, change), U, np.random.default_rng(1), "mass")
    assert found is not None
    assert (found.balance, found.unit) == ("mass", "m3/s")


@pytest.mark.long
def test_no_law_is_found_where_nothing_is_left_out(swept, coasted):
    for of in (swept, coasted):
        for balance in ("torque", "mass"):
            assert discover(*of, U, np.random.default_rng(1), balance) is None


def test_the_smooth_correction_follows_the_drag_and_predicts_what_it_has_not_seen(coasted):
    of = dragged(coasted, clutch)
    best = corrections(*of, U)[0]
    assert (best.balance, best.coordinate) == ("torque", "speed")
    low, high = (np.mean(best.mean[side]) for side in (best.at < ENGAGES - 5.0, best.at > ENGAGES + 3.0))
    assert high - low == pytest.approx(DRAG, abs=0.1)
    held_out = hold_out(*of, U)
    assert held_out is not None
    assert held_out.gain > 2.0 * held_out.gain_se
    assert held_out.same == held_out.folds
    assert held_out.after["speed_rad_s"] < held_out.before["speed_rad_s"]


def test_the_smooth_correction_gains_next_to_nothing_where_nothing_is_left_out(swept):
    held_out = hold_out(*swept, U)
    assert held_out is not None
    assert held_out.gain < 4.0
    for curve in corrections(*swept, U):
        assert curve.gain < 5.0


def test_f_overall_beside_a_torque_that_nobody_knows_holds_what_the_coast_down_cannot_tell_from_it(coasted):
    of = dragged(coasted, lambda omega: clutch(omega) + 2.0 * DRAG * omega / ENGAGES)
    unknowns = of[0].problem.nuisances
    place = [unknown.name for unknown in unknowns].index("f_overall")
    smooth = corrections(*of, U)
    assert smooth[0].balance == "torque"
    z, sd = (one[place] for one in nuisances_beside(*of, smooth))
    low, true, high = unknowns[place].value(np.array([z - 1.645 * sd, of[1].z[place], z + 1.645 * sd]))
    assert low < true < high
    assert sd > 2.0 * smooth[0].z_sd[place]  # the process alone would not allow as much
    renamed = copy.copy(of[0])
    renamed.problem = copy.copy(of[0].problem)
    renamed.problem.nuisances = [replace(one, own=one.own.replace("f_overall", "held")) for one in unknowns]
    np.testing.assert_allclose(nuisances_beside(renamed, of[1], smooth[:1])[1], smooth[0].z_sd)  # it is no unknown
    flows = [one for one in smooth if one.balance == "mass"]
    for one in flows:  # a flow is no part of the friction
        np.testing.assert_allclose(nuisances_beside(*of, [one])[1], one.z_sd)


def test_what_f_overall_can_do_is_no_correction(swept):
    comparison, base = dragged(swept, lambda omega: 2e-2 * omega)
    assert corrections(comparison, base, U)[0].gain < 0.0
    held = base.D.copy()
    held[:, [unknown.name for unknown in comparison.problem.nuisances].index("f_overall")] = 0.0
    assert corrections(comparison, replace(base, D=held), U)[0].gain > 100.0  # without f_overall it is one


def test_a_drag_along_speed_is_not_said_to_be_along_time_too(coasted):
    found = places_of(dragged(coasted, clutch))
    assert (found[0].balance, found[0].coordinate) == ("torque", "speed")
    assert found[0].where[0] < ENGAGES + 5.0 < found[0].where[1]
    assert "time" not in [place.coordinate for place in found]


def test_a_sweep_alone_cannot_tell_a_drag_from_an_error_of_the_gauge_along_its_range(swept):
    found = places_of(dragged(swept, lambda omega: 2e-4 * omega**2))
    assert found[0].same_as == ("pressure", "flow")
    assert ("sensor", "pressure") in [(place.balance, place.coordinate) for place in found]
    assert any(place.sentence.startswith("An error of the pressure gauge along its own range") for place in found)


def test_a_single_row_is_placed_beside_a_drag(coasted):
    comparison, base = dragged(coasted, lambda omega: 1e-4 * omega**2)
    change = np.zeros(comparison.read.size)
    row = comparison.n + 5  # the rows beside it set the smooth error of the gauge that may be the drag
    change[row] = 1.5  # rad/s, some 20 sd
    misread = added((comparison, base), change)
    misread[1].bad[row] = 1.0  # as a fit would have it
    rows = [place for place in places_of(misread) if place.coordinate == "row"]
    misread[1].bad[row] = 0.0
    assert [(place.channel, place.where) for place in rows] == [("speed", (6.0, 6.0))]


def test_a_place_in_a_run_names_its_file(coasted):
    comparison, _ = coasted
    change = np.zeros(comparison.read.size)
    run = comparison.kind == 2
    change[run] = np.linspace(0.0, 3.0, int(run.sum()))
    phases = [place for place in places_of(added(coasted, change)) if place.coordinate == "phase"]
    assert all("in coast_down.csv" in place.sentence for place in phases)
    assert phases


def test_what_the_sampling_cannot_show_is_said(swept, coasted):
    assert any(one.startswith("Shaft angle: every row is a mean") for one in not_observable(*swept))
    assert any(one.startswith("Pressure apart from speed and flow") for one in not_observable(*swept))
    assert not any(one.startswith("Shaft angle: every row") for one in not_observable(*coasted))
    assert not any(one.startswith("Sweep direction") for one in not_observable(*swept))


def test_a_law_of_the_shafts_angle_is_looked_for_only_where_samples_resolve_it(swept, coasted):
    assert not any("theta" in one.text for one in forms(*swept))
    assert any("theta" in one.text for one in forms(*coasted))


def test_readings_that_crowd_are_no_misreadings(coasted):
    comparison, _ = coasted
    speeds = np.flatnonzero(comparison.kind == 1)
    few, many = np.zeros(comparison.read.size), np.zeros(comparison.read.size)
    few[speeds[:2]] = many[speeds[:8]] = 10.0
    weight, bad = robust_weights(few, comparison)
    assert np.flatnonzero(bad > 0.5).tolist() == speeds[:2].tolist()
    assert np.all(weight[speeds[:2]] < 0.1)
    weight, bad = robust_weights(many, comparison)
    assert np.all(weight[speeds] == 1.0)
    assert np.all(bad[speeds] == 0.0)


def test_a_level_that_is_off_by_the_same_each_time_is_no_misreading(coasted):
    comparison, _ = coasted
    twice = next(spots for spots in comparison.again if comparison.kind[spots[0]] == 1)
    assert twice.size == 2
    alike, unlike = np.zeros(comparison.read.size), np.zeros(comparison.read.size)
    alike[twice], unlike[twice] = (9.0, 12.0), (9.0, 16.0)
    assert np.all(robust_weights(alike, comparison, found=True)[1] < 0.5)
    assert np.flatnonzero(robust_weights(unlike, comparison, found=True)[1] > 0.5).tolist() == sorted(twice)
    assert np.flatnonzero(robust_weights(alike, comparison)[1] > 0.5).tolist() == sorted(twice)  # on the way
    unlike[twice[1]] = 0.0
    assert np.flatnonzero(robust_weights(unlike, comparison, found=True)[1] > 0.5).tolist() == [twice[0]]


@pytest.mark.long
def test_half_a_sweep_that_turns_slower_is_not_named_as_misread(tmp_path):
    sweep(tmp_path, 21, {})
    lines = (tmp_path / "sweep.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    slower = [[*row[:4], f"{float(row[4]) - 20.0:.1f}" if float(row[4]) > 290.0 else row[4]] for row in rows]
    (tmp_path / "sweep.csv").write_text("\n".join([lines[0], *(",".join(row) for row in slower)]) + "\n")
    found = diagnose(read_recording(tmp_path), 1)
    assert found.verdict.kind == "unresolved"
    assert found.bad_rows == []
    assert found.correction is not None
    assert found.held_out is not None
    assert found.held_out.gain > 4.0
    # Up and down, the fast rows are those in the middle of the time too.
    assert "speed" in {place.coordinate for place in found.places[:2]}


def test_noise_of_the_base_model_that_nobody_believes_is_a_mismatch_though_forces_take_it_up(coasted):
    comparison, base = coasted
    louder = base.u.copy()
    louder[0] += math.log(5.0)
    found, free = signatures(comparison, base), forces(comparison, base)
    quiet, loud = (
        detect(comparison, replace(base, u=u), found, free, np.random.default_rng(1), 20) for u in (base.u, louder)
    )
    assert quiet.p_value > 0.01
    assert loud.p_value < 1e-5
    assert comparison.noise.too_loud(loud.u) is None  # beside the forces it is as declared
