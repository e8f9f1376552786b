"""What a fit uses of a recording, what it leaves aside and says so, and what fit and diagnosis refuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calibration.data import measurement
from calibration.data.left_out import without
from calibration.data.measurement import ABOVE, BELOW, MISSING, OBSERVED, Measurement
from calibration.data.refusals import refuse_unusable
from calibration.diagnosis import diagnose
from calibration.fit import fit
from calibration.unknowns.priors import column_of
from model.motor import Motor, read_motor
from model.solvers import steady
from rig.recording import RecordingError, read_recording

ALL = ("pressure", "flow", "speed")
HEADER = "pressure_bar_abs,flow_l_min,speed_rpm\n"


@pytest.fixture
def gathered(put_recording) -> Callable[..., Measurement]:
    def gather(*files: tuple[str, str, str], channels: tuple[str, ...] = ALL, **more: str) -> Measurement:
        return measurement.gather(read_recording(put_recording(*files, **more)), channels)

    return gather


# Rows


def test_each_row_says_where_it_came_from(gathered):
    first, second = f"{HEADER}1.6,44,232\n1.8,54,313\n", f"{HEADER}2.0,70,394\n"
    rows = gathered(("up.csv", "steady", first), ("down.csv", "steady", second)).steady
    assert rows.file == ("up.csv", "up.csv", "down.csv")
    assert rows.row.tolist() == [1, 2, 1]
    assert rows.pressure.tolist() == [1.6, 1.8, 2.0]
    assert len(rows) == 3


def test_a_row_that_cannot_be_used_is_skipped_and_named(gathered):
    sweep = f"{HEADER}1.6,44,232\n,54,313\n2.0,,\n2.1,,435\n"
    measured = gathered(("sweep.csv", "steady", sweep))
    assert measured.steady.row.tolist() == [1, 4]
    assert any("sweep.csv: rows 2, 3 not used" in note for note in measured.notes)


def test_a_row_that_the_user_leaves_out_is_not_said_to_lack_readings(put_recording):
    sweep = f"{HEADER}1.6,44,232\n1.8,54,313\n2.0,,\n"
    (recording,) = without([read_recording(put_recording(("sweep.csv", "steady", sweep)))], ["sweep.csv:2"])
    left_out, unread = measurement.gather(recording).notes[-2:]
    assert left_out == "sweep.csv:2: left out, as asked"
    assert unread.startswith("sweep.csv: row 3 not used")


def test_a_row_with_the_rotor_locked_is_left_aside_and_named(gathered):
    sweep = "pressure_bar_abs,flow_l_min,speed_rpm,rotor_locked\n1.6,44,232,0\n1.8,9,0,1\n2.0,70,394,\n"
    measured = gathered(("sweep.csv", "steady", sweep))
    assert measured.steady.row.tolist() == [1, 3]
    assert any("sweep.csv: row 2 not used by a fit (the rotor is locked)" in note for note in measured.notes)


def test_a_censored_pressure_places_no_row(gathered):
    measured = gathered(("sweep.csv", "steady", f"{HEADER}1.6,44,232\n>2.5,110,600\n"))
    assert measured.steady.row.tolist() == [1]
    assert any("row 2 not used" in note for note in measured.notes)


def test_each_reading_has_its_state(gathered):
    rows = gathered(("sweep.csv", "steady", f"{HEADER}1.1,<10,0\n2.4,>100,\n2.0,70,394\n")).steady
    assert rows.flow_state.tolist() == [BELOW, ABOVE, OBSERVED]
    assert rows.speed_state.tolist() == [BELOW, MISSING, OBSERVED]
    assert rows.flow.tolist() == [10.0, 100.0, 70.0]


def test_a_files_noise_scale_belongs_to_its_rows(put_recording):
    folder = put_recording(("sweep.csv", "steady", f"{HEADER}1.6,44,232\n"), ("b.csv", "steady", f"{HEADER}2,70,394\n"))
    with (folder / "recording.toml").open("a") as stream:
        stream.write("noise_scale = 2.5\n")
    assert measurement.gather(read_recording(folder)).steady.noise_scale.tolist() == [1.0, 2.5]


def test_a_transient_is_no_plateau(gathered):
    run = "time_s,pressure_bar_abs,speed_rpm\n0,2.0,0\n0.1,2.0,200\n"
    measured = gathered(("sweep.csv", "steady", f"{HEADER}2,70,394\n"), ("spin_up.csv", "transient", run))
    assert set(measured.steady.file) == {"sweep.csv"}


def test_zero_rows_stand_apart_from_the_plateaus(gathered):
    zero = "pressure_bar_abs,flow_l_min\n1.015,\n,0.5\n"
    measured = gathered(("sweep.csv", "steady", f"{HEADER}2,70,394\n"), ("zero.csv", "zero", zero))
    assert len(measured.steady) == 1
    assert measured.zero.pressure_state.tolist() == [OBSERVED, MISSING]
    assert measured.zero.flow_state.tolist() == [MISSING, OBSERVED]


def test_a_channel_left_out_is_seen_nowhere(gathered):
    measured = gathered(("sweep.csv", "steady", f"{HEADER}2,70,394\n1.8,54,\n"), channels=("pressure", "speed"))
    assert measured.channels == ("pressure", "speed")
    assert measured.steady.row.tolist() == [1]
    assert measured.steady.flow_state.tolist() == [MISSING]


def test_the_notes_carry_the_recordings_warnings(gathered):
    measured = gathered(("sweep.csv", "steady", f"{HEADER}2,70,394\n"), ambient="")
    assert any("[ambient]" in note for note in measured.notes)


def test_a_recording_without_a_plateau_is_refused(put_recording):
    recording = read_recording(put_recording(("zero.csv", "zero", "pressure_bar_abs\n1.01\n")))
    with pytest.raises(RecordingError, match="no steady row with a pressure and a speed or flow"):
        measurement.gather(recording)


# What the model says of the pressures


def check(folder) -> None:
    refuse_unusable(read_recording(folder))


def speeds(pressures_bar_abs: list[float], motor: Motor | None = None) -> np.ndarray:
    """What the motor does at these pressures [rpm]."""
    return steady.steady(motor or read_motor("ptm3600"), np.array(pressures_bar_abs) * 1e5).speed_rad_s[0] * 30 / np.pi


def sweep_of(shown: list[float], true: list[float], column: str, motor: Motor | None = None) -> str:
    rows = (f"{p:.3f},{n:.1f}\n" for p, n in zip(shown, speeds(true, motor), strict=True))
    return f"pressure_bar_{column},speed_rpm\n{''.join(rows)}"


ABSOLUTE = [1.3, 1.6, 1.9, 2.2]
GAUGE = [p - 1.01325 for p in ABSOLUTE]


@pytest.mark.parametrize(("shown", "column"), [(ABSOLUTE, "abs"), (GAUGE, "gauge")])
def test_pressures_as_declared_are_accepted(put_recording, shown, column):
    check(put_recording(("sweep.csv", "steady", sweep_of(shown, ABSOLUTE, column))))


def test_gauge_pressures_get_the_ambient(put_recording):
    """At 0.3 bar gauge the rotor turns, and 0.3 bar absolute would be out of range."""
    folder = put_recording(("sweep.csv", "steady", sweep_of(GAUGE, ABSOLUTE, "gauge")))
    rows = measurement.gather(read_recording(folder)).steady
    assert rows.is_gauge.all()
    np.testing.assert_allclose(rows.pressure, GAUGE, atol=5e-4)
    check(folder)


def test_gauge_pressure_declared_absolute_is_refused_where_it_is_below_the_ambient(put_recording):
    folder = put_recording(("sweep.csv", "steady", sweep_of(GAUGE, ABSOLUTE, "abs")))
    with pytest.raises(RecordingError, match=r"row 1, .* '0\.287' is not above the room's 1\.013 bar"):
        check(folder)


@pytest.mark.parametrize("lowest", [1.1, 1.3])
def test_gauge_pressure_declared_absolute_is_refused_where_only_the_speeds_betray_it(put_recording, lowest):
    shown = np.linspace(lowest, 1.9, 5)
    folder = put_recording(("sweep.csv", "steady", sweep_of(shown, shown + 1.01325, "abs")))
    with pytest.raises(RecordingError, match="do not go with pressure_bar_abs") as caught:
        check(folder)
    assert "name the column pressure_bar_gauge" in str(caught.value)


def test_absolute_pressure_declared_gauge_is_refused(put_recording):
    folder = put_recording(("sweep.csv", "steady", sweep_of(ABSOLUTE, ABSOLUTE, "gauge")))
    with pytest.raises(RecordingError, match="do not go with pressure_bar_gauge") as caught:
        check(folder)
    assert "name the column pressure_bar_abs" in str(caught.value)


GAUGE_RUN = "time_s,pressure_bar_gauge,speed_rpm\n1,0.98675,397\n2,0.98675,397\n3,0.98675,397\n"
ABS_SWEEP = ("sweep.csv", "steady", f"{HEADER}2.0,70,394\n")


@pytest.mark.parametrize(
    "files",
    [
        [ABS_SWEEP, ("run.csv", "transient", GAUGE_RUN)],
        [("run.csv", "steady", "pressure_bar_gauge,speed_rpm\n0.98675,397\n"), ABS_SWEEP],
        [
            ("run.csv", "steady", "pressure_bar_gauge,speed_rpm\n0.98675,397\n"),
            ("sweep.csv", "zero", "pressure_bar_abs\n1.02\n"),
        ],
    ],
)
def test_gauge_and_absolute_pressures_in_one_recording_are_refused(put_recording, files):
    recording = read_recording(put_recording(*files))
    with pytest.raises(RecordingError) as caught:
        refuse_unusable(recording)
    assert "run.csv has pressure_bar_gauge, and sweep.csv has pressure_bar_abs" in str(caught.value)
    assert "name both" in str(caught.value)
    (left,) = without([recording], ["sweep.csv"])
    refuse_unusable(left)
    assert column_of(left, "pressure") == "pressure_bar_gauge"


def test_a_zero_in_gauge_pressure_may_be_beside_absolute_ones(put_recording):
    zero = ("zero.csv", "zero", "pressure_bar_gauge\n0.006\n")
    refuse_unusable(read_recording(put_recording(ABS_SWEEP, zero)))


@pytest.mark.parametrize("f_overall", [0.04, 0.0625, 0.1, 0.2])
@pytest.mark.parametrize("pressures", [ABSOLUTE, [2.0]])
def test_a_motor_with_more_or_less_friction_is_not_taken_for_the_wrong_gauge(put_recording, f_overall, pressures):
    motor = read_motor("ptm3600").with_values({"f_overall": f_overall})
    check(put_recording(("sweep.csv", "steady", sweep_of(pressures, pressures, "abs", motor))))


@pytest.mark.parametrize(("row", "word"), [("9.5,,2000\n", "9.5 bar absolute is outside"), ("0.4,<10,0\n", "0.4 bar")])
def test_a_pressure_beyond_the_air_properties_is_named(put_recording, row, word):
    folder = put_recording(("sweep.csv", "steady", f"{HEADER}2.0,70,394\n{row}"))
    with pytest.raises(RecordingError, match=f"sweep.csv: row 2: {word}") as caught:
        refuse_unusable(read_recording(folder))
    assert "0.5..8 bar" in str(caught.value)


def test_a_rotor_at_rest_below_the_ambient_is_no_mistake(put_recording):
    check(put_recording(("sweep.csv", "steady", f"{HEADER}1.0,<10,0\n2.0,70,394\n")))


def test_a_speed_that_is_no_more_than_noise_is_that_of_a_rotor_at_rest(put_recording):
    rows = measurement.gather(
        read_recording(put_recording(("sweep.csv", "steady", f"{HEADER}1.2,<10,0.1\n2.0,70,394\n")))
    ).steady
    assert list(rows.speed) == [0.0, 394.0]


@pytest.mark.parametrize(
    "rows",
    {
        "rest": "1.2,<10,0\n1.3,<10,0\n",
        "starved": "0.9,70,394\n0.95,90,500\n",
        "gauge": "1.1,82,441\n1.9,145,778\n",
        "out_of_range": "2.0,70,394\n9.5,,2000\n",
        "units": "2.0,70,41.3\n2.1,76,44.7\n2.2,82,48.2\n",
    }.values(),
)
def test_fit_and_diagnosis_refuse_the_same_in_the_same_words(put_recording, rows):
    recording = read_recording(put_recording(("sweep.csv", "steady", f"{HEADER}{rows}")))
    said = []
    for take in (fit.prepare, diagnose):
        with pytest.raises(RecordingError) as caught:
            take(recording)
        said.append(str(caught.value))
    assert said[0] == said[1]
