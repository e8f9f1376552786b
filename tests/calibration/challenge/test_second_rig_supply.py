"""The second rig's supply line, tachometers and gauges: balances, limits, draws, and what a recording says of them."""

import itertools
import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from calibration.challenge.second_rig import (
    Truth,
    bench,
    draw,
    equipment,
    make_recording,
    readout,
    recordings,
    runs_seen,
    sheets,
)
from calibration.challenge.second_rig.concealed import Concealed
from calibration.challenge.second_rig.machine import flows, marches, motor, slots
from calibration.challenge.second_rig.runs_seen import LINE_SDS, MOMENT_SD_S, moved_supply
from calibration.challenge.second_rig.separable import Seen
from calibration.challenge.second_rig.signatures import LINE, Whitened, asked_of
from calibration.challenge.second_rig.supply import line
from calibration.challenge.second_rig.supply.line import Supply
from calibration.diagnosis.mismatch import detect_mismatch, fit_base
from calibration.diagnosis.steps.detect import MISMATCH_P
from calibration.systems.radial_piston import noise
from calibration.systems.radial_piston.predict.kinds import RUN
from rig.recording import read_recording

P = slots.vector()
AMBIENT, GAS = 101_325.0, slots.R_AIR * 293.15
NUISANCES = {"f_overall": 0.0625}
WIDE = Supply.of(0.001, 0.0, 0.001, 2000.0, 2000.0, 0.1)  # nothing but its volume is left of it
SLOW = Supply.of(0.2, 5e-4, 0.05, 40.0, 40.0, 1.0)


def filled(supply, target, opened, seconds, start=AMBIENT, dt=1e-5):
    """A line without a motor: pressures [Pa] after each step, and its state at the end."""
    s = line.at_rest(P)
    s[line.LINE] = start
    s[line.REGULATED] = target if supply.regulator_time_s == 0.0 else AMBIENT
    s[line.OPENED] = float(opened)
    found = np.empty(round(seconds / dt))
    for k in range(found.size):
        line.follow(P, s, supply.figures(), target, opened, 0.0, dt)
        found[k] = s[line.LINE]
    return found, s


class TestLine:
    def test_it_fills_through_a_choked_valve_at_a_constant_rate(self):
        supply = Supply.of(0.0, 0.0, 0.0, 20.0, 20.0, 1.0)
        found, _ = filled(supply, 4e5, True, 0.03)
        choked = flows.NOZZLE * 20e-6 * 4e5 / math.sqrt(GAS)  # kg/s, up to 0.528 of the regulator's pressure
        rises = choked * GAS / 1e-3
        assert found[-1] < flows.CHOKED * 4e5
        assert (found[-1] - found[0]) / (0.03 - 1e-5) == pytest.approx(rises, rel=0.01)

    def test_it_empties_through_a_choked_vent_exponentially(self):
        supply = Supply.of(0.0, 0.0, 0.0, 20.0, 30.0, 2.0)
        found, s = filled(supply, 4e5, False, 0.1, start=4e5)
        time_s = 2e-3 / (flows.NOZZLE * 30e-6 * math.sqrt(GAS))
        assert found[-1] > AMBIENT / flows.CHOKED
        assert found[-1] / 4e5 == pytest.approx(math.exp(-0.1 / time_s), rel=0.005)
        assert s[line.VENTED] == pytest.approx((4e5 - found[-1]) * 2e-3 / GAS, rel=1e-6)

    def test_a_line_that_is_shut_and_not_vented_keeps_its_air(self):
        found, _ = filled(Supply.of(0.0, 0.0, 0.0, 20.0, 0.0, 1.0), 4e5, False, 0.05, start=3e5)
        assert found[-1] == 3e5

    def test_the_regulator_follows_with_its_lag(self):
        found, _ = filled(Supply.of(0.05, 0.0, 0.0, 2000.0, 20.0, 0.01), 2e5, True, 0.15)
        rest = (2e5 - found[[4999, 9999, 14999]]) / (2e5 - AMBIENT)
        assert rest == pytest.approx(np.exp([-1.0, -2.0, -3.0]), abs=0.005)

    def test_the_valve_takes_its_time_from_one_way_to_the_other(self):
        supply = Supply.of(0.01, 0.0, 0.04, 20.0, 20.0, 1.0)
        s = line.at_rest(P)
        share = []
        for k in range(80):
            line.follow(P, s, supply.figures(), 2e5, k < 40, 0.0, 1e-3)
            share.append(s[line.OPENED])
        assert share[19] == pytest.approx(0.5)
        assert share[39] == pytest.approx(1.0)
        assert share[59] == pytest.approx(0.5)
        assert share[79] == pytest.approx(0.0, abs=1e-12)

    @pytest.mark.parametrize("opens", [True, False])
    def test_with_the_motor_no_air_is_lost(self, opens):
        """What the regulator let in, less what motor and vent took, is in the line."""
        s = line.at_rest(P)
        y = motor.rest(P, marches.TABLE, 0.1, AMBIENT, False)
        if not opens:
            s[line.LINE], s[line.REGULATED], s[line.OPENED] = 1.9e5, 1.95e5, 1.0
            y = marches.turning(P, marches.TABLE, 1.9e5, 38.0, 0.1, 0.0, marches.STEP_S)
        before, taken = s[line.LINE], 0.0
        for _ in range(12_000 if opens else 3000):
            taken += line.together(P, marches.TABLE, y, s, SLOW.figures(), 2e5, opens, 0.0, marches.STEP_S)
        held = (s[line.LINE] - before) * SLOW.volume_m3 / GAS
        assert held == pytest.approx(s[line.ENTERED] - taken - s[line.VENTED], abs=1e-12)
        assert min(taken, s[line.ENTERED] + s[line.VENTED]) > 1e-5


class TestBehindASupply:
    def test_the_droop_stands_in_plateaus_as_the_gauge_reads_them(self):
        droop = 1e-3  # bar min/L
        rig = bench.Rig(NUISANCES, supply=Supply.of(0.1, droop, 0.02, 2000.0, 50.0, 1.0))
        asked = bench.Plateaus(np.array([1.4e5, 2.0e5]), np.array([0.0, 200.0]), np.ones(2))
        read = bench.plateaus(rig, replace(asked, lines=bench.delivered(rig, asked)))
        lost = (asked.lines - read.pressure) / 1e5
        assert lost == pytest.approx(droop * read.flow * slots.L_MIN, rel=0.02)

    def test_a_run_settles_where_the_plateau_stands(self):
        rig = bench.Rig(NUISANCES, supply=SLOW)
        opened = np.arange(500) >= 10
        went = bench.history(rig, bench.Run(2e5, opened, 0.0, 0.1))
        stands = bench.delivered(rig, bench.Plateaus(np.array([2e5]), np.zeros(1), np.zeros(1)))[0]
        assert went.pressure[-200:].mean() == pytest.approx(stands, abs=60.0)
        steady = bench.plateaus(rig, bench.Plateaus(np.array([stands]), np.zeros(1), np.zeros(1))).speed[0]
        turned = (went.turned[-1] - went.turned[-401]) / (400 * bench.CELL_S)
        assert turned == pytest.approx(steady, rel=0.003)

    def test_a_coast_down_begins_where_the_line_stands(self):
        went = bench.history(bench.Rig(NUISANCES, supply=SLOW), bench.Run(2e5, np.arange(60) < 40, 0.0, 0.1))
        open_line = went.pressure[: 40 * 10]
        assert np.ptp(open_line) < 300.0  # the pulses of the motor's draught, and no drift
        assert went.pressure[-1] < open_line.mean() - 2e4

    @pytest.mark.parametrize("up", [True, False])
    def test_an_ideal_step_is_the_limit_of_a_small_and_quick_line(self, up):
        """A tenth of the volume and of the times leaves at most a third of the difference."""
        samples = np.arange(100)
        asked = bench.Run(2e5, samples >= 10 if up else samples < 10, 0.0, 0.1)

        def speeds(supply):
            return bench.run(bench.Rig(NUISANCES, supply=supply), asked).speed[:55] * slots.RPM

        ideal = speeds(None)
        near, nearer = (
            np.abs(speeds(Supply.of(k, 0.0, k, 2000.0, 2000.0, 20.0 * k)) - ideal).max() for k in (0.01, 0.001)
        )
        assert near > 5.0
        assert nearer < near / 3.0

    def test_a_slow_line_hides_the_first_of_a_spin_up(self):
        opened = np.arange(100) >= 10
        quick, slow = (
            bench.run(bench.Rig(NUISANCES, supply=one), bench.Run(2e5, opened, 0.0, 0.1)).speed for one in (None, SLOW)
        )
        assert slow[30] < 0.3 * quick[30]

    def test_a_line_that_is_not_vented_drives_the_motor_on(self):
        opened = np.arange(140) < 10
        vented, shut = (
            bench.run(bench.Rig(NUISANCES, supply=replace(SLOW, vent_m2=area)), bench.Run(2e5, opened, 0.0, 0.1))
            for area in (4e-5, 0.0)
        )
        assert shut.speed[70] > 3.0 * abs(vented.speed[70])
        assert shut.pressure[70] > 1.2e5


TELLS = readout.PLAIN
NO_JITTER = 0.0


def steadily(speed, seconds):
    """Angle of a shaft that turns steadily [rad]."""
    return speed * np.arange(round(seconds / bench.CELL_S) + 1) * bench.CELL_S


def turning_motor():
    """Angle of the motor at 2 bar, its pulses and all [rad]."""
    y = marches.turning(P, marches.TABLE, 2e5, 41.5, 0.0, 0.0, marches.STEP_S)
    return marches.run_in_time(P, marches.TABLE, y, 2e5, np.ones(2000, bool), bench.CELL_S, marches.STEP_S)


def read(told, turned, pitch_sd=0.0):
    pitch = pitch_sd * np.random.default_rng(3).standard_normal(max(told.get("teeth", 0), 1))
    return readout.speeds(TELLS | told, turned, pitch, np.random.default_rng(4), NO_JITTER)


class TestReadout:
    def test_a_tooth_counter_s_reading_is_the_mean_since_the_tooth_before(self):
        ends, shown = read({"tachometer": "teeth", "teeth": 20}, steadily(30.0, 1.0))
        assert np.diff(ends) == pytest.approx(2.0 * math.pi / 20 / 30.0, abs=1e-6)
        assert shown == pytest.approx(30.0)

    def test_many_teeth_see_the_pulses_that_one_tooth_or_a_wide_window_does_not(self):
        turned = turning_motor()
        sixty, one, wide = (
            np.ptp(read(told, turned)[1])
            for told in (
                {"tachometer": "teeth", "teeth": 60},
                {"tachometer": "teeth", "teeth": 1},
                {"tachometer": "window", "window_s": 0.2, "period_s": 0.04},
            )
        )
        assert sixty > 5.0 * one
        assert sixty > 5.0 * wide

    def test_teeth_out_of_place_add_a_swing_that_comes_back_each_turn(self):
        told = {"tachometer": "teeth", "teeth": 20}
        _, shown = read(told, steadily(40.0, 2.0), pitch_sd=0.01)
        assert np.std(shown) == pytest.approx(math.sqrt(2.0) * 0.01 * 40.0, rel=0.4)
        assert shown[20:40] == pytest.approx(shown[40:60], abs=1e-6)
        assert 1.0 / np.mean(1.0 / shown[20:40]) == pytest.approx(40.0, rel=1e-6)

    def test_a_counter_shows_0_where_no_tooth_came_for_a_while(self):
        turned = np.concatenate([np.zeros(1000), steadily(30.0, 0.5)])
        told = {"tachometer": "teeth", "teeth": 20, "zero_after_s": 0.15}
        ends, shown = read(told, turned)
        assert ends[shown == 0.0] == pytest.approx([0.15, 0.30, 0.45])
        _, never = read(told | {"zero_after_s": 0.0}, turned)
        assert never.size and np.all(never > 0.0)

    def test_a_window_is_the_mean_over_its_time(self):
        grid = np.arange(2001) * bench.CELL_S
        ends, shown = read({"tachometer": "window", "window_s": 0.1, "period_s": 0.02}, 0.5 * 100.0 * grid**2)
        assert np.diff(ends) == pytest.approx(0.02)
        later = ends > 0.11
        assert shown[later] == pytest.approx(100.0 * (ends[later] - 0.05), rel=1e-3)

    def test_a_lag_makes_a_tachometer_late_by_its_time(self):
        grid = np.arange(2001) * bench.CELL_S
        turned = 0.5 * 100.0 * grid**2
        late = readout.wheel(turned, 0.02)
        speed = np.diff(late)[-1] / bench.CELL_S
        assert speed == pytest.approx(100.0 * (grid[-1] - 0.02), rel=0.005)

    @pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
    def test_a_gauge_is_read_at_its_rate(self, rate):
        told = TELLS | {"gauge_hz": rate, "gauge_phase": 0.3}
        times, shown = readout.pressures(told, np.full(6001, 1.5e5))
        assert times.size == round(3.0 * rate)
        assert np.diff(times) == pytest.approx(1.0 / rate)
        assert shown == pytest.approx(1.5e5)

    def test_between_its_readings_a_gauge_s_cells_are_empty_or_hold_the_last(self):
        apart = {"pressure": (np.array([0.1, 0.3]), np.array([1.0, 2.0])), "speed": (np.array([0.2, 0.4]), np.ones(2))}
        _, empty = sheets.together(apart, ())
        times, held = sheets.together(apart, ("pressure",))
        assert times.tolist() == [0.1, 0.2, 0.3, 0.4]
        assert sheets.cells({"pressure": empty["pressure"]})["pressure_bar_abs"] == ["1.0", "", "2.0", ""]
        assert held["pressure"].tolist() == [1.0, 1.0, 2.0, 2.0]


@pytest.fixture(scope="module")
def drawn():
    return [draw(family, index, 23) for family in ("development", "proof") for index in range(200)]


class TestDraws:
    def test_the_ideal_step_is_a_rare_case(self, drawn):
        ideal = sum(not case.supply for case in drawn)
        assert 8 <= ideal <= 36  # 20 expected of 400; three and a half sds either way

    def test_every_case_has_instruments_of_its_own(self, drawn):
        assert all(set(case.instruments) == set(readout.PLAIN) for case in drawn)
        assert {case.instruments["tachometer"] for case in drawn} == {"teeth", "window", "means"}
        assert {case.instruments["gauge_hz"] for case in drawn} == {1.0, 10.0, 100.0}
        assert {case.instruments["teeth"] for case in drawn} == {0, 1, 20, 60}

    @pytest.mark.parametrize("name", equipment.LINES)
    def test_a_line_s_figures_fill_their_range(self, drawn, name):
        low, high = equipment.LINES[name]
        found = np.array([case.supply[name] for case in drawn if case.supply and case.supply["vent_area_mm2"] > 0.0])
        assert np.all((found >= low) & (found <= high))
        share = np.log(found / low) / math.log(high / low)
        assert np.mean(share) == pytest.approx(0.5, abs=0.06)

    def test_it_is_drawn_apart_from_what_is_concealed(self, drawn):
        """A slow line is no sign of anything."""
        slow = [case.category == "none" for case in drawn if case.supply.get("regulator_time_s", 0.0) > 0.1]
        assert np.mean(slow) == pytest.approx(0.2, abs=0.1)

    def test_what_is_told_of_a_line_is_off_by_what_it_says(self, drawn):
        off = [
            (value - case.supply[key]) / sd
            for case in drawn
            if case.supply
            for key, (value, sd) in case.instruments["supply_told"].items()
            if sd is not None
        ]
        assert np.std(off) == pytest.approx(0.95, abs=0.12)  # a normal number, clipped at two
        assert np.abs(off).max() < 2.1
        told = [key in case.instruments["supply_told"] for case in drawn for key in equipment.IDEAL_SDS]
        assert np.mean(told) == pytest.approx(0.5, abs=0.06)

    def test_a_counter_that_is_not_told_of_shows_no_zero(self, drawn):
        """Its readings are means since the reading before, as a recording that says nothing of it promises."""
        silent = [one.instruments for one in drawn if one.instruments["teeth"] and not one.instruments["told"]]
        assert silent
        assert all(one["zero_after_s"] == 0.0 for one in silent)

    def test_teeth_that_nothing_is_told_of_are_no_worse_than_the_declared_noise(self, drawn):
        silent = [one.instruments for one in drawn if "pitch_error_sd" not in one.instruments["told"]]
        noise = sheets.NOISE["speed"] * sheets.TRANSIENT_NOISE / 400.0
        assert max(math.sqrt(2.0) * one["pitch_error_sd"] for one in silent) < noise
        told = [one.instruments for one in drawn if "pitch_error_sd" in one.instruments["told"]]
        assert max(one["pitch_error_sd"] for one in told) > 2.0 * noise

    def test_a_truth_without_them_is_an_ideal_step(self, drawn):
        plain = asdict(drawn[0])
        del plain["supply"], plain["instruments"]
        old = Truth(**json.loads(json.dumps(plain)))
        assert old.rig().supply is None
        assert old.told() == readout.PLAIN


def cases(wanted, family="proof", seed=29):
    found = (draw(family, index, seed) for index in itertools.count())
    return next(case for case in found if case.with_transients and wanted(case))


# A line that is neither quick nor slow, of which the recording tells a part; many teeth, and a late supply_open.
FIGURES = {
    "regulator_time_s": 0.06,
    "droop_bar_min_l": 4e-4,
    "valve_time_s": 0.08,
    "valve_area_mm2": 28.0,
    "vent_area_mm2": 13.0,
    "line_volume_l": 3.8,
}
INSTRUMENTS = readout.PLAIN | {
    "tachometer": "teeth",
    "teeth": 60,
    "pitch_error_sd": 0.0065,
    "zero_after_s": 0.05,
    "gauge_hz": 10.0,
    "gauge_phase": 0.27,
    "gauge_lag_s": 0.002,
    "supply_off_s": 0.0243,
    "told": ["pulses_per_rev", "pitch_error_sd"],
    "supply_told": {"regulator_time_s": [0.075, None], "line_volume_l": [3.81, 0.775]},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A null's recording behind that line."""
    case = replace(cases(lambda one: one.category == "none"), supply=FIGURES, instruments=INSTRUMENTS)
    folder = tmp_path_factory.mktemp("behind a line")
    make_recording(case, folder)
    return case, read_recording(folder), folder


def in_time(recording, file):
    return next(one for one in recording.files if one.file == file).columns


class TestRecordings:
    def test_it_is_read_without_a_warning(self, made):
        assert made[1].warnings == ()

    def test_it_says_of_line_and_tachometer_what_the_truth_says_that_it_does(self, made):
        case, recording, _ = made
        for key in equipment.IDEAL_SDS:
            value, sd = case.instruments["supply_told"].get(key, (None, None))
            assert (getattr(recording.supply, key), getattr(recording.supply, f"{key}_sd")) == (value, sd)
        speed = recording.channels["speed_rpm"]
        assert speed.pulses_per_rev == case.instruments["teeth"]
        assert speed.pitch_error_sd == case.instruments["pitch_error_sd"]
        assert speed.window_s is None and speed.lag_s is None

    @pytest.mark.parametrize(("file", "up"), [("spin_up.csv", True), ("coast_down.csv", False)])
    def test_supply_open_is_off_by_what_the_truth_says(self, made, file, up):
        case, recording, _ = made
        columns = in_time(recording, file)
        time, is_open = columns["time_s"].values, columns["supply_open"].values
        change = int(np.flatnonzero(np.diff(is_open))[0])
        moment = bench.SAMPLE_S * recordings.before(case, up) + case.instruments["supply_off_s"]
        assert time[change] <= moment + 1e-6 < time[change + 1] + 1e-6
        assert is_open[-1] == float(up)

    @pytest.mark.parametrize(("file", "up"), [("spin_up.csv", True), ("coast_down.csv", False)])
    def test_the_gauge_reads_the_line_that_the_truth_describes(self, made, file, up):
        case, recording, _ = made
        columns = in_time(recording, file)
        read = np.isfinite(columns["pressure_bar_abs"].values)
        time, shown = columns["time_s"].values[read], columns["pressure_bar_abs"].values[read]
        assert np.diff(time) == pytest.approx(1.0 / case.instruments["gauge_hz"], abs=1e-5)
        went = bench.history(case.rig(), bench.Run(2e5, recordings.valve(case, up), 0.0, 0.1))
        line_bar = np.interp(time, np.arange(went.pressure.size) * bench.CELL_S, went.pressure) / 1e5
        assert shown == pytest.approx(line_bar, abs=0.05)  # of the gauge's errors, the setting, a lag of 5 ms

    def test_every_kind_of_instrument_is_read_back(self, tmp_path, monkeypatch):
        monkeypatch.setattr(recordings, "LEVELS_BAR", np.array([2.0]))
        for kind in ("window", "means"):
            case = cases(lambda one, kind=kind: one.category == "none" and one.instruments["tachometer"] == kind)
            make_recording(case, tmp_path / kind)
            columns = in_time(read_recording(tmp_path / kind), "spin_up.csv")
            read = np.isfinite(columns["speed_rpm"].values)
            assert np.diff(columns["time_s"].values[read]) == pytest.approx(case.instruments["period_s"], abs=1e-6)


# Teeth that are far off their places, and a gauge that is written again with every tooth.
WHEEL = readout.PLAIN | {
    "tachometer": "teeth",
    "teeth": 20,
    "pitch_error_sd": 0.01,
    "zero_after_s": 0.15,
    "gauge_hz": 100.0,
    "gauge_phase": 0.6,
    "gauge_held": True,
    "gauge_lag_s": 0.003,
    "supply_off_s": 0.058,
    "told": ["pulses_per_rev", "pitch_error_sd"],
}
# A gauge with one value a second, and no row at all while the rotor stands and the valve is opened.
ONCE_A_SECOND = WHEEL | {
    "pitch_error_sd": 0.0008,
    "zero_after_s": 0.0,
    "gauge_hz": 1.0,
    "gauge_phase": 0.58,
    "supply_off_s": 0.043,
    "told": [],
    "supply_told": {"regulator_time_s": [0.012, None], "valve_time_s": [0.0, 0.0009]},
}
STIFF, LARGE = FIGURES | {"regulator_time_s": 0.81}, FIGURES | {"regulator_time_s": 0.013, "valve_time_s": 0.005}


# Empties through the motor alone, and keeps some air when the rotor has stopped.
SHUT = {
    "regulator_time_s": 0.67,
    "droop_bar_min_l": 3e-4,
    "valve_time_s": 0.02,
    "valve_area_mm2": 40.0,
    "vent_area_mm2": 0.0,
    "line_volume_l": 0.7,
}
ONE_TOOTH = {"tachometer": "teeth", "teeth": 1, "zero_after_s": 3.0, "gauge_hz": 100.0, "told": ["pulses_per_rev"]}


class TestDiagnosed:
    @pytest.mark.long
    @pytest.mark.parametrize(("figures", "instruments"), [(STIFF, WHEEL), (LARGE, ONCE_A_SECOND), (SHUT, ONE_TOOTH)])
    def test_what_line_and_instruments_do_is_no_missing_physics(self, tmp_path, figures, instruments):
        case = replace(cases(lambda one: one.category == "none", seed=30), supply=figures, instruments=instruments)
        make_recording(case, tmp_path / "made")
        found = detect_mismatch(read_recording(tmp_path / "made"), np.random.default_rng(1))
        assert found.detection.p_value > MISMATCH_P


@pytest.fixture(scope="module")
def whitened(made):
    """The recording's runs alone, whitened."""
    case, recording, _ = made
    runs = replace(recording, files=tuple(file for file in recording.files if file.kind == "transient"))
    return Whitened(asked_of(runs, case), bench.without(case.rig(), ()))


class TestSeparability:
    def test_another_line_is_taken_up_by_the_line_s_nuisances(self, whitened):
        z = np.zeros(whitened.steps.size)
        z[LINE : LINE + 2] = 0.3, -0.3  # a third of an sd of volume and regulator
        plain = whitened.readings(whitened.base)
        change = whitened.moved(whitened.base, z) - plain
        steps = np.diag(whitened.steps)[LINE:]
        slopes = [(whitened.moved(whitened.base, step) - plain) / step.sum() for step in steps]
        assert np.linalg.norm(change) > 10.0
        assert Seen(change, np.column_stack(slopes)).D < 1.5

    def test_a_valve_that_moves_later_makes_all_that_follows_later(self, whitened):
        runs = whitened.runs
        later = [
            replace(one, run=replace(one.run, opened=np.concatenate([one.run.opened[:10], one.run.opened[:-10]])))
            for one in runs.asked
        ]
        z = np.zeros(runs.size)
        z[runs.line_sds.size + 2 :: 3] = 10 * bench.SAMPLE_S / MOMENT_SD_S
        moved, soon = runs.readings(whitened.base, z), runs.readings(whitened.base)
        runs.asked, kept = later, runs.asked
        whole = runs.readings(whitened.base)
        runs.asked = kept
        for one, two, three in zip(moved, whole, soon, strict=True):
            assert np.abs(two - three).max() > 20.0
            assert np.median(np.abs(one - two)) < 0.05 * np.median(np.abs(two - three))

    def test_what_a_slow_line_hides_is_not_counted(self, sizes):
        """An inertia and a tachometer's lag are in the first of a spin-up, and a slow line takes that away."""
        quick, slow = sizes(0.01, 0.005, 0.1), sizes(0.3, 0.05, 1.0)
        assert quick["inertia"] > 7.0 and quick["speed_lag"] > 3.0
        assert slow["inertia"] < 0.4 * quick["inertia"]
        assert slow["speed_lag"] < 0.4 * quick["speed_lag"]

    def test_what_hangs_on_the_phase_at_the_start_is_not_counted(self, in_a_spin_up):
        """Behind a slow regulator the motor creeps until it breaks away: when, its phase decides."""
        seen, base = in_a_spin_up(1.0, 0.1, 5.0)
        run = seen.runs.asked[0].run
        early, late = (
            bench.run(base, replace(run, angle=run.angle + turned)).speed for turned in (0.0, 0.5 * slots.PULSE)
        )
        assert np.abs(early - late).max() > 5.0  # rad/s
        z = np.zeros(seen.runs.size)
        z[seen.runs.angles] = 0.5 * slots.PULSE / runs_seen.ANGLE_SD
        counted = seen.runs.readings(base, z)[0] - seen.runs.readings(base)[0]
        allowed = (
            runs_seen.AT_ODDS / runs_seen.noise_sd(seen.asked.noise["speed"], 2.0) * math.sqrt(seen.runs.asked[0].taken)
        )
        assert np.abs(counted).max() < 1.2 * allowed

    @pytest.fixture
    def in_a_spin_up(self, made, tmp_path, monkeypatch):
        """A spin-up alone, whitened, and its base, by figures of the line; a gauge at 100 Hz."""
        monkeypatch.setattr(recordings, "LEVELS_BAR", np.array([2.0]))
        monkeypatch.setattr(runs_seen, "STEP_S", 5e-5)  # coarser, and fine enough

        def of(regulator_s, valve_s, volume_l):
            figures = {"regulator_time_s": regulator_s, "valve_time_s": valve_s, "line_volume_l": volume_l}
            areas = {"droop_bar_min_l": 1e-4, "valve_area_mm2": 100.0, "vent_area_mm2": 100.0}
            told = made[0].instruments | {"gauge_hz": 100.0, "supply_told": {}}
            case = replace(made[0], supply=figures | areas, instruments=told)
            make_recording(case, tmp_path)
            recording = read_recording(tmp_path)
            recording = replace(recording, files=tuple(one for one in recording.files if one.file == "spin_up.csv"))
            base = bench.without(case.rig(), ())
            return Whitened(asked_of(recording, case), base), base

        return of

    @pytest.fixture
    def sizes(self, in_a_spin_up):
        """D of two effects in a spin-up, by figures of the line."""
        effects = (
            Concealed("inertia", "constant", {"share": 0.3}),
            Concealed("speed_lag", "first_order", {"time_s": 0.01}),
        )

        def of(*figures):
            seen, base = in_a_spin_up(*figures)
            plain, nuisances = seen.readings(base), seen.nuisances()
            changes = {one.id: seen.readings(replace(base, effects=(one,))) - plain for one in effects}
            return {name: Seen(change, nuisances).D for name, change in changes.items()}

        return of

    def test_a_line_s_figures_move_by_their_factors(self):
        moved = moved_supply(SLOW, np.log([2.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
        assert next(iter(LINE_SDS)) == "volume_m3"
        assert moved == replace(SLOW, volume_m3=2.0 * SLOW.volume_m3)


# A window that spans five rows, where the rotor was caught; a lag, and a sudden start; a lag, and samples that are
# taken together; a lag as long as the samples, of a rotor that was caught.
@pytest.mark.long
@pytest.mark.parametrize("seed", [850044, 850057, 860012, 860016])
def test_without_noise_the_base_model_follows_the_runs_of_another_simulator(seed, tmp_path, monkeypatch):
    monkeypatch.setattr(noise.Noise, "spread", np.full(5, 1e-4))  # misfits may not pass for noise
    truth = draw("development", seed, "follow-ups")
    nothing = {"category": "none", "ids": [], "effects": [], "sizes": {}, "place": {}, "near_nuisance": False}
    sensors = {**truth.sensors, "noise_scale": 1e-3, "correlation": 0.0, "tails": 0.0}
    make_recording(replace(truth, **nothing, total_sds={}, with_transients=True, sensors=sensors), tmp_path / "run")
    comparison, base = fit_base(read_recording(tmp_path / "run"), lambda _: None)
    in_runs = comparison.kind >= RUN
    assert np.count_nonzero(in_runs) > 25
    assert float(np.sum(base.r[in_runs] ** 2)) < 0.3 * np.count_nonzero(in_runs)
