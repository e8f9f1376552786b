"""The article's results, and the report that sets ours beside them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration.report.model import reproduction
from calibration.report.model.paper_figures import CAPTIONS
from model import layout as at
from model.article.comparison import Comparison, compare
from model.article.reproduction import FRICTIONS, SWEEP_PA, Measured, averaged_speeds, reproduce
from model.motor import read_motor
from rig.recording import files, read_recording

ROOT = Path(__file__).resolve().parents[2]
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def motor():
    return read_motor("ptm3600")


@pytest.fixture(scope="module")
def found(motor):
    columns = read_recording(ROOT / "logs" / "published_sweep").files[0].columns
    return reproduce(
        motor,
        Measured(columns["pressure_bar_abs"].values * 1e5, columns["speed_rpm"].values, columns["flow_l_min"].values),
    )


def ours(found, words: str) -> float:
    (one,) = (one for one in compare(found) if words in one.quantity)
    return one.ours


def test_the_published_averages_come_out_in_the_adiabatic_case(motor):
    adiabatic = motor.with_readings(heat_transfer=False, air="constant")
    assert averaged_speeds(adiabatic, np.array([1.6e5, 2.0e5])) == pytest.approx([229.28, 396.14], rel=1e-3)


def test_the_volume_runs_between_the_reference_figures_four_times_a_turn(found):
    assert found.volume_m3.max() * 1e6 == pytest.approx(7.5239, rel=1e-3)
    assert found.volume_m3.min() * 1e6 == pytest.approx(0.3141, rel=1e-3)
    assert np.argmin(np.abs(found.angle_rad - math.pi / 4)) in np.flatnonzero(found.volume_m3 < 0.3142e-6)


def test_the_spin_up_approaches_the_published_speed(found):
    assert ours(found, "speed at 2.0 bar") == pytest.approx(395.0, abs=2.0)
    assert found.transient.speed_rad_s[-1] * at.RPM == pytest.approx(found.run.speed_rad_s[-1] * at.RPM, rel=0.01)


def test_friction_orders_the_curves_and_0625_is_nearest_to_the_measured_speeds(found):
    assert (np.diff(found.friction_rpm, axis=0) < 0.0).all()
    miss = np.sqrt(np.mean((found.plateau_friction_rpm - found.measured.speed_rpm) ** 2, axis=1))
    assert miss.argmin() == FRICTIONS.index(0.0625)
    assert ours(found, "fits the speeds") == pytest.approx(0.0625, rel=0.01)


def test_the_best_friction_is_a_least_squares_one(motor, found):
    def squares(f: float) -> float:
        return float(np.sum((averaged_speeds(motor, SWEEP_PA, f_overall=f) - found.measured.speed_rpm) ** 2))

    assert squares(found.best_friction) < min(
        squares(0.998 * found.best_friction), squares(1.002 * found.best_friction)
    )


def test_a_larger_cylinder_gains_about_50_rpm_on_average(found):
    assert ours(found, "cylinder diameter") == pytest.approx(50.0, abs=2.5)
    assert (np.diff(found.diameter_rpm, axis=0) > 0.0).all()


def test_the_peak_of_the_outlet_flow_is_a_matter_of_the_step_and_its_floor_is_not(found):
    peaks = [row.outlet_peak * row.time_step_s for row in found.peak_rows]
    assert peaks == pytest.approx([peaks[0]] * len(peaks), rel=0.1)
    floors = [row.outlet_lowest for row in found.peak_rows]
    assert floors == pytest.approx([floors[0]] * len(floors), rel=0.03)
    assert ours(found, "lowest outlet") == pytest.approx(0.5, abs=0.05)


def test_more_steps_come_nearer_to_the_steady_speed(found):
    speeds = [row.mean_speed_rpm for row in found.step_rows]
    assert [row.steps for row in found.step_rows] == [5000, 9000, 10_000]
    assert speeds == sorted(speeds)
    assert speeds[-1] < found.steady_rpm


def test_the_cycle_is_one_lobe_long(found):
    assert 0.0 <= found.cycle.angle_rad[0] < 0.01
    assert math.pi / 2 - 0.01 < found.cycle.angle_rad[-1] < math.pi / 2
    assert (np.diff(found.cycle.angle_rad) > 0.0).all()


def test_a_figure_inside_a_published_range_differs_by_nothing():
    assert Comparison("", "rpm", 3.0, 4.0, 3.4, "").difference == 0.0
    assert Comparison("", "rpm", 3.0, 4.0, 4.5, "").difference == pytest.approx(0.5)
    assert Comparison("", "rpm", 3.0, 4.0, 2.0, "").difference == pytest.approx(-1.0)


def test_without_a_recording_nothing_is_compared_with_one(motor):
    found = reproduce(motor)
    assert not reproduction.tables(found)["plateaus"]
    assert not any("Table 3 best" in one.quantity for one in compare(found))
    assert b"## Table 3" not in reproduction.page(found, "")


def test_every_difference_has_its_reason_in_one_sentence(found):
    for one in compare(found):
        assert one.why.endswith(".")
        assert ". " not in one.why


def test_the_report_has_every_figure_and_both_tables(found):
    written = reproduction.report(found, 8.0)
    assert set(written) == {f"{name}.png" for name in CAPTIONS} | {"reproduce.json", "reproduce.html"}
    assert all(content.startswith(PNG) and len(content) < 150_000 for name, content in written.items() if "png" in name)
    assert json.loads(written["reproduce.json"])["format"] == "reproduction/1"
    for name in CAPTIONS:
        assert f'src="{name}.png"' in written["reproduce.html"].decode()
        assert f"(pictures/{name}.png)" in reproduction.page(found, "pictures").decode()


def test_the_same_figures_are_the_same_bytes(found):
    assert reproduction.report(found, 8.0) == reproduction.report(found, 8.0)


def test_the_committed_tables_are_those_of_this_code(found):
    def numbers(data) -> list[float]:
        if isinstance(data, dict):
            return [number for value in data.values() for number in numbers(value)]
        if isinstance(data, list):
            return [number for value in data for number in numbers(value)]
        return [float(data)] if isinstance(data, int | float) else []

    committed = json.loads((ROOT / "docs" / "figures" / "reproduce.json").read_text(encoding="utf-8"))
    assert numbers(committed) == pytest.approx(numbers(reproduction.tables(found)), rel=1e-3, abs=1e-2)


def test_files_are_whole_or_not_there(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "a").write_bytes(b"old")
    with pytest.raises(OSError):
        files.write_files(tmp_path, {"a": b"new", "b": b"cannot replace a folder"})
    assert not list(tmp_path.glob(".spinbench-*"))
    assert (tmp_path / "a").read_bytes() in (b"old", b"new")
    files.write_file(tmp_path / "made" / "c", b"x")
    assert (tmp_path / "made" / "c").read_bytes() == b"x"
