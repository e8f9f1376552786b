"""The second rig: reference figures of the article's equations, its draws, and recordings that tell no truth."""

import ast
import itertools
import json
import math
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from calibration.challenge import second_rig
from calibration.challenge.second_rig import (
    Truth,
    bench,
    concealed,
    draw,
    follow_up,
    instruments,
    make_recording,
    recordings,
    separable,
    sheets,
    sizes,
)
from calibration.challenge.second_rig.concealed import USUAL, Concealed
from calibration.challenge.second_rig.draws import ERRORS, MAKE_UP, WIDTHS
from calibration.challenge.second_rig.machine import curve, losses, marches, motor, slots
from calibration.challenge.second_rig.separable import _taken_up
from calibration.challenge.second_rig.signatures import Whitened, asked_of
from calibration.challenge.second_rig.small_torques import SmallTorques
from model.effects import effects
from rig.recording import read_recording

PRESSURES = np.array([1.60, 1.70, 1.80, 1.83, 1.85, 1.95, 2.00]) * 1e5
SPEEDS_HEAT = [229.43, 271.37, 313.28, 325.85, 334.23, 376.12, 397.06]
SPEEDS_ADIABATIC = [229.99, 271.82, 313.66, 326.21, 334.57, 376.41, 397.33]
FLOWS_ADIABATIC = [41.62, 49.40, 57.21, 59.56, 61.12, 68.98, 72.91]


def flow_l_min(found, pressures):
    return found[:, 1] * slots.R_AIR * 293.15 / pressures * slots.L_MIN


@pytest.fixture(scope="module")
def adiabatic():
    return marches.steady(slots.vector({"heat_factor": 0.0}), PRESSURES)


@pytest.fixture(scope="module")
def cases():
    return [draw("proof", index, 11) for index in range(200)]


class TestMotor:
    @pytest.mark.parametrize(
        ("psi", "reach", "phi", "volume"),
        [(0, 67.51, 0, 7.5239), (15, 64.7931, -17.7311, 6.2918), (37, 52.8987, -19.9622, 0.8974),
         (45, 51.6126, 0, 0.3141), (60, 56.6847, 36.0396, 2.6144)],
    )  # fmt: skip
    def test_the_guide_curve_is_the_article_s(self, psi, reach, phi, volume):
        found_reach, found_phi = curve.radius(np.array([math.radians(psi)]))
        assert found_reach[0] * 1e3 == pytest.approx(reach, abs=1e-4)
        assert math.degrees(found_phi[0]) == pytest.approx(phi, abs=1e-4)
        cell = curve.table()[round(psi / 90 * curve.CELLS), curve.VOLUME]
        assert cell * 1e6 == pytest.approx(volume, abs=1e-4)

    @pytest.mark.long
    def test_steady_speeds_with_heat_agree_to_a_fifth_of_a_percent(self):
        found = marches.steady(slots.vector(), PRESSURES)
        assert found[:, 0] * slots.RPM == pytest.approx(SPEEDS_HEAT, rel=2e-3)

    @pytest.mark.long
    def test_steady_speeds_without_heat_agree_to_a_fifth_of_a_percent(self, adiabatic):
        assert adiabatic[:, 0] * slots.RPM == pytest.approx(SPEEDS_ADIABATIC, rel=2e-3)

    def test_flows_agree_to_a_fifth_of_a_percent(self, adiabatic):
        assert flow_l_min(adiabatic, PRESSURES) == pytest.approx(FLOWS_ADIABATIC, rel=2e-3)

    def test_gas_torques_agree_to_three_tenths_of_a_percent(self, adiabatic):
        assert adiabatic[[0, -1], 2] == pytest.approx([1.5994, 2.7283], rel=3e-3)

    def test_ripple_lowers_the_speed_near_stall(self):
        found = marches.steady(slots.vector(), np.array([1.15e5, 1.20e5, 2.40e5]))[:, 0] * slots.RPM
        assert found == pytest.approx([37.36, 60.47, 564.51], rel=0.017)
        assert found[0] < 39.0  # 39.8 without ripple

    def test_halving_the_step_changes_speed_and_flow_by_less_than_a_thousandth(self):
        here, finer = (marches.steady(slots.vector(), PRESSURES[[0, -1]], dt) for dt in (2.5e-5, 1.25e-5))
        assert finer[:, :2] == pytest.approx(here[:, :2], rel=1e-3)

    def test_spin_up_from_rest(self):
        p = slots.vector()
        y = motor.rest(p, marches.TABLE, 0.0, 2e5, True)
        angle = marches.run_in_time(p, marches.TABLE, y, 2e5, np.ones(320, bool), 1e-3, marches.STEP_S)
        speed = [(angle[k + 1] - angle[k - 1]) / 2e-3 * slots.RPM for k in (105, 205, 305)]
        assert 286 * 0.99 < speed[0] < 294 * 1.01
        assert 364 * 0.99 < speed[1] < 368 * 1.01
        assert 387 * 0.99 < speed[2] < 390 * 1.01

    def test_coast_down_with_a_vented_line(self):
        p = slots.vector()
        y = marches.turning(p, marches.TABLE, 2e5, 41.5, 0.0, 0.0, marches.STEP_S)
        angle = marches.run_in_time(p, marches.TABLE, y, 2e5, np.zeros(420, bool), 1e-3, marches.STEP_S)
        speed = [(angle[k + 1] - angle[k - 1]) / 2e-3 * slots.RPM for k in (50, 100)]
        assert speed == pytest.approx([209, 111], abs=8)  # the starting angle alone moves them by 4 and 8 rpm
        assert abs(angle[-1] - angle[-100]) < 0.02

    def test_mass_and_energy_are_kept(self):
        p = slots.vector({"leak_kg_s_pa2": 1e-14})
        y = marches.turning(p, marches.TABLE, 2e5, 41.5, 0.0, 0.0, marches.STEP_S)
        cylinders = slice(motor.MASS, motor.MASS + 7), slice(motor.ENERGY, motor.ENERGY + 7)
        y[motor.IN : motor.PSI] = 0.0
        before = [float(y[part].sum()) for part in cylinders]
        steps = 4000
        for _ in range(steps):
            motor.step(p, marches.TABLE, y, 2e5, True, marches.STEP_S)
        mass, energy = (float(y[part].sum()) - b for part, b in zip(cylinders, before, strict=True))
        leaked = 1e-14 * (2e5**2 - 101_325.0**2) * steps * marches.STEP_S
        assert mass == pytest.approx(y[motor.IN] - leaked - y[motor.OUT], abs=1e-12)
        assert energy == pytest.approx(y[motor.H_IN] + y[motor.HEAT] - y[motor.WORK], abs=1e-9 * y[motor.WORK])
        assert y[motor.WORK] > 0.0

    def test_dry_friction_above_the_gas_torque_holds_the_rotor(self):
        found = marches.steady(slots.vector({"dry_nm": 5.0}), np.array([1.5e5]))
        assert found[0, 0] == 0.0
        assert found[0, 1] == pytest.approx(0.0, abs=1e-9)


def effect(name, form=None, **values):
    return Concealed(name, form or concealed.USUAL[name], values)


ROWS = bench.Plateaus(np.array([1.3, 1.8, 2.3, 2.3, 1.8, 1.3]) * 1e5, np.arange(6) * 200.0, np.repeat([1.0, -1.0], 3))


def changes(*effects):
    """Pressure [bar], flow [L/min] and speed [rpm] read with some effects, less those without."""
    nuisances = {"f_overall": 0.0625}
    a, b = (bench.plateaus(bench.Rig(nuisances, {}, those), ROWS) for those in (effects, ()))
    return (a.pressure - b.pressure) / 1e5, (a.flow - b.flow) * 6e4, (a.speed - b.speed) * slots.RPM


class TestEffects:
    """Each moves what its description says, in the sense that it says."""

    def test_dry_friction_takes_the_same_speed_at_every_level(self):
        _, _, speed = changes(effect("coulomb_friction", torque_nm=0.1))
        assert speed == pytest.approx(-0.1 / 0.0625 * slots.RPM, rel=0.02)

    def test_smoothed_dry_friction_is_the_same_far_above_its_width(self):
        _, _, speed = changes(effect("coulomb_friction", "smoothed", torque_nm=0.1, width_rad_s=1.0))
        assert speed[1:5] == pytest.approx(-0.1 / 0.0625 * slots.RPM, rel=0.02)

    @pytest.mark.parametrize("form", ["gaussian", "exponential", "lorentzian"])
    def test_stribeck_friction_takes_speed_at_the_lowest_level(self, form):
        _, _, speed = changes(effect("stribeck_friction", form, torque_nm=0.2, speed_rad_s=8.0))
        assert speed[0] < -2.0
        assert abs(speed[2]) < 0.3 * abs(speed[0])

    @pytest.mark.parametrize(
        "one",
        [effect("windage", drag_nm_s2=2e-4), effect("windage", "power", torque_at_40_nm=0.32, exponent=2.2),
         effect("inlet_throttling", loss_pa_s2_m6=3e9), effect("exhaust_back_pressure", rise_pa_s2_m6=5e8),
         effect("inlet_throttling", "orifice", area_m2=3e-5), effect("exhaust_back_pressure", "orifice", area_m2=9e-5)],
        ids=lambda one: f"{one.id} {one.form}",
    )  # fmt: skip
    def test_losses_that_grow_with_speed_take_most_at_the_highest_level(self, one):
        _, _, speed = changes(one)
        assert np.all(speed < 0.0)
        assert abs(speed[2]) > 3.0 * abs(speed[0])

    @pytest.mark.parametrize("side", ["inlet_throttling", "exhaust_back_pressure"])
    def test_a_laminar_throttle_takes_pressure_in_proportion_to_flow(self, side):
        key = "loss_pa_s_m3" if side == "inlet_throttling" else "rise_pa_s_m3"
        _, _, speed = changes(effect(side, "laminar", **{key: 3e6}))
        assert np.all(speed < 0.0)
        assert 3.0 * abs(speed[0]) < abs(speed[2]) < 12.0 * abs(speed[0])

    def test_a_seal_s_friction_is_in_proportion_to_gauge_pressure(self):
        _, _, speed = changes(effect("load_friction", "seal", torque_per_pressure_m3=3.5e-6))
        assert speed[2] / speed[0] == pytest.approx(128.7 / 28.7, rel=0.05)

    def test_roller_friction_grows_with_pressure(self):
        _, _, speed = changes(effect("load_friction", roller_factor=0.05))
        assert speed[2] < speed[1] < speed[0] < 0.0

    @pytest.mark.parametrize("form", ["exponential", "hyperbolic", "logistic"])
    def test_warm_up_takes_most_at_the_start(self, form):
        _, _, speed = changes(effect("friction_warm_up", form, share_cold=0.2, time_s=200.0))
        assert speed[0] < speed[5] < 0.5
        assert speed[1] < speed[4]

    def test_a_leak_takes_flow_and_leaves_the_speed(self):
        for one in (
            effect("leakage", conductance_kg_s_pa2=2e-14),
            effect("leakage", "orifice", area_m2=1e-6),
        ):
            _, flow, speed = changes(one)
            assert np.all(flow > 2.0)
            assert speed == pytest.approx(0.0, abs=0.02)

    @pytest.mark.parametrize(
        ("form", "values"), [("factor", {"extra_share": 15.0}), ("wall", {"coefficient_w_m2k": 80.0})]
    )
    def test_wall_heat_moves_the_slow_levels_most(self, form, values):
        _, flow, speed = changes(effect("wall_heat_exchange", form, **values))
        assert speed[0] < -0.5
        assert abs(speed[0]) > abs(speed[2])
        assert np.abs(flow).max() > 0.1

    def test_a_once_per_turn_torque_leaves_the_sweep_and_swings_a_run(self):
        one = effect("once_per_rev_torque", sine_nm=0.1, cosine_nm=0.0)
        _, _, speed = changes(one)
        assert np.abs(speed[1:5]).max() < 0.1
        run = bench.Run(2e5, np.ones(120, bool), 0.0, 0.0)
        plain, swung = (bench.run(bench.Rig({}, {}, those), run).speed[-60:] for those in ((), (one,)))
        assert np.ptp(swung) > np.ptp(plain) + 0.5

    def test_sensor_effects_move_their_channel_alone(self):
        pressure, flow, speed = changes(effect("pressure_gauge_offset", offset_pa=4000.0))
        assert pressure == pytest.approx(0.04)
        assert not np.any([flow, speed])
        pressure, _, _ = changes(effect("pressure_gauge_scale", scale=0.02))
        assert pressure == pytest.approx(0.02 * ROWS.lines / 1e5)
        pressure, flow, speed = changes(effect("flow_offset", offset_m3_s=1e-4))
        assert flow == pytest.approx(6.0)
        assert not np.any([pressure, speed])

    def test_flow_scale_and_density_grow_with_flow_and_pressure(self):
        _, flow, _ = changes(effect("flow_scale", scale=0.1))
        assert flow[2] > 3.0 * flow[0] > 0.0
        _, root, _ = changes(effect("flow_density_correction", share=1.0))
        _, other, _ = changes(effect("flow_density_correction", "exponent", share=1.0, exponent=0.4))
        assert np.all((root > other) & (other > 0.0))

    def test_speed_scale_is_in_proportion(self):
        _, flow, speed = changes(effect("speed_scale", scale=0.05))
        assert speed[2] / speed[0] == pytest.approx(523.0 / 103.0, rel=0.05)
        assert flow == pytest.approx(0.0)

    @pytest.mark.parametrize("form", ["first_order", "delay", "moving_average"])
    def test_a_slow_tachometer_is_late_by_its_time(self, form):
        ramp = np.concatenate([np.zeros(100), np.arange(400.0)])
        found = instruments.lagged([effect("speed_lag", form, time_s=0.02)], ramp, 0.001)
        assert ramp[-1] - found[-1] == pytest.approx(20.0, abs=0.6)

    def test_inertia_stretches_a_spin_up(self):
        run = bench.Run(2e5, np.arange(60) >= 10, 0.0, 0.0)
        plain, heavy = (
            bench.run(bench.Rig({}, {}, those), run).speed for those in ((), (effect("inertia", share=1.0),))
        )
        # Early, while friction is small, twice the inertia is half the acceleration; with 1.5 times it would be 0.67.
        assert 0.5 < heavy[20] / plain[20] < 0.6

    def test_a_misread_reading_is_the_only_one_moved(self):
        found = instruments.misread([effect("bad_reading", speed_row_3=4.0)], "speed", np.full(6, 30.0))
        assert found.tolist() == [30.0, 30.0, 34.0, 30.0, 30.0, 30.0]


class TestUnlisted:
    def test_a_torque_above_a_speed_leaves_the_levels_below_it(self):
        _, _, speed = changes(Concealed("torque_above_a_speed", "clutch", {"torque_nm": 0.2, "speed_rad_s": 25.0}))
        assert speed[[0, 5]] == pytest.approx(0.0, abs=0.01)
        assert np.all(speed[1:5] < -20.0)

    def test_a_torque_in_a_band_leaves_the_levels_outside(self):
        band = {"torque_nm": 0.2, "speed_rad_s": 32.0, "width_rad_s": 3.0}
        _, _, speed = changes(Concealed("torque_in_a_speed_band", "bump", band))
        assert np.all(speed[[1, 4]] < -5.0)
        assert speed[[0, 2]] == pytest.approx(0.0, abs=0.1)

    def test_a_step_at_a_moment_leaves_what_came_before(self):
        _, _, speed = changes(Concealed("torque_from_a_moment_on", "step", {"torque_nm": 0.2, "moment_s": 500.0}))
        assert speed[:3] == pytest.approx(0.0, abs=0.01)
        assert np.all(speed[3:] < -20.0)

    def test_a_slipping_tachometer_reads_low_from_a_moment_on(self):
        one = Concealed("tachometer_slips_from_a_moment_on", "step", {"slip": 0.02, "moment_s": 500.0})
        _, flow, speed = changes(one)
        assert speed[:3] == pytest.approx(0.0)
        assert speed[3] == pytest.approx(-0.02 * 523.0, rel=0.02)
        assert flow == pytest.approx(0.0)

    def test_a_regulator_with_hysteresis_gives_less_on_the_way_up(self):
        pressure, _, speed = changes(Concealed("regulator_hysteresis", "band", {"half_width_pa": 1000.0}))
        assert pressure == pytest.approx(0.0)
        assert np.all(speed[:3] < -3.0)
        assert np.all(speed[3:] > 3.0)

    def test_a_sticking_float_reads_low_on_the_way_up_and_high_on_the_way_down(self):
        rising = np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
        follows = np.array([False, *[True] * 5])
        one = Concealed("flow_float_sticks", "band", {"half_width_m3_s": 0.3})
        found = instruments.read_flow([one], rising, np.full(6, 2e5), 293.15, follows)
        assert found == pytest.approx([0.7, 1.7, 2.7, 2.7, 2.3, 1.3])

    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_a_sawtooth_goes_both_ways(self, sign):
        values = {"height_m3_s": 5e-5, "period_m3_s": 4e-4, "phase": 0.2}
        true = np.linspace(2e-4, 1.6e-3, 50)
        read = instruments.read_flow([Concealed("flow_sawtooth", "sawtooth", values)], true, true, 293.15, true > 0)
        assert (sign * (read - true)).max() > 3e-5


class TestDraws:
    def test_the_shares_are_right_in_every_twenty(self, cases):
        for start in range(0, 200, 20):
            assert Counter(case.category for case in cases[start : start + 20]) == MAKE_UP

    def test_the_shares_are_those_that_were_asked_for(self, cases):
        found = Counter(case.category for case in cases)
        assert found == {"none": 40, "not_in_library": 30, "other_form": 40, "pair": 40, "single": 50}

    def test_half_have_runs_in_time(self, cases):
        assert sum(case.with_transients for case in cases) == 100

    def test_half_of_the_nulls_are_of_misdeclared_noise(self, cases):
        assert sum(case.misdeclared for case in cases if case.category == "none") == 20

    def test_a_draw_is_repeatable_and_depends_on_seed_family_and_index(self):
        assert draw("proof", 7, 11) == draw("proof", 7, 11)
        seeds = {
            draw(*one).seed for one in (("proof", 7, 11), ("proof", 8, 11), ("proof", 7, 12), ("development", 7, 11))
        }
        assert len(seeds) == 4

    def test_json_keeps_a_truth(self, cases):
        for case in cases[:40]:
            assert Truth(**json.loads(json.dumps(asdict(case)))) == case

    def test_effects_that_a_sweep_cannot_show_have_runs_in_time(self, cases):
        shown = [case for case in cases if set(case.ids) & set(concealed.TRANSIENT_ONLY)]
        assert shown
        assert all(case.with_transients for case in shown)

    def test_every_listed_id_is_drawn(self):
        drawn = {name for index in range(600) for name in draw("proof", index, 1).ids}
        assert drawn == {*concealed.LISTED, "unknown"}

    def test_what_is_in_no_library_is_unknown_and_of_at_least_five_kinds(self, cases):
        those = [case for case in cases if case.category == "not_in_library"]
        assert all(case.ids == ["unknown"] for case in those)
        kinds = {case.effects[0]["id"] for case in those}
        assert len(kinds) >= 5
        assert not kinds & set(concealed.LISTED)

    def test_the_other_forms_are_not_the_usual_ones(self, cases):
        those = [case for case in cases if case.category == "other_form"]
        assert all(case.effects[0]["form"] != concealed.USUAL[case.ids[0]] for case in those)
        assert all(not case.sizes for case in those)

    def test_sizes_near_a_nuisance_s_are_flagged(self, cases):
        for case in cases:
            if any(abs(total) <= 4.0 for total in case.total_sds.values()):
                assert case.near_nuisance
            if case.near_nuisance:
                assert case.total_sds
        assert 0 < sum(case.near_nuisance for case in cases) < 40

    def test_nuisances_stay_inside_their_declared_spread(self, cases):
        for case in cases:
            assert 0.055 <= case.f_overall <= 0.072
            assert abs(case.nuisances["lap"] - math.radians(8.0)) <= 2.5 * WIDTHS["declared"]["lap"]
            assert all(abs(case.errors[name]) <= 2.5 * sd for name, sd in ERRORS.items())

    def test_development_keeps_to_the_practice_set_s_spread(self):
        laps = [math.degrees(draw("development", index, 3).nuisances["lap"]) for index in range(200)]
        assert np.std(laps) == pytest.approx(0.5, rel=0.15)

    def test_of_two_effects_each_has_a_place_of_its_own(self, cases):
        pair = next(one for one in cases if one.category == "pair" and "bad_reading" not in one.ids)
        places = [{**sizes.PLACES[one["id"]], "where": None} for one in pair.effects]
        assert pair.place == {"any_of": places}

    def test_the_families_differ_in_what_is_in_no_library_and_in_sizes(self):
        assert set(sizes.UNLISTED["development"]) < set(sizes.UNLISTED["proof"])
        assert all(a != b for ranges in sizes.RANGES.values() for a, b in ranges.values())

    def test_an_unknown_family_is_refused_with_the_names_of_those_there_are(self):
        with pytest.raises(ValueError, match="development and proof"):
            draw("practice", 0, 1)


def case_of(category, transients=True, family="proof", seed=11):
    found = (draw(family, index, seed) for index in itertools.count())
    return next(c for c in found if c.category == category and c.with_transients == transients)


def stepped(case):
    """The case behind an ideal step in pressure, its instruments read every 5 ms."""
    return replace(case, supply={}, instruments={})


def conceal(case, *effects):
    """The case with other effects, as plain data."""
    plain = [{"id": e.id, "form": e.form, "values": dict(e.values)} for e in effects]
    return replace(case, effects=plain, ids=[e.id for e in effects], category="single" if effects else "none")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases") / "one"
    case = case_of("single")
    make_recording(case, folder)
    return case, folder


class TestRecordings:
    def test_it_is_read_as_recording_1_without_a_warning(self, made):
        recording = read_recording(made[1])
        assert [(file.file, file.kind) for file in recording.files] == [
            ("sweep.csv", "steady"), ("spin_up.csv", "transient"), ("coast_down.csv", "transient")
        ]  # fmt: skip
        assert recording.files[0].rows == 26
        assert recording.warnings == ()

    def test_a_sweep_alone_has_one_file(self, tmp_path):
        make_recording(case_of("none", transients=False), tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["recording.toml", "sweep.csv"]

    def test_nothing_in_it_tells_the_truth(self, made):
        case, folder = made
        text = "".join(path.read_text() for path in folder.iterdir()).lower()
        listed, unlisted, forms = concealed.LISTED, sizes.UNLISTED["proof"], [e["form"] for e in case.effects]
        words = [*listed, *unlisted, *forms, case.seed, case.family]
        assert not [word for word in {*words, case.category, "truth", "unknown"} if word in text]

    def test_noise_and_errors_are_declared_the_same_whatever_is_concealed(self, tmp_path):
        kept = []
        for number, case in enumerate([case_of("none", transients=False), case_of("pair"), case_of("not_in_library")]):
            make_recording(stepped(case), tmp_path / str(number))
            channels = read_recording(tmp_path / str(number)).channels
            figures = ("noise_sd", "bias_sd", "scale_sd", "resolution")
            kept.append({name: [getattr(one, key) for key in figures] for name, one in channels.items()})
        assert kept[0] == kept[1] == kept[2]

    def test_it_is_made_the_same_to_the_bit(self, made, tmp_path):
        case, folder = made
        make_recording(Truth(**json.loads(json.dumps(asdict(case)))), tmp_path)
        assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {
            p.name: p.read_bytes() for p in folder.iterdir()
        }

    def test_readings_stand_at_the_instruments_resolution(self, made):
        sweep = read_recording(made[1]).files[0].columns
        assert sweep["flow_l_min"].values % 0.5 == pytest.approx(0.0)
        assert np.round(sweep["speed_rpm"].values, 1).tolist() == sweep["speed_rpm"].values.tolist()

    def test_a_level_at_which_the_motor_stands_is_left_out(self, tmp_path):
        stuck = conceal(case_of("none", transients=False), effect("coulomb_friction", torque_nm=0.6))
        make_recording(stuck, tmp_path)
        sweep = read_recording(tmp_path).files[0]
        assert 18 <= sweep.rows < 26
        assert sweep.columns["speed_rpm"].values.min() > 5.0


def test_channels_of_times_of_their_own_share_a_list_and_one_may_hold_nothing():
    nothing, two, three = (np.zeros(0), np.zeros(0)), (np.array([1.0, 3.0]), np.array([5.0, 6.0])), np.arange(1.0, 4.0)
    times, found = sheets.together({"speed": nothing, "pressure": two, "flow": (three, three)}, ("pressure",))
    np.testing.assert_array_equal(times, three)
    np.testing.assert_array_equal(found["pressure"], [5.0, 5.0, 6.0])
    assert np.isnan(found["speed"]).all()
    _, found = sheets.together({"pressure": two, "flow": (three, three)}, ())
    np.testing.assert_array_equal(found["pressure"], [5.0, np.nan, 6.0])


class TestNoise:
    def test_it_has_the_declared_size(self):
        sensors = {"noise_scale": 1.0, "correlation": 0.0, "tails": 0.0, "drift_bar": 0.0, "jitter_s": 0.0}
        n = 4000
        nothing = bench.Readings(np.zeros(n), np.zeros(n), np.zeros(n))
        found = sheets.noisy(nothing, sensors, 2.0, np.zeros(n), np.random.default_rng(1))
        for channel, sd in sheets.NOISE.items():
            assert np.std(found[channel]) == pytest.approx(2.0 * sd, rel=0.05)

    @pytest.mark.parametrize("kind", [{"correlation": 0.5}, {"tails": 5.0}])
    def test_correlation_and_tails_keep_the_variance(self, kind):
        sensors = {"correlation": 0.0, "tails": 0.0} | kind
        noise = sheets.unit_noise(sensors, 20_000, np.random.default_rng(2))
        assert np.std(noise) == pytest.approx(1.0, rel=0.05)
        kept = float(np.corrcoef(noise[1:], noise[:-1])[0, 1])
        assert kept == pytest.approx(kind.get("correlation", 0.0), abs=0.03)

    def test_misdeclared_noise_is_at_most_a_third_off(self, cases):
        scales = [case.sensors["noise_scale"] for case in cases]
        assert 1.15 < max(scales) <= 1.3
        assert all(case.misdeclared for case in cases if case.sensors["noise_scale"] > 1.0)


@pytest.fixture
def case():
    return conceal(case_of("none", transients=False), effect("leakage", conductance_kg_s_pa2=3e-14))


class TestFollowUps:
    @pytest.mark.parametrize(
        ("words", "file", "kind"),
        [("coast-down from 1.8 bar", "further_coast_down.csv", "transient"),
         ("spin-up to 2.4 bar", "further_spin_up.csv", "transient"),
         ("ten plateaus at 3.1 bar", "plateaus.csv", "steady"),
         ("ten plateaus at 1.80 bar, cold", "plateaus.csv", "steady"),
         ("zero: read the gauge with the line vented", "zero.csv", "zero"),
         ("a reversed sweep", "reversed_sweep.csv", "steady"),
         ("locked rotor: flow at 2 bar with the rotor held", "locked_rotor.csv", "steady")],
    )  # fmt: skip
    def test_the_words_of_a_test_give_its_file(self, case, tmp_path, words, file, kind):
        follow_up(case, {"test": words, "separates": [], "information_nats": 3.0}, tmp_path)
        recording = read_recording(tmp_path)
        assert [(one.file, one.kind) for one in recording.files] == [("sweep.csv", "steady"), (file, kind)]

    def test_the_first_files_stay_to_the_bit(self, case, tmp_path):
        make_recording(case, tmp_path / "a")
        follow_up(case, "coast-down from 2.0 bar", tmp_path / "b")
        assert (tmp_path / "a" / "sweep.csv").read_bytes() == (tmp_path / "b" / "sweep.csv").read_bytes()

    def test_a_leak_flows_on_with_the_rotor_held(self, case, tmp_path):
        follow_up(case, "locked rotor: flow at 2 bar", tmp_path)
        found = read_recording(tmp_path).files[1].columns
        assert found["flow_l_min"].values.mean() > 10.0
        assert set(found["rotor_locked"].values) == {1.0}

    def test_a_zero_shows_the_gauge_s_offset(self, tmp_path):
        shifted = conceal(case_of("none", transients=False), effect("pressure_gauge_offset", offset_pa=5000.0))
        follow_up(shifted, "zero", tmp_path)
        pressure = read_recording(tmp_path).files[1].columns["pressure_bar_abs"].values.mean()
        expected = shifted.nuisances["ambient_pa"] / 1e5 + 0.05
        assert pressure == pytest.approx(expected, abs=0.02)

    def test_a_flywheel_is_declared_and_everything_is_taken_again(self, case, tmp_path):
        follow_up(case, "coast-down from 1.8 bar with a flywheel of three times the inertia", tmp_path)
        recording = read_recording(tmp_path)
        assert recording.added_inertia_kg_m2 == pytest.approx(0.015)
        assert recording.files[1].columns["time_s"].values[-1] > 3.0  # four times the inertia


def thinned(folder):
    """Leave every seventh row of the sweep: what is weighed is the same, in less time."""
    lines = (folder / "sweep.csv").read_text().splitlines()
    (folder / "sweep.csv").write_text("\n".join([lines[0], *lines[2::7]]) + "\n")


class TestSeparable:
    @pytest.mark.long
    def test_a_leak_in_a_sweep_is_large_and_like_a_flow_error(self, case, tmp_path):
        make_recording(case, tmp_path)
        thinned(tmp_path)
        found = separable(case, tmp_path)
        assert found["D"] > 7.0
        # The speed's scale, with an f_overall to match, is the flow's: the two are as like to half a percent.
        assert found["rival"] in ("flow_offset", "flow_scale", "flow_density_correction", "speed_scale")

    @pytest.mark.long
    def test_an_offset_of_the_flow_meter_is_like_a_leak_through_a_hole(self, tmp_path):
        """Its volume at the line's pressure hardly changes; that of a leak through a gap grows with the pressure."""
        shifted = conceal(case_of("none", transients=False), effect("flow_offset", offset_m3_s=1.5e-4))
        make_recording(shifted, tmp_path)
        thinned(tmp_path)
        found = separable(shifted, tmp_path)
        assert found["D"] > 7.0
        assert (found["rival"], found["form"]) == ("leakage", "orifice")

    @pytest.mark.long
    def test_of_two_effects_the_one_in_another_form_may_pass_for_both(self, tmp_path):
        """A leak through a hole for a leak through a gap and an offset of the flow meter; whichever stands first."""
        both = conceal(
            case_of("none", transients=False),
            effect("flow_offset", offset_m3_s=3e-4),
            effect("leakage", conductance_kg_s_pa2=5e-14),
        )
        both = stepped(both)
        make_recording(both, tmp_path)
        thinned(tmp_path)
        found = separable(both, tmp_path)
        assert found["D"] > 7.0
        assert (found["rival"], found["form"], found["separable"]) == ("leakage", "orifice", False)

    @pytest.mark.long
    def test_the_nuisances_take_up_dry_friction_in_a_sweep_alone(self, tmp_path):
        """No rival is tried then: it would not matter."""
        faint = conceal(case_of("none", transients=False), effect("coulomb_friction", torque_nm=0.4))
        make_recording(faint, tmp_path)
        thinned(tmp_path)
        found = separable(faint, tmp_path)
        assert 0.0 < found["D"] < 7.0
        assert (found["rho"], found["rival"], found["separable"]) == (None, None, False)

    def test_a_small_torque_changes_plateaus_as_a_march_says(self):
        """What swings once a turn changes none; what changes the gas is marched."""
        rest = bench.Rig({"f_overall": 0.06})
        near, own = SmallTorques(rest, ROWS), bench.plateaus(rest, ROWS)

        def both_ways(one):
            rig = replace(rest, effects=(one,))
            return [(bench.plateaus(rig, ROWS, way).speed - own.speed) for way in (near, bench.marched)]

        for one in (
            effect("coulomb_friction", torque_nm=0.01),
            effect("windage", drag_nm_s2=1e-5),
            effect("friction_warm_up", share_cold=0.01, time_s=300.0),
            effect("load_friction", "seal", torque_per_pressure_m3=1e-7),
        ):
            quick, whole = both_ways(one)
            assert np.abs(whole).max() > 0.1
            assert quick == pytest.approx(whole, rel=0.03, abs=0.005)
        quick, whole = both_ways(effect("once_per_rev_torque", sine_nm=0.02, cosine_nm=0.0))
        assert not quick.any()
        assert whole == pytest.approx(np.zeros(whole.size), abs=0.01)
        quick, whole = both_ways(effect("exhaust_back_pressure", rise_pa_s2_m6=2e8))
        assert quick.tolist() == whole.tolist()

    @pytest.mark.long
    def test_what_the_nuisances_take_up_is_not_seen_however_bent_their_line(self, tmp_path, monkeypatch):
        """A friction that f_overall takes up wholly: along a straight line what is left of it is the line's bend."""
        monkeypatch.setattr(recordings, "LEVELS_BAR", np.array([1.6, 2.0]))
        case = stepped(case_of("none"))
        make_recording(case, tmp_path)
        rest = case.rig()
        whitened = Whitened(asked_of(read_recording(tmp_path), case), rest)
        thicker = replace(rest, nuisances=rest.nuisances | {"f_overall": 1.5 * rest.nuisances["f_overall"]})
        everything = whitened.readings(thicker)
        change, lines = everything - whitened.readings(rest), whitened.nuisances()
        left, grown = _taken_up(whitened, everything, rest, change, lines, np.empty((change.size, 0)))

        def size(change: np.ndarray, lines: np.ndarray) -> float:
            return float(np.sqrt(change @ np.linalg.solve(np.eye(change.size) + lines @ lines.T, change)))

        assert size(change, lines) > 5.0
        assert size(left, grown) < 0.5

    @pytest.mark.long
    def test_more_roller_friction_is_no_larger_than_the_nuisance_that_it_is(self, tmp_path):
        """A roller factor 8 times its own is 3 declared sds of it, at the end of a long curved valley."""
        case = case_of("none", transients=False)
        own = case.nuisances["roller_factor"]
        laden = conceal(case, effect("load_friction", roller_factor=7.0 * own))
        make_recording(laden, tmp_path)
        thinned(tmp_path)
        assert separable(laden, tmp_path)["D"] < np.log2(8.0) + 0.1

    def test_where_nothing_is_concealed_there_is_nothing_to_part(self, tmp_path):
        assert not separable(case_of("none"), tmp_path)["separable"]


def test_every_effect_that_may_be_named_is_concealed_in_challenges():
    assert {name for name, effect in effects().items() if effect.listed} == set(USUAL)


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield node.module


def test_it_shares_rig_recording_alone_with_the_project_and_how_it_is_compiled():
    shared = ("rig.recording", "configs.compiled")
    ours = ("model", "rig", "calibration", "configs", "console", "spinbench")
    for path in Path(second_rig.__file__).parent.rglob("*.py"):
        for name in imports_of(path):
            if name.split(".")[0] in ours:
                assert name in shared or name.startswith("calibration.challenge.second_rig"), (path.name, name)


def lost(name, form, values, speed, line_gauge=0.0):
    """Torque that an effect takes at a speed [N m], as its form says."""
    p = slots.vector(concealed.figures({"f_overall": 0.0}, [Concealed(name, form, values)]))
    viscous, dry = losses.drag(p, speed, line_gauge)
    return viscous * speed + dry


class TestForms:
    """Each form is its own law, pinned at points where the others differ."""

    @pytest.mark.parametrize(
        ("form", "at_its_speed", "at_twice"),
        [("gaussian", np.exp(-1.0), np.exp(-4.0)), ("exponential", np.exp(-1.0), np.exp(-2.0)),
         ("lorentzian", 0.5, 0.2)],
    )  # fmt: skip
    def test_stribeck_friction_fades_as_its_form_says(self, form, at_its_speed, at_twice):
        values = {"torque_nm": 0.2, "speed_rad_s": 8.0}
        assert lost("stribeck_friction", form, values, 1e-9) == pytest.approx(0.2)
        assert lost("stribeck_friction", form, values, 8.0) == pytest.approx(0.2 * at_its_speed)
        assert lost("stribeck_friction", form, values, 16.0) == pytest.approx(0.2 * at_twice)

    @pytest.mark.parametrize(
        ("form", "values", "ratio"),
        [("square", {"drag_nm_s2": 2e-4}, 4.0), ("power", {"torque_at_40_nm": 0.32, "exponent": 2.5}, 2.0**2.5)],
    )
    def test_windage_is_a_power_of_the_speed(self, form, values, ratio):
        assert lost("windage", form, values, 40.0) == pytest.approx(0.32)
        assert lost("windage", form, values, 40.0) / lost("windage", form, values, 20.0) == pytest.approx(ratio)

    def test_dry_friction_is_sharp_or_built_up(self):
        smoothed = {"torque_nm": 0.1, "width_rad_s": 2.0}
        assert lost("coulomb_friction", "sharp", {"torque_nm": 0.1}, 0.5) == pytest.approx(0.1)
        assert lost("coulomb_friction", "smoothed", smoothed, 2.0) == pytest.approx(0.1 * np.tanh(1.0))

    @pytest.mark.parametrize(
        ("form", "left"),
        [("exponential", np.exp(-1.0)), ("hyperbolic", 0.5), ("logistic", (1.0 + np.exp(-3.0)) / 2.0)],
    )
    def test_a_warm_up_has_so_much_left_after_its_time(self, form, left):
        one = [Concealed("friction_warm_up", form, {"share_cold": 0.2, "time_s": 300.0})]
        base = concealed.figures({"f_overall": 0.06}, one)
        rows, _ = concealed.row_figures(base, one, np.array([0.0, 300.0]), np.ones(2), np.full(2, 2e5))
        assert rows[:, slots.AT["f_overall"]] == pytest.approx([0.06 * 1.2, 0.06 * (1.0 + 0.2 * left)])

    @pytest.mark.parametrize(
        ("form", "after"),
        [("first_order", 1.0 - np.exp(-np.array([0.5, 1.0, 1.5, 2.5]))), ("delay", [0.0, 0.5, 1.0, 1.0]),
         ("moving_average", [0.25, 0.5, 0.75, 1.0])],
    )  # fmt: skip
    def test_a_slow_tachometer_answers_a_step_as_its_form_says(self, form, after):
        """At 0.5, 1, 1.5 and 2.5 times its time."""
        cell_s, time_s = 1e-4, 0.02
        step = (np.arange(1500) >= 500).astype(float)
        found = instruments.lagged([effect("speed_lag", form, time_s=time_s)], step, cell_s)
        at = 500 + np.round(np.array([0.5, 1.0, 1.5, 2.5]) * time_s / cell_s).astype(int)
        within = 0.51 if form == "delay" else 0.01  # the step itself is between two cells
        assert found[at[[0, 2, 3]]] == pytest.approx(np.array(after)[[0, 2, 3]], abs=0.01)
        assert found[at[1]] == pytest.approx(after[1], abs=within)

    def test_the_second_harmonic_goes_twice_a_turn(self):
        values = {"sine_nm": 0.0, "cosine_nm": 0.0, "second_nm": 0.05}
        p = slots.vector(concealed.figures({}, [Concealed("once_per_rev_torque", "two_harmonics", values)]))
        assert losses.swing(p, np.pi / 4.0) == pytest.approx(0.05)
        assert losses.swing(p, 3.0 * np.pi / 4.0) == pytest.approx(-0.05)


class TestWhatReachesARecording:
    """Of one case with the same noise, with something and without."""

    @pytest.fixture(scope="class")
    @classmethod
    def clean(cls):
        quiet = {"noise_scale": 1.0, "correlation": 0.0, "tails": 0.0, "drift_bar": 0.0, "jitter_s": 0.0}
        case = stepped(conceal(case_of("none")))
        return replace(case, sensors=quiet, errors=dict.fromkeys(case.errors, 0.0))

    @pytest.fixture(scope="class")
    @classmethod
    def without(cls, clean, tmp_path_factory):
        folder = tmp_path_factory.mktemp("clean")
        make_recording(clean, folder)
        return read_recording(folder)

    def moved(self, case, without, folder, column, file="sweep.csv"):
        make_recording(case, folder)
        pair = (next(one for one in of.files if one.file == file) for of in (read_recording(folder), without))
        with_it, plain = (one.columns[column].values for one in pair)
        return with_it - plain, plain

    @pytest.mark.parametrize(
        ("error", "column", "moves"),
        [
            ("pressure_offset_bar", "pressure_bar_abs", lambda plain: 0.05),
            ("pressure_scale", "pressure_bar_abs", lambda plain: 0.05 * plain),
            ("flow_offset_l_min", "flow_l_min", lambda plain: 0.05),
            ("flow_scale", "flow_l_min", lambda plain: 0.05 * plain),
            ("speed_offset_rpm", "speed_rpm", lambda plain: 0.05),
            ("speed_scale", "speed_rpm", lambda plain: 0.05 * plain),
        ],
    )
    def test_an_instrument_s_error_is_in_its_column(self, clean, without, tmp_path, error, column, moves):
        size = 20.0 if error.endswith(("l_min", "rpm")) else 1.0
        case = replace(clean, errors={**clean.errors, error: 0.05 * size})
        change, plain = self.moved(case, without, tmp_path, column)
        step = sheets.RESOLUTION[column.partition("_")[0]]
        assert change == pytest.approx(np.broadcast_to(moves(plain) * size, change.shape), abs=1.5 * step)

    def test_the_gauge_drifts_over_the_sweep(self, clean, without, tmp_path):
        case = replace(clean, sensors={**clean.sensors, "drift_bar": 0.04})
        change, _ = self.moved(case, without, tmp_path, "pressure_bar_abs")
        assert change[[0, -1]] == pytest.approx([-0.02, 0.02], abs=0.0015)

    def test_jitter_moves_samples_along_a_spin_up(self, clean, without, tmp_path):
        case = replace(clean, sensors={**clean.sensors, "jitter_s": 2e-4})
        change, _ = self.moved(case, without, tmp_path, "speed_rpm", "spin_up.csv")
        assert np.std(change[12:32]) > 2.0 * np.std(change[-60:]) > 0.0  # most where the speed changes

    def test_a_misread_reading_is_in_its_row_alone(self, clean, without, tmp_path):
        case = conceal(clean, effect("bad_reading", speed_row_3=4.0))
        change, _ = self.moved(case, without, tmp_path, "speed_rpm")
        assert change[2] == pytest.approx(4.0 * slots.RPM, abs=0.06)
        assert not np.any(np.delete(change, 2))

    def test_a_gauge_that_goes_to_and_fro_does(self, clean, without, tmp_path):
        values = {"height_pa": 800.0, "period_pa": 2.5e4, "phase": 0.2}
        case = conceal(clean, Concealed("gauge_sawtooth", "sawtooth", values))
        change, _ = self.moved(case, without, tmp_path, "pressure_bar_abs")
        assert change.min() < -0.004 and change.max() > 0.004
