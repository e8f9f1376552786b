"""recording/1: what a recording may say, what it is read as, and what is refused with which words."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rig.recording import (
    Ambient,
    Channel,
    Column,
    Recording,
    RecordingError,
    RecordingFile,
    SupplyFigures,
    read_recording,
    write_recording,
)
from rig.recording.columns import FIGURES, MEASURED, NAMES, NUMERIC, other_spelling
from tests import declared

ROOT = Path(__file__).resolve().parents[2]
PRACTICE = ROOT.parent / "shared" / "practice"

TOML = f"""\
format = "recording/1"
motor = "ptm3600"
{declared.channels()}[[files]]
file = "sweep.csv"
kind = "steady"
"""
HEADER = "pressure_bar_abs,flow_l_min,speed_rpm\n"
SWEEP = HEADER + "1.6,44.0,232.3\n1.8,54.0,313.8\n2.0,70.0,394.8\n"
TRANSIENT = TOML.replace('"steady"', '"transient"')
TIMED = "time_s,pressure_bar_abs,speed_rpm\n"
RIG = 'format = "recording/1"\n[[files]]\nfile = "sweep.csv"\nkind = "{kind}"\n[motor]\n{motor}\n'


def put(folder: Path, toml: str = TOML, sweep: str | bytes = SWEEP) -> Path:
    """A recording on disk."""
    folder.mkdir(exist_ok=True)
    (folder / "recording.toml").write_bytes(toml.encode())
    (folder / "sweep.csv").write_bytes(sweep if isinstance(sweep, bytes) else sweep.encode())
    return folder


def bytes_under(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, to show that nothing was written."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refusal(folder: Path) -> str:
    """The error's text; reading must leave the disk as it was."""
    before = bytes_under(folder.parent)
    with pytest.raises(RecordingError) as caught:
        read_recording(folder)
    assert bytes_under(folder.parent) == before
    return str(caught.value)


def sweep_of(folder: Path, sweep: str | bytes, toml: str = TOML) -> RecordingFile:
    return read_recording(put(folder, toml, sweep)).files[0]


# What is read


def test_a_sweep_is_read_column_by_column(tmp_path):
    file = sweep_of(tmp_path, SWEEP)
    assert (file.file, file.kind, file.start_s, file.noise_scale, file.rows) == ("sweep.csv", "steady", 0.0, 1.0, 3)
    assert list(file.columns) == ["pressure_bar_abs", "flow_l_min", "speed_rpm"]
    np.testing.assert_array_equal(file.columns["flow_l_min"].values, [44.0, 54.0, 70.0])
    assert file.columns["flow_l_min"].values.dtype == np.float64
    assert file.columns["flow_l_min"].censor.dtype == np.int8
    assert file.direction is None


def test_the_folder_and_its_toml_name_the_same_recording(tmp_path):
    put(tmp_path)
    assert read_recording(tmp_path).sha256 == read_recording(tmp_path / "recording.toml").sha256


def test_arrays_are_read_only(tmp_path):
    column = sweep_of(tmp_path, SWEEP).columns["speed_rpm"]
    with pytest.raises(ValueError, match="read-only"):
        column.values[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        column.censor[0] = 1


def test_an_empty_cell_was_not_sampled(tmp_path):
    flow = sweep_of(tmp_path, HEADER + "1.6,,232.3\n1.8, ,313.8\n").columns["flow_l_min"]
    assert np.isnan(flow.values).all()
    assert not flow.censor.any()


def test_a_plateau_without_a_reading_is_named(tmp_path):
    warnings = read_recording(put(tmp_path, sweep=HEADER + "1.6,,232\n1.8,54,313\n2.0,,397\n")).warnings
    assert "sweep.csv: flow_l_min has no reading in 2 of 3 rows (1, 3)" in warnings
    assert not any("speed_rpm has" in one for one in warnings)


def test_readings_off_scale_are_censored(tmp_path):
    flow = sweep_of(tmp_path, HEADER + "1.6,<10,232.3\n1.8,> 1e2,313.8\n2.0, 70 ,394.8\n").columns["flow_l_min"]
    np.testing.assert_array_equal(flow.values, [10.0, 100.0, 70.0])
    np.testing.assert_array_equal(flow.censor, [-1, 1, 0])


def test_speed_zero_is_censored_at_zero(tmp_path):
    speed = sweep_of(tmp_path, HEADER + "1.1,0.0,0\n1.1,0.0,-0.0\n2.0,70,394.8\n").columns["speed_rpm"]
    np.testing.assert_array_equal(speed.values, [0.0, 0.0, 394.8])
    assert not np.signbit(speed.values).any()
    np.testing.assert_array_equal(speed.censor, [-1, -1, 0])


def test_a_flow_slightly_below_zero_is_noise(tmp_path):
    flow = sweep_of(tmp_path, HEADER + "1.1,-4.9,0\n").columns["flow_l_min"]
    assert flow.values[0] == -4.9


def test_a_noisier_file_allows_a_flow_further_below_zero(tmp_path):
    noisy = sweep_of(tmp_path, HEADER + "1.1,-7.9,0\n", TOML + "noise_scale = 2.0\n")
    assert noisy.columns["flow_l_min"].values[0] == -7.9


def test_direction_is_text(tmp_path):
    file = sweep_of(tmp_path, "direction,pressure_bar_abs,speed_rpm\nup,1.6,232\ndown,1.8,313\n,2.0,394\n", SHORT)
    assert file.direction is not None
    assert file.direction.tolist() == ["up", "down", ""]
    assert "direction" not in file.columns


SHORT = TOML.split("[channels.pressure_bar_abs]")[0] + "[[files]]" + TOML.split("[[files]]")[1]


def test_figures_left_out_take_the_documented_default_and_are_named(tmp_path):
    recording = read_recording(put(tmp_path, TOML.replace("noise_sd = 0.4\n", "").replace("resolution = 0.1\n", "")))
    speed = recording.channels["speed_rpm"]
    assert (speed.noise_sd, speed.bias_sd, speed.resolution) == (0.5, 0.1, 0.1)
    assert speed.defaulted == ("noise_sd", "resolution")
    assert any("speed_rpm" in text and "noise_sd (taken: 0.5)" in text for text in recording.warnings)
    assert not any("flow_l_min" in text for text in recording.warnings)


def test_a_column_without_an_instrument_takes_all_its_defaults(tmp_path):
    channels = read_recording(put(tmp_path, SHORT)).channels
    assert list(channels) == ["pressure_bar_abs", "flow_l_min", "speed_rpm"]
    assert channels["flow_l_min"] == Channel("flow_l_min", 1.0, 1.0, 0.03, 1.0, FIGURES)


def test_an_ambient_not_recorded_is_none(tmp_path):
    recording = read_recording(put(tmp_path))
    assert recording.ambient == Ambient()
    assert any("[ambient]" in text for text in recording.warnings)


def test_ambient_flywheel_and_clock_are_read(tmp_path):
    more = "start_s = 1100\nnoise_scale = 2.0\n[rig]\nadded_inertia_kg_m2 = 0.01\n"
    ambient = "[ambient]\npressure_bar_abs = 1.0\npressure_sd_bar = 0.001\ntemperature_c = 20.0\ntemperature_sd_k = 1\n"
    recording = read_recording(put(tmp_path, TOML + more + ambient + "relative_humidity = 0.4\n"))
    assert recording.ambient == Ambient(1.0, 0.001, 20.0, 1.0, 0.4)
    assert recording.added_inertia_kg_m2 == 0.01
    assert (recording.files[0].start_s, recording.files[0].noise_scale) == (1100.0, 2.0)


TACHOMETER = "pulses_per_rev = 60\npitch_error_sd = 0.01\nwindow_s = 0.5\nlag_s = 0.1\n"
SUPPLY = """\
[supply]
regulator_time_s = 0.3
regulator_time_s_sd = 0.1
line_volume_l = 0.4
valve_time_s = 0
"""


def test_the_supply_is_read_with_what_it_leaves_out(tmp_path):
    assert read_recording(put(tmp_path)).supply == SupplyFigures()
    supply = read_recording(put(tmp_path, TOML + SUPPLY)).supply
    assert supply == SupplyFigures(regulator_time_s=0.3, regulator_time_s_sd=0.1, line_volume_l=0.4, valve_time_s=0.0)


def test_how_a_speed_is_made_is_read(tmp_path):
    plain = read_recording(put(tmp_path)).channels["speed_rpm"]
    assert (plain.pulses_per_rev, plain.pitch_error_sd, plain.window_s, plain.lag_s) == (None, None, None, None)
    stated = read_recording(put(tmp_path, TOML.replace("noise_sd = 0.4\n", "noise_sd = 0.4\n" + TACHOMETER)))
    speed = stated.channels["speed_rpm"]
    assert (speed.pulses_per_rev, speed.pitch_error_sd, speed.window_s, speed.lag_s) == (60, 0.01, 0.5, 0.1)
    assert speed.defaulted == ()


def test_where_a_recording_comes_from_is_read(tmp_path):
    assert read_recording(put(tmp_path)).origin == {}
    toml = TOML.replace("noise_sd = 0.5", 'serial = "F-17"\ncalibrated = "2026-03-01"\nnoise_sd = 0.5')
    found = read_recording(put(tmp_path, toml + '[origin]\ndate = "2026-04-01"\noil = "none"\n'))
    assert found.origin == {"date": "2026-04-01", "oil": "none"}
    assert (found.channels["flow_l_min"].serial, found.channels["flow_l_min"].calibrated) == ("F-17", "2026-03-01")


def test_unknown_columns_are_kept_as_text_and_named(tmp_path):
    sweep = HEADER.strip() + ",note,speed_rpn\n1.6,44,232.3,=1+1,5\n"
    recording = read_recording(put(tmp_path, sweep=sweep))
    assert recording.files[0].extra["note"].tolist() == ["=1+1"]
    assert "note" not in recording.files[0].columns
    assert any("'note'" in text and "did you mean 'speed_rpm'" in text for text in recording.warnings)


def test_a_heading_that_may_be_another_thing_is_an_unknown_column(tmp_path):
    more = "n_samples,speed_set,timestamp,T_oil [°C],valve in %"
    file = sweep_of(tmp_path, f"pressure_bar_abs,flow_l_min,{more}\n1.6,44,3,5,2026-05-01,40,7\n", SHORT)
    assert list(file.extra) == more.split(",")


def test_another_unit_beside_the_known_column_is_only_an_unknown_column(tmp_path):
    file = sweep_of(tmp_path, HEADER.strip() + ",speed_rad_s\n1.6,44,232.3,24.3\n")
    assert list(file.extra) == ["speed_rad_s"]


@pytest.mark.parametrize("spoil", [lambda text: "\ufeff" + text, lambda text: text.replace("\n", "\r\n")])
def test_byte_order_mark_and_crlf_do_no_harm(tmp_path, spoil: Callable[[str], str]):
    file = sweep_of(tmp_path, spoil(SWEEP))
    np.testing.assert_array_equal(file.columns["speed_rpm"].values, [232.3, 313.8, 394.8])


@pytest.mark.parametrize("end", ["", "\n\n\n", "\r\n \n"[:2]])
def test_blank_lines_at_the_end_and_a_missing_last_newline_do_no_harm(tmp_path, end):
    assert sweep_of(tmp_path, SWEEP.rstrip("\n") + end).rows == 3


def test_quoted_cells_and_spaced_headers_are_read(tmp_path):
    file = sweep_of(tmp_path, 'pressure_bar_abs, flow_l_min, "speed_rpm"\n1.6, "44", 232.3\n'.replace(', "', ',"'))
    assert file.columns["flow_l_min"].values[0] == 44.0


def test_steady_rows_may_come_in_any_order_of_time(tmp_path):
    assert sweep_of(tmp_path, TIMED + "5,1.6,200\n1,1.8,300\n,2.0,390\n,2.0,390\n", SHORT).rows == 4


def test_a_file_in_a_folder_below_is_read(tmp_path):
    put(tmp_path, TOML.replace('"sweep.csv"', '"day_1/sweep.csv"'))
    (tmp_path / "day_1").mkdir()
    (tmp_path / "sweep.csv").rename(tmp_path / "day_1" / "sweep.csv")
    assert read_recording(tmp_path).files[0].file == "day_1/sweep.csv"


def test_a_zero_file_needs_one_instrument_only(tmp_path):
    toml = SHORT.replace("steady", "zero")
    assert sweep_of(tmp_path, "pressure_bar_abs\n1.01\n1.02\n", toml).kind == "zero"


def test_the_digest_tells_of_any_change(tmp_path):
    first = read_recording(put(tmp_path)).sha256
    assert re.fullmatch("[0-9a-f]{64}", first)
    assert read_recording(put(tmp_path, TOML + "# a word\n")).sha256 != first
    assert read_recording(put(tmp_path, sweep=SWEEP.replace("44.0", "44.1"))).sha256 != first
    assert read_recording(put(tmp_path)).sha256 == first


@pytest.mark.parametrize(
    ("kind", "motor", "sweep"),
    [
        ("transient", 'kind = "free_rotor"\ninertia_kg_m2 = 0.01', "time_s,speed_rpm\n0,100\n1,90\n"),
        ("transient", 'kind = "driven_axis"\nmass_kg = 9.0', "time_s,force_n,velocity_m_s\n0,1,-0.1\n1,2,0.1\n"),
        ("steady", 'kind = "driven_axis"\ninertia_kg_m2 = 1e-3', "torque_nm,speed_rpm\n0.2,100\n"),
        (
            "steady",
            'kind = "displacement_machine"\ndisplacement_m3_per_rev = 1e-5\nviscous_friction = 0.1\n'
            "viscous_friction_sd = 0.05",
            "pressure_bar_gauge,torque_nm,speed_rpm\n5.0,0.2,1000\n",
        ),
        ("steady", 'kind = "radial_piston"\nname = "ours"', "pressure_bar_abs,speed_rpm\n2.0,390\n"),
    ],
)
def test_other_rigs_come_as_an_inline_table(tmp_path, kind, motor, sweep):
    recording = read_recording(put(tmp_path, RIG.format(kind=kind, motor=motor), sweep))
    assert isinstance(recording.motor, dict)
    assert recording.files[0].kind == kind


# What is refused: the text names the file, the place and the remedy, and nothing on disk changes


BAD_TABLES = {
    "missing_pressure": ("flow_l_min,speed_rpm\n44,232\n", SHORT, ["header", "'pressure_bar_abs' or"]),
    "missing_motion": ("pressure_bar_abs\n1.6\n", SHORT, ["header", "'speed_rpm' or 'flow_l_min'"]),
    "missing_time": (
        "pressure_bar_abs,speed_rpm\n1.6,1\n",
        SHORT.replace("steady", "transient"),
        ["no column 'time_s'"],
    ),
    "nothing_measured": ("note\nx\n", SHORT.replace("steady", "zero"), ["header", "no column", "'speed_rpm'"]),
    "misspelt": ("presure_bar_abs,speed_rpm\n1,1\n", SHORT, ["no column", "is 'presure_bar_abs' meant? Rename it"]),
    "kilopascal": (
        "pressure_kpa_abs,speed_rpm\n160,232\n",
        SHORT,
        ["header", "'pressure_kpa_abs'", "pressure_bar_abs", "divide by 100"],
    ),
    "no_reference": (
        "pressure_bar,speed_rpm\n1.6,232\n",
        SHORT,
        ["'pressure_bar'", "pressure_bar_abs or pressure_bar_gauge", "say whether"],
    ),
    "revolutions": (
        "pressure_bar_abs,flow_l_min,n [1/min]\n1.6,44,232\n",
        SHORT,
        ["header: column 'n [1/min]' looks like speed_rpm; rename it (the numbers stay)", "runs import FILE --guess"],
    ),
    "hertz": ("Druck (bar ü),flow_l_min,n [1/s]\n1.6,44,4\n", SHORT, ["pressure_bar_gauge; rename", "multiply by 60"]),
    "other_flow": ("pressure_bar_abs,speed_rpm,Q [l/min]\n1.6,9,1\n", SHORT, ["'Q [l/min]' looks like flow_l_min"]),
    "other_time": ("Zeit,pressure_bar_abs,speed_rpm\n1,1.6,9\n", SHORT, ["'Zeit' looks like time_s"]),
    "title": ("Bench 2\n\n" + SWEEP, TOML, ["header: the column names stand in line 3; take out the lines above"]),
    "comment": ("# my bench\n" + SWEEP, TOML, ["header: the column names stand in line 2"]),
    "reversed": (TIMED + "3,2,1\n2,2,2\n1,2,3\n", "transient", ["column time_s: the times fall throughout", "reverse"]),
    "radians": ("pressure_bar_abs,speed_rad_s\n1.6,24\n", SHORT, ["'speed_rad_s'", "speed_rpm", "multiply by 9.5493"]),
    "cubic_metres": (
        "pressure_bar_abs,flow_m3_h\n1.6,3\n",
        SHORT,
        ["'flow_m3_h'", "flow_l_min", "multiply by 16.6667"],
    ),
    "standard_litres": ("pressure_bar_abs,flow_slpm\n1.6,3\n", SHORT, ["flow_l_min", "inlet's pressure"]),
    "other_case": ("pressure_bar_abs,Speed [rpm]\n1.6,232\n", SHORT, ["'Speed [rpm]'", "expected speed_rpm"]),
    "both_pressures": (
        "pressure_bar_abs,pressure_bar_gauge,speed_rpm\n1.6,0.6,232\n",
        SHORT,
        ["header", "both pressure_bar_abs and pressure_bar_gauge", "keep the one"],
    ),
    "instrument_in_another_unit": (
        "pressure_bar_gauge,flow_l_min,speed_rpm\n0.6,44,232\n",
        TOML,
        ["recording.toml, [channels.pressure_bar_abs]", "the files have pressure_bar_gauge", "name the table"],
    ),
    "instrument_without_column": (
        "pressure_bar_abs,speed_rpm\n1.6,232\n",
        TOML,
        ["recording.toml, [channels.flow_l_min]", "no file has this column"],
    ),
    "text": (
        HEADER + "1.6,44,fast\n",
        TOML,
        ["row 1, column speed_rpm", "'fast' is not a number", "leave the cell empty"],
    ),
    "long_text": (HEADER + f"1.6,44,{'x' * 5000}\n", TOML, ["row 1, column speed_rpm", "xxx...'"]),
    "control_text": (HEADER + "1.6,44,\x1b[31mred\n", TOML, ["row 1, column speed_rpm", r"\x1b[31mred"]),
    "code": (HEADER + "1.6,44,__import__('os')\n", TOML, ["row 1, column speed_rpm", "is not a number"]),
    "underscore": (HEADER + "1.6,44,1_000\n", TOML, ["row 1, column speed_rpm", "'1_000' is not a number"]),
    "other_digits": (HEADER + "1.6,44,٣٠\n", TOML, ["row 1, column speed_rpm", "is not a number"]),
    "negative_speed": (HEADER + "1.6,44,1\n1.6,44,-1\n", TOML, ["row 2, column speed_rpm", "never negative", "check"]),
    "negative_flow": (HEADER + "1.6,-5.1,232\n", TOML, ["row 1, column flow_l_min", "not below -5", "check the unit"]),
    "negative_pressure": (HEADER + "-0.1,44,232\n", TOML, ["row 1, column pressure_bar_abs", "0.01 to 40 bar"]),
    "pascal_numbers": (HEADER + "160000,44,232\n", TOML, ["row 1, column pressure_bar_abs", "check the unit"]),
    "supply": (
        "supply_open,pressure_bar_abs,speed_rpm\n0.5,1.6,2\n",
        SHORT,
        ["row 1, column supply_open", "expected 0 or 1"],
    ),
    "supply_unsaid": (
        "time_s,supply_open,pressure_bar_abs,speed_rpm\n1,,1.6,2\n2,1,1.6,2\n",
        "transient",
        ["row 1, column supply_open", "write 1 (open) or 0 (closed) here"],
    ),
    "locked": (
        "rotor_locked,pressure_bar_abs,speed_rpm\nyes,1.6,2\n",
        SHORT,
        ["row 1, column rotor_locked", "'yes' is not a number"],
    ),
    "direction": (
        "direction,pressure_bar_abs,speed_rpm\nsideways,1.6,2\n",
        SHORT,
        ["row 1, column direction", "expected up or down"],
    ),
    "empty": ("", TOML, ["the file is empty", "write a header"]),
    "header_only": (HEADER, TOML, ["a header and no rows", "write at least one row"]),
    "blank_header": ("\n" + SWEEP, TOML, ["header", "the column names stand in line 2"]),
    "no_header": ("1.6,44,232\n1.8,54,313\n", TOML, ["header", "holds numbers", "put the column names"]),
    "no_samples": (HEADER + ",44,232\n,54,313\n", TOML, ["column pressure_bar_abs", "every cell is empty"]),
    "double_time": (TIMED + "0,2,1\n1,2,2\n1,2,3\n", "transient", ["row 3, column time_s", "'1'", "not later"]),
    "time_backwards": (TIMED + "0,2,1\n2,2,2\n1,2,3\n", "transient", ["row 3, column time_s", "not later"]),
    "no_time": (TIMED + "0,2,1\n,2,2\n1,2,3\n", "transient", ["row 2, column time_s", "needs a time"]),
    "off_scale_time": (TIMED + "<1,2,1\n", SHORT, ["row 1, column time_s", "off scale", "write the number"]),
    "double_time_steady": (TIMED + "7,2,1\n8,2,2\n7,2,3\n", SHORT, ["row 3, column time_s", "the time 7", "its own"]),
    "double_column": ("speed_rpm,speed_rpm,pressure_bar_abs\n1,1,2\n", SHORT, ["header", "'speed_rpm' stands 2 times"]),
    "nameless_column": (
        "pressure_bar_abs,,speed_rpm\n2,1,2\n",
        SHORT,
        ["header", "column 2 has no name", "give it one"],
    ),
    "short_row": (HEADER + "1.6,44\n", TOML, ["row 1", "2 cells under 3 columns", "give each column a cell"]),
    "long_row": (HEADER + "1,6,44,232,3\n", TOML, ["row 1", "5 cells under 3 columns", "decimal comma"]),
    "blank_row": (HEADER + "1.6,44,232\n\n1.8,54,313\n", TOML, ["row 2", "blank line", "take it out"]),
    "nan": (HEADER + "1.6,44,NaN\n", TOML, ["row 1, column speed_rpm", "'NaN' is no number", "leave the cell empty"]),
    "infinite": (HEADER + "1.6,44,-inf\n", TOML, ["row 1, column speed_rpm", "'-inf' is no reading"]),
    "overflow": (HEADER + "1.6,44,1e999\n", TOML, ["row 1, column speed_rpm", "too large"]),
    "decimal_comma": (HEADER + '1.6,44,"232,3"\n', TOML, ["row 1, column speed_rpm", "decimal comma", "point"]),
    "semicolons": (SWEEP.replace(",", ";"), TOML, ["header", "semicolons", "separate them with commas"]),
    "tabs": (SWEEP.replace(",", "\t"), TOML, ["header", "tabs", "separate them with commas"]),
    "latin_1": (SWEEP.encode() + b"1.6,44,\xb5\n", TOML, ["row 4", "0xb5 is not UTF-8", "save the file as UTF-8"]),
    "utf_16": (SWEEP.encode("utf-16"), TOML, ["binary", "UTF-16", "export the table as CSV"]),
    "binary": (bytes(range(256)) * 100, TOML, ["binary file", "export the table as CSV"]),
    "one_line": (b"x" * 200_000, TOML, ["a line longer than 65536 bytes"]),
    "open_quote": (HEADER + '1.6,"44,232\n1.8,54,313\n', TOML, ["row 1", "quotation mark", "without quotes"]),
    "bare_returns": (SWEEP.replace("\n", "\r"), TOML, ["header", "bare carriage return"]),
    "too_many_columns": (",".join(f"c{n}" for n in range(300)) + "\n", TOML, ["header", "300 columns", "leave out"]),
    "long_steady": (HEADER + "1.6,44,232\n" * 100_001, TOML, ["more than 100000 rows", "average", '"transient"']),
}


def test_times_of_day_are_not_told_as_empty_too(tmp_path):
    rows = TIMED + "10:00:00,2,1\n10:00:01,2,2\n"
    text = refusal(put(tmp_path / "bench", SHORT.replace("steady", "transient"), rows))
    assert "row 1, column time_s: '10:00:00' is not a number but a time of day; write seconds, or bring it" in text
    assert "every cell is empty" not in text


@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_bad_table_is_refused(tmp_path, case):
    sweep, toml, words = BAD_TABLES[case]
    folder = put(tmp_path / "bench", SHORT.replace("steady", "transient") if toml == "transient" else toml, sweep)
    text = refusal(folder)
    place = "recording.toml" if words[0].startswith("recording.toml") else str(folder / "sweep.csv")
    assert place in text
    for word in words:
        assert word in text
    assert len(text) < 6000
    assert all(letter.isprintable() or letter == "\n" for letter in text)


SUPPLY_EXACT = TOML + "[supply]\nvalve_time_s = 0.1\nvalve_time_s_sd = 0\n"

BAD_TOML = {
    "format": (TOML.replace("recording/1", "recording/9"), ["'format'", '"recording/1"', "recording/9"]),
    "no_format": (TOML.replace('format = "recording/1"\n', ""), ["the key 'format' is missing"]),
    "misspelt_key": (TOML.replace("noise_sd = 0.4", "noise_ds = 0.4"), ["noise_ds", "did you mean 'noise_sd'"]),
    "misspelt_kind": (
        TOML.replace('"steady"', '"stedy"'),
        ["'kind' in [[files]] entry 1 (file = 'sweep.csv')", "'steady'", "stedy"],
    ),
    "double_key": (TOML.replace("noise_sd = 0.4", "noise_sd = 0.4\nnoise_sd = 0.5"), ["not valid TOML", "twice"]),
    "byte_order_mark": ("\ufeff" + TOML, ["byte order mark", "save it as UTF-8 without one"]),
    "no_toml": ("format = \n", ["not valid TOML"]),
    "negative_sd": (
        TOML.replace("bias_sd = 0.1", "bias_sd = -0.1"),
        ["channels.speed_rpm.bias_sd", "greater than", "-0.1"],
    ),
    "sd_as_text": (TOML.replace("bias_sd = 0.1", 'bias_sd = "0.1"'), ["channels.speed_rpm.bias_sd", "number"]),
    "infinite_sd": (TOML.replace("bias_sd = 0.1", "bias_sd = inf"), ["channels.speed_rpm.bias_sd"]),
    "exact_instrument": (
        TOML.replace("noise_sd = 0.4", "noise_sd = 0").replace("resolution = 0.1", "resolution = 0"),
        ["[channels.speed_rpm]", "no instrument is exact"],
    ),
    "supply_key": (TOML + "[supply]\nregulator_tim_s = 1\n", ["supply.regulator_tim_s", "'regulator_time_s'"]),
    "supply_negative": (TOML + "[supply]\nline_volume_l = -1\n", ["supply.line_volume_l", "greater than", "-1"]),
    "supply_lone_deviation": (TOML + "[supply]\nvalve_time_s_sd = 1\n", ["valve_time_s_sd", "give both"]),
    "supply_exact": (SUPPLY_EXACT, ["supply.valve_time_s_sd", "greater than 0"]),
    "tachometer_key": (
        TOML.replace("noise_sd = 0.4", "pulse_per_rev = 60"),
        ["pulse_per_rev", "did you mean 'pulses_per_rev'"],
    ),
    "tachometer_without_pulses": (
        TOML.replace("noise_sd = 0.4", "pulses_per_rev = 0"),
        ["channels.speed_rpm.pulses_per_rev", "greater than 0"],
    ),
    "pitch_without_teeth": (
        TOML.replace("noise_sd = 0.4", "pitch_error_sd = 0.01"),
        ["channels.speed_rpm", "pitch_error_sd", "without pulses_per_rev"],
    ),
    **{
        f"{key}_of_a_flow_meter": (
            TOML.replace("noise_sd = 0.5", f"noise_sd = 0.5\npulses_per_rev = 60\n{key} = 0.5"),
            ["[channels.flow_l_min]", f"{key} is for [channels.speed_rpm] only"],
        )
        for key in ("pitch_error_sd", "window_s", "lag_s")
    },
    "origin_key": (TOML + '[origin]\noperater = "me"\n', ["origin.operater", "did you mean 'operator'"]),
    "origin_number": (TOML + "[origin]\nmotor_serial = 3600\n", ["origin.motor_serial", 'write "3600"']),
    "origin_date": (TOML + "[origin]\ndate = 2026-05-14\n", ["'origin.date': is not in quotes", '"2026-05-14"']),
    "origin_empty": (TOML + '[origin]\nnote = ""\n', ["'origin.note'", "should have at least 1 character "]),
    "origin_long": (TOML + f'[origin]\nnote = "{"a" * 2001}"\n', ["'origin.note'", "at most 2000 characters "]),
    "ambient_unsaid": (TOML + "[ambient]\npressure_bar = 1.0\n", ["did you mean 'pressure_bar_abs'"]),
    "huge_flywheel": (TOML + "[rig]\nadded_inertia_kg_m2 = 5000\n", ["added_inertia_kg_m2", "equal to 100"]),
    "noise_scale": (
        TOML + "noise_scale = 0.0\n",
        ["'noise_scale' in [[files]] entry 1 (file = 'sweep.csv')", "greater than 0"],
    ),
    "negative_flywheel": (
        TOML + "added_inertia_kg_m2 = -0.02\n",
        [
            "'added_inertia_kg_m2' in [[files]] entry 1 (file = 'sweep.csv') should be greater than or equal to 0",
            "-0.02",
        ],
    ),
    "negative_rig_flywheel": (
        TOML + "[rig]\nadded_inertia_kg_m2 = -1\n",
        ["'rig.added_inertia_kg_m2'", "or leave it out"],
    ),
    "humidity_in_percent": (TOML + "[ambient]\nrelative_humidity = 50.0\n", ["ambient.relative_humidity", "50"]),
    "ambient_in_pascal": (TOML + "[ambient]\npressure_bar_abs = 101325.0\n", ["ambient.pressure_bar_abs", "101325"]),
    "lone_deviation": (TOML + "[ambient]\npressure_sd_bar = 0.1\n", ["ambient", "pressure_sd_bar", "give both"]),
    "no_files": (TOML.split("[[files]]")[0], ["the key 'files' is missing"]),
    "empty_files": (TOML.split("[channels")[0] + "files = []\n", ["files"]),
    "unknown_channel": (
        TOML + "[channels.sped_rpm]\nnoise_sd = 1\n",
        ["[channels.sped_rpm]", "did you mean 'speed_rpm'"],
    ),
    "flag_channel": (TOML + "[channels.supply_open]\nnoise_sd = 1\n", ["[channels.supply_open]", "no instrument"]),
    "channel_unit": (
        TOML + "[channels.pressure_kpa_abs]\nnoise_sd = 1\n",
        ["[channels.pressure_kpa_abs]", "expected pressure_bar_abs"],
    ),
    "motor_path": (TOML.replace('"ptm3600"', '"../motors/ptm3600"'), ["motor '../motors/ptm3600'", "configs/motors"]),
    "motor_file": (TOML.replace('"ptm3600"', '"ptm3600.toml"'), ["motor 'ptm3600.toml'", "without folder and .toml"]),
    "motor_absolute": (TOML.replace('"ptm3600"', '"/ptm3600"'), ["motor '/ptm3600'", "configs/motors"]),
    "motor_unknown": (TOML.replace('"ptm3600"', '"ptm9"'), ["motor 'ptm9' is not in configs/motors", "ptm3600"]),
    "file_absolute": (TOML.replace('"sweep.csv"', '"/etc/passwd"'), ["entry 1", "points outside the folder"]),
    "file_above": (TOML.replace('"sweep.csv"', '"../bench/sweep.csv"'), ["entry 1", "points outside the folder"]),
    "file_backslash": (TOML.replace('"sweep.csv"', "'..\\sweep.csv'"), ["entry 1", "backslash", "use plain names"]),
    "file_drive": (TOML.replace('"sweep.csv"', '"C:sweep.csv"'), ["entry 1", "colon"]),
    "file_missing": (
        TOML.replace('"sweep.csv"', '"swep.csv"'),
        ["'swep.csv' cannot be read", "CSV files there: sweep.csv"],
    ),
    "file_is_folder": (TOML.replace('"sweep.csv"', '"."'), ["entry 1", "names no file"]),
    "file_twice": (
        TOML + '[[files]]\nfile = "./sweep.csv"\nkind = "zero"\n',
        ["[[files]] entry 2", "is the file of entry 1", "name each file once"],
    ),
    "rig_unknown": (RIG.format(kind="steady", motor='kind = "turbine"'), ["motor.kind 'turbine'", "free_rotor"]),
    "rig_without_kind": (RIG.format(kind="steady", motor="mass_kg = 1.0"), ["motor.kind is missing", "driven_axis"]),
    "rig_without_inertia": (
        RIG.format(kind="steady", motor='kind = "free_rotor"'),
        ["[motor]", "'inertia_kg_m2' is missing"],
    ),
    "rig_turns_and_slides": (
        RIG.format(kind="steady", motor='kind = "driven_axis"\nmass_kg = 1.0\ninertia_kg_m2 = 1.0'),
        ["[motor]", "either inertia_kg_m2"],
    ),
    "rig_key": (
        RIG.format(kind="steady", motor='kind = "free_rotor"\ninertia_kg_m = 1.0'),
        ["[motor]", "did you mean 'inertia_kg_m2'"],
    ),
    "rig_prior": (
        RIG.format(kind="steady", motor='kind = "free_rotor"\ninertia_kg_m2 = 1.0\nviscous_friction_sd = 1.0'),
        ["[motor]", "viscous_friction_sd", "give both"],
    ),
}


@pytest.mark.parametrize("case", BAD_TOML)
def test_a_bad_recording_toml_is_refused(tmp_path, case):
    toml, words = BAD_TOML[case]
    text = refusal(put(tmp_path / "bench", toml))
    assert "recording.toml" in text
    for word in words:
        assert word in text


def test_a_displacement_machine_needs_an_inertia_for_a_transient(tmp_path):
    toml = RIG.format(kind="transient", motor='kind = "displacement_machine"\ndisplacement_m3_per_rev = 1e-5')
    text = refusal(put(tmp_path / "bench", toml, "time_s,pressure_bar_abs,speed_rpm\n0,2,10\n1,2,20\n"))
    assert "inertia_kg_m2 is missing" in text


@pytest.mark.parametrize("place", ["[rig]", "[[files]]"])
def test_a_slide_has_no_flywheel(tmp_path, place):
    toml = RIG.format(kind="transient", motor='kind = "driven_axis"\nmass_kg = 9.0')
    flywheel = "added_inertia_kg_m2 = 5.0\n"
    toml = f"{toml}\n[rig]\n{flywheel}" if place == "[rig]" else toml.replace("[[files]]\n", f"[[files]]\n{flywheel}")
    text = refusal(put(tmp_path / "bench", toml, "time_s,force_n,velocity_m_s\n0,1,-0.1\n1,2,0.1\n"))
    assert f"recording.toml, {place}" in text and "a slide has no shaft; add it to mass_kg" in text


@pytest.mark.parametrize("motor", ['kind = "driven_axis"\nmass_kg = 1.0', 'kind = "driven_axis"\ninertia_kg_m2 = 1.0'])
def test_a_driven_axis_needs_its_drive(tmp_path, motor):
    text = refusal(put(tmp_path / "bench", RIG.format(kind="steady", motor=motor), "velocity_m_s,speed_rpm\n1,1\n"))
    assert f"no column {'force_n' if 'mass' in motor else 'torque_nm'!r}" in text


@pytest.mark.parametrize("linked", ["sweep.csv", "recording.toml", "day"])
def test_symbolic_links_are_refused(tmp_path, linked):
    outside, folder = put(tmp_path / "outside"), tmp_path / "bench"
    put(folder, TOML.replace('"sweep.csv"', '"day/sweep.csv"') if linked == "day" else TOML)
    (folder / linked).unlink(missing_ok=True)
    (folder / linked).symlink_to(outside if linked == "day" else outside / linked)
    assert "symbolic link" in refusal(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_refused_without_waiting_for_it(tmp_path):
    folder = put(tmp_path / "bench")
    (folder / "sweep.csv").unlink()
    os.mkfifo(folder / "sweep.csv")
    assert "'sweep.csv' is not a plain file" in refusal(folder)


@pytest.mark.parametrize("name", ["", "missing", "bench/sweep.csv"])
def test_what_is_no_recording_is_refused(tmp_path, name):
    put(tmp_path / "bench")
    with pytest.raises(RecordingError, match=r"a recording is a folder with recording\.toml"):
        read_recording(tmp_path / name)


def test_all_mistakes_come_in_one_error(tmp_path):
    toml = TOML.replace("ptm3600", "ptm9") + '[[files]]\nfile = "gone.csv"\nkind = "zero"\n'
    text = refusal(put(tmp_path / "bench", toml, HEADER + "1.6,x,232\n1.8,54,-3\n1.8\n"))
    assert len(text.splitlines()) == 5
    for word in ("ptm9", "gone.csv", "row 1, column flow_l_min", "row 2, column speed_rpm", "row 3"):
        assert word in text


def test_mistakes_are_counted_beyond_twenty(tmp_path):
    lines = refusal(put(tmp_path / "bench", sweep=HEADER + "1.6,44,x\n" * 50)).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "and 30 more"


def test_a_mistake_far_down_is_named_by_its_row(tmp_path):
    rows = "".join(f"{row * 0.001:.3f},2.0,390.0\n" for row in range(200_000))
    text = refusal(put(tmp_path / "bench", SHORT.replace("steady", "transient"), f"{TIMED}{rows}200.0,2.0,oops\n"))
    assert "row 200001, column speed_rpm" in text


@pytest.mark.long
def test_times_are_compared_across_the_stretches_of_a_long_file(tmp_path):
    rows = "".join(f"{row * 0.001:.3f},2.0,390.0\n" for row in range(200_000))
    text = refusal(put(tmp_path / "bench", SHORT.replace("steady", "transient"), f"{TIMED}{rows}{rows}"))
    assert "row 200001, column time_s" in text.splitlines()[0]


# What is written


def same_numbers(one: Column, other: Column) -> bool:
    return np.array_equal(one.values, other.values, equal_nan=True) and np.array_equal(one.censor, other.censor)


def assert_same(one: Recording, other: Recording) -> None:
    assert (one.motor, one.ambient, one.channels) == (other.motor, other.ambient, other.channels)
    assert (one.added_inertia_kg_m2, one.supply, one.origin) == (
        other.added_inertia_kg_m2,
        other.supply,
        other.origin,
    )
    assert len(one.files) == len(other.files)
    for ours, theirs in zip(one.files, other.files, strict=True):
        for name in ("file", "kind", "start_s", "noise_scale", "rows"):
            assert getattr(ours, name) == getattr(theirs, name)
        assert ours.columns.keys() == theirs.columns.keys()
        assert all(same_numbers(column, theirs.columns[name]) for name, column in ours.columns.items())
        assert (ours.direction is None) == (theirs.direction is None)
        assert ours.direction is None or ours.direction.tolist() == theirs.direction.tolist()
        assert {name: list(cells) for name, cells in ours.extra.items()} == {
            name: list(cells) for name, cells in theirs.extra.items()
        }


@st.composite
def columns(draw, name: str, rows: int) -> Column:
    """A column as a reading could have left it."""
    low = {"flow_l_min": -5.0}.get(name, max(NUMERIC[name].low, -1e9))
    number = st.floats(low, min(NUMERIC[name].high, 1e9), allow_nan=False)
    if name in ("supply_open", "rotor_locked"):
        number = st.sampled_from([0.0, 1.0])
    cell = st.tuples(number, st.sampled_from([0, -1, 1] if name in MEASURED else [0])) | st.just((np.nan, 0))
    first = st.tuples(number, st.just(0))  # a column that is needed holds one number at least
    cells = [draw(first)] + [draw(cell) for _ in range(rows - 1)]
    values = np.array([value for value, _ in cells]) + 0.0
    censor = np.array([sign for _, sign in cells], dtype=np.int8)
    if name == "speed_rpm":
        censor[(values == 0.0) & (censor == 0)] = -1
    return Column(values, censor)


@st.composite
def files(draw, name: str, begins: tuple[float, float] = (-1e9, 1e9)) -> RecordingFile:
    rows = draw(st.integers(1, 6))
    kind = draw(st.sampled_from(["steady", "transient", "zero"]))
    others = draw(st.sets(st.sampled_from(["supply_open", "rotor_locked", "inlet_temperature_c", "torque_nm"])))
    named = ["pressure_bar_abs", draw(st.sampled_from(["flow_l_min", "speed_rpm"])), *sorted(others)]
    numbers = {column: draw(columns(column, rows)) for column in named}
    if kind == "transient":
        times = draw(st.lists(st.floats(-1e6, 1e6), min_size=rows, max_size=rows, unique=True))
        numbers = {"time_s": Column(np.sort(np.array(times)) + 0.0, np.zeros(rows, dtype=np.int8)), **numbers}
    ways = st.lists(st.sampled_from(["up", "down", ""]), min_size=rows, max_size=rows).map(np.array)
    plain = st.text(st.characters(categories=["L", "N", "P", "Zs"]), max_size=8).map(lambda text: f"x{text}")
    notes = st.lists(plain, min_size=rows, max_size=rows).map(lambda cells: {"note": np.array(cells, dtype=object)})
    return RecordingFile(
        file=name,
        kind=kind,
        start_s=draw(st.floats(*begins)),
        noise_scale=draw(st.floats(0.01, 100.0)),
        rows=rows,
        columns=numbers,
        direction=draw(st.none() | ways),
        extra=draw(st.just({}) | notes),
    )


@st.composite
def recordings(draw) -> Recording:
    """Any recording that recording/1 can hold."""
    one, two = (files("a.csv"),), (files("a.csv", (-1e9, -1e6)), files("b/c d.csv", (1e6, 1e9)))  # none overlap
    taken = tuple(draw(file) for file in draw(st.sampled_from([one, two])))
    present = [name for name in MEASURED if any(name in file.columns for file in taken)]
    channels = {}
    for name in present:
        figures = dict(zip(FIGURES, NUMERIC[name].figures, strict=True))
        stated = draw(st.sets(st.sampled_from(FIGURES)))
        figures |= {figure: draw(st.floats(1e-9, 1.0)) for figure in FIGURES if figure in stated}
        if name == "flow_l_min":  # so that slightly negative flows stay plausible
            figures |= {"noise_sd": 1.0, "bias_sd": 1.0}
            stated |= {"noise_sd", "bias_sd"}
        left_out = tuple(figure for figure in FIGURES if figure not in stated)
        teeth = draw(st.none() | st.floats(0.5, 1e4))
        of_speed = {
            "pulses_per_rev": teeth,
            "pitch_error_sd": teeth and draw(st.none() | st.floats(0.0, 0.5)),
            "window_s": draw(st.none() | st.floats(1e-6, 10.0)),
            "lag_s": draw(st.none() | st.floats(0.0, 10.0)),
        }
        told = {"serial": draw(st.none() | st.just('N "1"\n\u20ac'))} | (of_speed if name == "speed_rpm" else {})
        channels[name] = Channel(name, defaulted=left_out, **figures, **told)
    taken = tuple(replace(file, noise_scale=max(file.noise_scale, 0.5)) for file in taken)
    inline = {"kind": "radial_piston", "name": 'a "\\\n', "lap": {"value deg": 8, "fixed": [True, 1e-7]}}
    ambient = Ambient(draw(st.none() | st.floats(0.5, 1.1)), None, draw(st.none() | st.floats(0.0, 40.0)), None, None)
    line = {name: draw(st.none() | st.floats(0.0, 10.0)) for name in ("regulator_time_s", "line_volume_l")}
    known = {f"{name}_sd": value and draw(st.none() | st.floats(1e-6, 10.0)) for name, value in line.items()}
    supply = SupplyFigures(**line, **{name: value or None for name, value in known.items()})
    origin = draw(st.dictionaries(st.sampled_from(["date", "operator", "oil", "note"]), st.text(min_size=1).map(repr)))
    return Recording(
        folder=Path(),
        motor=draw(st.sampled_from(["ptm3600", inline])),
        ambient=ambient,
        channels=channels,
        files=taken,
        added_inertia_kg_m2=draw(st.sampled_from([0.0, 0.0125])),
        supply=supply,
        origin=origin,
    )


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(recordings())
def test_what_is_written_is_read_back(tmp_path_factory, recording):
    folder = tmp_path_factory.mktemp("written") / "copy"
    write_recording(recording, folder)
    assert_same(read_recording(folder), recording)
    assert [entry.name for entry in folder.parent.iterdir()] == ["copy"]


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200) | st.text(max_size=60).map(str.encode))
@example(b'pressure_bar_abs,speed_rpm\n"\n')
def test_no_bytes_bring_the_reader_down(tmp_path_factory, rubbish):
    folder = tmp_path_factory.mktemp("rubbish")
    for data in (rubbish, b"pressure_bar_abs,speed_rpm\n" + rubbish):
        put(folder, SHORT, data)
        try:
            read_recording(folder)
        except RecordingError as error:
            assert "sweep.csv" in str(error)


def test_nothing_is_overwritten(tmp_path):
    recording = read_recording(put(tmp_path / "bench"))
    (tmp_path / "taken").mkdir()
    before = bytes_under(tmp_path)
    with pytest.raises(RecordingError, match="exists already; nothing is overwritten"):
        write_recording(recording, tmp_path / "taken")
    assert bytes_under(tmp_path) == before


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"file": "../escaped.csv"}, "points outside the folder"),
        ({"rows": 2}, "3 values in 2 rows"),
        ({"noise_scale": float("nan")}, "finite"),
        ({"columns": {}}, "sweep.csv"),
        ({"kind": "transient"}, "time_s"),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path, change, word):
    recording = read_recording(put(tmp_path / "bench"))
    before = bytes_under(tmp_path)
    with pytest.raises(RecordingError, match=word) as caught:
        write_recording(replace(recording, files=(replace(recording.files[0], **change),)), tmp_path / "copy")
    assert "copy" in str(caught.value)
    assert ".spinbench-" not in str(caught.value)
    assert bytes_under(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "column", "what"),
    [
        ("Pressure (psig)", "pressure_bar_abs or pressure_bar_gauge", "multiply by 0.0689476"),
        ("pressure_mpa_abs", "pressure_bar_abs", "multiply by 10"),
        ("flow_cfm", "flow_l_min", "multiply by 28.3168"),
        ("flow_kg_h", "flow_l_min", "divide by the air's density at the inlet, then multiply by 16.6667"),
        ("flow_sccm", "flow_l_min", "bring standard litres to the inlet's pressure and temperature"),
        ("torque_lbft", "torque_nm", "multiply by 1.35582"),
        ("torque_nmm", "torque_nm", "divide by 1000"),
        ("velocity_km_h", "velocity_m_s", "divide by 3.6"),
        ("inlet_temperature_f", "inlet_temperature_c", "subtract 32, then divide by 1.8"),
        ("inlet_temperature_k", "inlet_temperature_c", "subtract 273.15"),
    ],
)
def test_a_quantity_in_another_unit_is_told_what_to_do(name, column, what):
    assert other_spelling(name) == (column, what)


def test_text_that_a_spreadsheet_would_run_is_written_harmless(tmp_path):
    read = read_recording(
        put(tmp_path / "bench", sweep=HEADER.strip() + ",note\n1.6,44,232,=cmd()\n1.8,54,313,-1.5\n1.9,60,340, =1+1\n")
    )
    write_recording(read, tmp_path / "copy")
    assert read_recording(tmp_path / "copy").files[0].extra["note"].tolist() == ["'=cmd()", "-1.5", "' =1+1"]


# Large files


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc (Linux)")
def test_a_large_file_is_read_in_memory_proportional_to_its_numbers(tmp_path):
    put(tmp_path, SHORT.replace("steady", "transient"))
    with (tmp_path / "sweep.csv").open("w") as stream:
        stream.write(TIMED)
        for start in range(0, 2_400_000, 100_000):
            rows = range(start, start + 100_000)
            stream.write("".join(f"{row * 0.005:.3f},2.0,{380 + row % 97 * 0.1:.1f}\n" for row in rows))
    assert (tmp_path / "sweep.csv").stat().st_size > 45_000_000
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(ROOT / "logs" / "published_sweep"), str(tmp_path)],
        capture_output=True, text=True, check=True, cwd=ROOT, env={**os.environ, "FORCE_COLOR": "1"},
    )  # fmt: skip
    rows, growth = map(int, done.stdout.split())
    held = rows * 3 * 9
    assert rows == 2_400_000
    assert growth < 1.25 * held + 64_000_000
    assert "reading the recording" in done.stderr


PEAK = """
import re, sys
from pathlib import Path
from rig.recording import read_recording
def kilobytes(key):
    return int(re.search(key + r":\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
read_recording(Path(sys.argv[1]))
before = kilobytes("VmRSS")
file = read_recording(Path(sys.argv[2])).files[0]
print(file.rows, (kilobytes("VmHWM") - before) * 1024)
"""


def test_a_small_file_is_read_without_a_bar(tmp_path, capfd):
    read_recording(put(tmp_path))
    assert capfd.readouterr() == ("", "")


# The recordings and the page that ship


def test_the_published_sweep_is_table_3():
    recording = read_recording(ROOT / "logs" / "published_sweep")
    file = recording.files[0]
    table = [file.columns[name].values.tolist() for name in ("pressure_bar_abs", "flow_l_min", "speed_rpm")]
    assert table == [
        [1.60, 1.70, 1.80, 1.83, 1.85, 1.95, 2.00],
        [44.0, 51.0, 54.0, 58.0, 62.0, 67.0, 55.0],
        [232.3, 272.9, 313.8, 326.1, 333.6, 374.5, 394.8],
    ]
    assert recording.motor == "ptm3600"
    assert recording.ambient == Ambient()
    assert all(channel.defaulted == () for channel in recording.channels.values())
    assert recording.channels["pressure_bar_abs"].bias_sd == pytest.approx(0.096 / 3**0.5, rel=1e-3)


@pytest.mark.skipif(not PRACTICE.is_dir(), reason="the practice recordings are not beside the repository")
def test_the_practice_recordings_are_read_without_a_warning():
    for folder in sorted(PRACTICE.glob("p*")):
        recording = read_recording(folder)
        assert recording.warnings == ()
        assert recording.files[0].rows == 26


def page() -> str:
    return (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")


def test_the_example_of_the_page_is_a_recording(tmp_path):
    toml, sweep = (re.search(rf"```{kind}\n(.*?)```", page(), re.DOTALL)[1] for kind in ("toml", "csv"))
    recording = read_recording(put(tmp_path, toml, sweep))
    assert recording.files[0].columns["flow_l_min"].censor.tolist() == [0, 0, 1]
    assert sum("leaves out noise_sd" in text for text in recording.warnings) == 3


def test_the_page_states_the_defaults_in_use():
    for name in NAMES:
        assert f"`{name}`" in page()
    for name in MEASURED:
        figures = " | ".join(str(figure) for figure in NUMERIC[name].figures)
        assert re.search(rf"^\| `{name}` \|.*\| {re.escape(figures)} \|$", page(), re.MULTILINE)


def test_the_errors_on_the_page_are_the_ones_given(tmp_path):
    (tmp_path / "one").mkdir()
    first = refusal(put(tmp_path / "one" / "bench", SHORT, "pressure_kpa_abs,speed_rpm\n160,232\n"))
    second = refusal(put(tmp_path / "one" / "bench", TOML, HEADER + '1.6,44,1\n1.6,44,2\n1.6,44,"313,8"\n'))
    for text in (first, second):
        assert text.replace(f"{tmp_path / 'one'}{os.sep}", "    ") in page()
