"""Recordings that are used together: what they are called, what they may not share, and the clock of all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import tests.diagnosis_recordings as recordings
from calibration.data.dates import day_of
from calibration.data.joined import GAP_S, NO_MOMENT, as_given, names_of
from calibration.data.left_out import without
from calibration.fit.sampling import Settings
from calibration.fit.store import of_readings
from calibration.report.fit import page
from calibration.systems.look_up import compared
from model.motor import read_motor
from rig.recording import Ambient, Recording, RecordingError, SupplyFigures
from spinbench.api.fitting import prepared

LASTS_S = 1000.0  # a sweep of `recordings`


@pytest.fixture
def made(tmp_path: Path):
    """A sweep in a folder, with what its [origin] says."""

    def sweep(name: str, seed: int = 3, **origin: str) -> Recording:
        return replace(recordings.sweep(tmp_path / name, seed, {}), origin=origin)

    return sweep


def with_flow_meter(recording: Recording, calibrated: str) -> Recording:
    meter = replace(recording.channels["flow_l_min"], serial="FM-7", calibrated=calibrated)
    return replace(recording, channels={**recording.channels, "flow_l_min": meter})


def test_an_instrument_that_was_calibrated_anew_has_errors_of_its_own_under_another_name(made) -> None:
    days = [with_flow_meter(made(name), year) for name, year in (("K1", "2025"), ("K2", "2026"))]
    names = [one.name for one in compared(days).problem.nuisances]
    assert len(set(names)) == len(names)
    assert {"FM-7: flow_scale", "FM-7 in K2: flow_scale"} <= set(names)


def test_motors_of_two_serial_numbers_are_refused_whichever_recording_is_the_first(made) -> None:
    three = [made("a"), made("b", 4, motor_serial="1"), made("c", 5, motor_serial="2")]
    with pytest.raises(RecordingError, match=r"c: of the motor ptm3600 no\. 2, not of the motor ptm3600 no\. 1"):
        as_given(three)


def test_two_motors_of_one_name_are_refused_with_what_differs(made) -> None:
    first, table = made("a"), read_motor("ptm3600").model_dump()
    same = replace(made("b", 4), motor=table)
    assert len(as_given([first, same])) == 2
    table = read_motor("ptm3600").model_dump()
    table["parameters"]["piston_length"]["value"] = 30.0
    with pytest.raises(RecordingError, match=r"parameters\.piston_length\.value is 30\.0, not 35\.07"):
        as_given([first, replace(same, motor=table)])


def test_a_chain_of_joined_recordings_is_that_of_these_readings_alone(made) -> None:
    a, b = made("a"), made("b", 4)
    never_read = [replace(one, sha256="") for one in (a, b)]
    for two in ([a, b], never_read):
        mark = of_readings(as_given(two)[0])
        assert of_readings(as_given(list(two))[0]) == mark
        others = [[two[0], replace(made("c", 5), sha256=two[1].sha256 and "other")], without(two, ["b/sweep.csv:3"])]
        assert all(of_readings(as_given(other)[0]) != mark for other in others)


def test_lines_of_two_volumes_are_not_one(made) -> None:
    first, second = made("a"), made("b", 4)
    assert len(as_given([first, second])) == 1
    assert len(as_given([first, replace(second, supply=SupplyFigures(line_volume_l=5.0))])) == 2


def test_a_day_is_that_of_an_iso_date_and_another_text_is_of_a_day_of_its_own(made) -> None:
    morning, evening = made("a", date="20260628T080000"), made("b", date="2026-06-28T20:00:00")
    assert day_of(morning) == day_of(evening) == "2026-06-28"
    assert day_of(made("c", date="last Monday")) != day_of(made("d", date="last Monday"))


@pytest.mark.parametrize(
    ("dates", "start", "remark"),
    [
        (("2026-05-28T10:00:00", "2026-05-28T12:00:00"), 7200.0, ""),
        (
            ("2026-05-28T10:00:00", "2026-05-28T10:00:00"),
            LASTS_S + GAP_S,
            "by their dates they do not follow each other",
        ),
        (("2026-05-28", "2026-05-28"), LASTS_S + GAP_S, NO_MOMENT),
        (("2026-05-28T10:00", "2026-05-28T12:00Z"), LASTS_S + GAP_S, NO_MOMENT),
    ],
)
def test_the_clock_of_all_is_that_of_their_dates_or_it_is_said_what_was_taken(made, dates, start, remark) -> None:
    (joined,) = as_given([made("a", date=dates[0]), made("b", 4, date=dates[1])])
    assert [file.start_s for file in joined.files] == [0.0, start]
    said = f"b: its time 0 is taken for {start:.0f} s on the clock of all: {remark}"
    assert [one for one in joined.warnings if "clock of all" in one] == [said] * bool(remark)


@pytest.mark.parametrize("stated", [None, 1.0])
def test_a_room_that_nobody_stated_is_said_to_be_taken_for_one(made, stated: float | None) -> None:
    room = Ambient(pressure_bar_abs=stated)
    (joined,) = as_given([replace(made("a"), ambient=room), replace(made("b", 4), ambient=room)])
    said = "no recording states the room's pressure, which is taken for the same in all of them"
    assert (said in joined.warnings) is (stated is None)


def test_what_was_to_be_said_of_each_is_said_of_all(made) -> None:
    two = [replace(made("a"), warnings=("one",)), replace(made("b", 4), warnings=("two",))]
    (joined,) = as_given(two)
    assert {"a: one", "b: two"} <= set(joined.warnings)


def test_no_two_recordings_have_one_name(made) -> None:
    three = [made("c1/a"), made("c2/a", 4), made("a (1)", 5)]
    assert len(set(names_of(three))) == 3
    assert names_of(three[:2]) == ["a (1)", "a (2)"]


def test_the_folder_that_one_is_in_is_called_by_its_name(made, tmp_path: Path, spinbench_here) -> None:
    made("a"), made("b", 4)
    done = spinbench_here("fit", ".", "../b", "--without", "a/sweep.csv:99", cwd=tmp_path / "a")
    assert done.returncode == 2
    assert "--without a/sweep.csv:99: '99' is no row of it" in done.stderr


def test_a_fit_of_plateaus_says_which_recordings_it_passed_over(made) -> None:
    sweep, other = made("a"), made("b", 4)
    run = replace(other, files=tuple(replace(file, kind="transient") for file in other.files))
    (fitted,), _ = prepared([sweep, run], Settings(seed=1), steady_only=True)
    assert fitted.warnings == (f"{run.folder}: passed over: it has no plateaus",)


def test_the_page_of_a_fit_holds_nothing_fixed_that_each_recording_has_for_itself(made) -> None:
    first, second = made("a"), replace(made("b", 4), ambient=Ambient(pressure_bar_abs=0.99))
    unknowns = compared([first, second]).problem.nuisances
    assert {"a: ambient_pressure", "b: ambient_pressure"} <= {one.name for one in unknowns}
    posterior = SimpleNamespace(estimates=[SimpleNamespace(unknown=one) for one in unknowns])
    held = {row[0] for row in page._held_table(posterior, read_motor("ptm3600")).rows}
    assert "piston_length" in held
    assert held.isdisjoint({"ambient_pressure", "ambient_temperature", "inlet_temperature"})


def test_the_page_of_a_fit_has_the_instruments_of_each_recording(made) -> None:
    first, second = made("a"), made("b", 4)
    louder = replace(second.channels["flow_l_min"], noise_sd=0.9)
    grid = page._instrument_table([first, replace(second, channels={**second.channels, "flow_l_min": louder})])
    assert grid.header[0] == "recording"
    assert [row[3] for row in grid.rows if row[1] == "flow_l_min"] == ["0.8", "0.9"]
