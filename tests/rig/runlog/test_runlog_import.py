"""Other people's data: units are said and never guessed, and what is imported is what was there."""

import os
import re
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from configs import ConfigError
from rig.exchange.export import recording_of
from rig.exchange.importing import import_files, import_recording, import_table
from rig.exchange.mapping import FOLDER, read_mapping
from rig.exchange.units import UNITS, known_units, unit_of
from rig.recording import read_recording
from rig.runlog import RunError, read_run, verify

SHARED = Path(__file__).resolve().parents[4] / "shared"
RECORDINGS = Path(os.environ.get("SPINBENCH_RECORDINGS", SHARED / "recordings"))
HEAD = """
format = "import/1"
title = "a bench elsewhere"
source = "a colleague, by mail"
licence = "none: for this test only"
motor = "ptm3600"
kind = "steady"
[table]
reader = "csv"
delimiter = ";"
decimal = ","
"""
COLUMNS = """
[columns.pressure_bar_gauge]
column = "Druck"
unit = "kPa gauge"
bias_sd = 0.01
[columns.flow_l_min]
column = "Durchfluss"
unit = "m3/h"
[columns.speed_rpm]
column = "Drehzahl"
unit = "rad/s"
"""
CSV = "Druck;Durchfluss;Drehzahl\n58,7;2,64;24,327\n68,7;<3,06;28,578\n78,7;;32,861\n"


@pytest.fixture
def put(tmp_path):
    """Writes a file beside the others; returned is its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def imported(put, tmp_path):
    """Imports a CSV file with a mapping; returned is the run."""

    def run(csv=CSV, head=HEAD, columns=COLUMNS):
        mapping = read_mapping(put("elsewhere.toml", head + columns))
        return read_run(import_table([put("data.csv", csv)], mapping, tmp_path / "runs"))

    return run


def test_a_table_with_decimal_commas_becomes_a_run(imported):
    run = imported()
    assert (run.state, run.start.kind, run.start.bench, run.has_wire) == ("finished", "import", "elsewhere", False)
    assert verify(run.folder) == []
    first = {row.channel: row for row in run.samples.itertuples() if row.exchange == 1}
    assert first["pressure_bar_gauge"].value == pytest.approx(0.587)
    assert first["flow_l_min"].value == pytest.approx(44.0)
    assert first["speed_rpm"].value == pytest.approx(232.3, abs=0.01)
    assert first["speed_rpm"].raw == "24,327"
    assert set(run.samples["quality"]) == {"unverified"}
    assert run.start.imported["source"] == "a colleague, by mail"
    assert run.events[0].details["file"] == "data.csv"


def test_an_imported_run_is_exported_like_any_other(imported):
    made = recording_of(imported())
    (file,) = made.recording.files
    assert (file.kind, file.rows) == ("steady", 3)
    flow = file.columns["flow_l_min"]
    assert list(flow.censor) == [0, -1, 0]
    assert np.isnan(flow.values[2])
    assert flow.values[1] == pytest.approx(51.0)
    assert made.recording.channels["pressure_bar_gauge"].bias_sd == 0.01
    assert "time_s" not in file.columns  # the source tells of no times


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "m3/h"\n', "", r"columns.flow_l_min: the unit is missing; .* one of L/min, L/s, L/h, m3/h"),
        ('"m3/h"', '"furlongs"', r"columns.flow_l_min: the unit 'furlongs' is not known; known for flow_l_min: L/min"),
        ('"m3/h"', '"rpm"', r"columns.flow_l_min: 'rpm' is a unit of speed, and flow_l_min comes in one of L/min"),
        ('"kPa gauge"', '"kPa"', r"'kPa' does not say absolute or gauge; write 'kPa abs' or 'kPa gauge'"),
        ('"kPa gauge"', '"kPa abs"', r"'kPa abs' is a unit of absolute pressure, and pressure_bar_gauge comes in"),
        ('"m3/h"', '"Nm3/h"', r"'Nm3/h' refers to a standard state; say which in standard = "),
        ('"rad/s"', '"Hz"', r"Hz needs pulses_per_rev"),
        ("columns.speed_rpm", "columns.speed_rpn", r"no recording has this column; did you mean 'speed_rpm'\?"),
    ],
)
def test_a_unit_that_is_missing_or_wrong_is_refused_with_those_that_would_do(put, old, new, words):
    assert old in COLUMNS
    with pytest.raises(RunError, match=words):
        read_mapping(put("elsewhere.toml", HEAD + COLUMNS.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('delimiter = ";"\n', "", "a CSV file needs delimiter and decimal; they are said and never guessed"),
        ('kind = "steady"\n', "", "the key 'kind' is missing; say steady, transient or zero"),
        ('licence = "none: for this test only"\n', "", "the key 'licence' is missing"),
        ('reader = "csv"', 'reader = "cvs"', "table.reader"),
        ("import/1", "import/2", "'format'"),
    ],
)
def test_a_mapping_that_leaves_something_open_is_refused(put, old, new, words):
    assert old in HEAD
    with pytest.raises((RunError, ConfigError), match=re.escape(words)):
        read_mapping(put("elsewhere.toml", HEAD.replace(old, new) + COLUMNS))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("2,64", "2.64", r"data.csv, line 2, column 'Durchfluss': '2.64' is not a number, decimals with ','"),
        ("28,578", "fast", r"data.csv, line 3, column 'Drehzahl': 'fast' is not a number"),
        ("Drehzahl", "Speed", r"no column is called 'Drehzahl'; there are 'Druck', 'Durchfluss', 'Speed'"),
        ("58,7;", "58,7;1;", r"data.csv, line 2: 4 cells, expected 3; is the delimiter right\?"),
        ("Durchfluss", "Druck", r"2 columns are called 'Druck'; give the place of one"),
    ],
)
def test_a_cell_that_is_not_what_the_mapping_says_is_refused_with_its_place(imported, old, new, words):
    with pytest.raises(RunError, match=words):
        imported(CSV.replace(old, new))


def test_nothing_is_left_behind_when_a_file_cannot_be_read(imported, tmp_path):
    with pytest.raises(RunError):
        imported("no table")
    assert not (tmp_path / "runs").exists()


def test_every_unit_has_a_quantity_that_some_column_takes():
    columns = {name for column in ("time_s", "flow_l_min", "speed_rpm", "direction") for name in known_units(column)}
    assert {"s", "ISO", "L/min", "scfm", "Hz", "words"} <= columns
    assert unit_of("pressure_bar_abs", "psi abs").factor == pytest.approx(0.0689476, rel=1e-5)
    assert unit_of("inlet_temperature_c", "K").offset == -273.15
    freezing = unit_of("inlet_temperature_c", "degF")
    assert 32.0 * freezing.factor + freezing.offset == pytest.approx(0.0)
    assert unit_of("flow_l_min", "cfm").factor == pytest.approx(0.3048**3 * 1000.0)
    assert all(unit.factor > 0.0 for unit in UNITS.values())


def test_pulses_and_standard_litres_are_brought_to_rpm_and_to_the_inlet(imported):
    columns = COLUMNS.replace('"rad/s"', '"Hz"\npulses_per_rev = 20').replace(
        '"m3/h"', '"NL/min"\nstandard = {pressure_bar_abs = 1.01325, temperature_c = 0.0}'
    )
    ambient = "[ambient]\npressure_bar_abs = 1.0\ntemperature_c = 20.0\n"
    run = imported("Druck;Durchfluss;Drehzahl\n100,0;100,0;131,6\n", columns=columns + ambient)
    read = dict(zip(run.samples["channel"], run.samples["value"], strict=True))
    assert read["speed_rpm"] == pytest.approx(394.8)
    assert read["flow_l_min"] == pytest.approx(100.0 * (1.01325 / 2.0) * (293.15 / 273.15))


def test_a_transient_with_clock_times_over_midnight_becomes_a_capture(imported):
    columns = COLUMNS + '[columns.time_s]\ncolumn = "Zeit"\nunit = "hh:mm:ss"\n'
    csv = "Zeit;Druck;Durchfluss;Drehzahl\n23:59:59;100,0;1,0;40,0\n00:00:00,5;0,0;0,5;20,0\n"
    with pytest.raises(RunError, match=r"'00:00:00,5' is not a time \(hh:mm:ss\)"):
        imported(csv, head=HEAD.replace("steady", "transient"), columns=columns)
    run = imported(csv.replace("00,5;0", "00;0"), head=HEAD.replace("steady", "transient"), columns=columns)
    (file,) = recording_of(run).recording.files
    assert (file.file, file.kind, list(file.columns["time_s"].values)) == ("coast_down.csv", "transient", [0.0, 1.0])


def test_a_tdms_file_becomes_a_run(put, tmp_path):
    nptdms = pytest.importorskip("nptdms", reason="npTDMS is not installed")
    with nptdms.TdmsWriter(tmp_path / "data.tdms") as writer:
        values = {"P": [1.6, 1.8], "Q": [44.0, 54.0], "n": [232.3, 313.8]}
        writer.write_segment([nptdms.ChannelObject("bench", name, np.array(data)) for name, data in values.items()])
    head = HEAD.replace('"csv"\ndelimiter = ";"\ndecimal = ","', '"tdms"\ngroup = "bench"')
    columns = "".join(
        f'[columns.{name}]\ncolumn = "{column}"\nunit = "{unit}"\n'
        for name, column, unit in (
            ("pressure_bar_abs", "P", "bar abs"),
            ("flow_l_min", "Q", "L/min"),
            ("speed_rpm", "n", "rpm"),
        )
    )
    mapping = read_mapping(put("labview.toml", head + columns))
    run = read_run(import_files([tmp_path / "data.tdms"], mapping, tmp_path / "runs"))
    assert [plateau.means["speed_rpm"].mean for plateau in run.plateaus] == [232.3, 313.8]
    assert [plateau.means["pressure_bar_abs"].mean for plateau in run.plateaus] == [1.6, 1.8]
    other = read_mapping(put("labview.toml", head.replace('"bench"', '"rig"') + columns))
    with pytest.raises(RunError, match=r"group = one of 'bench'"):
        import_table([tmp_path / "data.tdms"], other, tmp_path / "runs")


@pytest.mark.parametrize("reader", ["tdms", "mat", "xlsx", "csv"])
@pytest.mark.parametrize(
    "content", [b"", b"\x00\xff\xfe garbage" * 50, b"PK\x03\x04" + b"\0" * 100, b"TDSm" + b"\1" * 60]
)
def test_garbage_in_a_file_is_an_error_in_words(put, tmp_path, reader, content):
    mapping = read_mapping(put("elsewhere.toml", HEAD.replace('"csv"', f'"{reader}"') + COLUMNS))
    with pytest.raises(RunError, match=r"data\.bin"):
        import_table([put("data.bin", content)], mapping, tmp_path / "runs")


def test_without_nptdms_the_error_says_what_to_install(put, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    mapping = read_mapping(put("elsewhere.toml", HEAD.replace('"csv"', '"tdms"') + COLUMNS))
    with pytest.raises(RunError, match="needs the package npTDMS"):
        import_table([put("data.tdms", b"")], mapping, tmp_path / "runs")


def workbook(path, sheet):
    """The least that a workbook holds."""
    relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    with zipfile.ZipFile(path, "w") as archive:
        book = f'<workbook {main} xmlns:r="{relations}"><sheets><sheet name="one" r:id="x"/></sheets></workbook>'
        archive.writestr("xl/workbook.xml", book)
        archive.writestr("xl/_rels/workbook.xml.rels", '<R><r Id="x" Target="worksheets/s.xml"/></R>')
        archive.writestr("xl/sharedStrings.xml", f"<sst {main}><si><t>Druck</t></si></sst>")
        archive.writestr("xl/worksheets/s.xml", sheet.replace("MAIN", main))


SHEET = (
    '<worksheet MAIN><sheetData><row r="2"><c r="A2" t="s"><v>0</v></c><c r="C2" t="inlineStr"><is><t>Drehzahl</t></is>'
    '</c></row><row r="4"><c r="A4"><v>58.7</v></c><c r="C4"><f>1+1</f><v>24.327</v></c></row></sheetData></worksheet>'
)
BOOK = HEAD.replace('"csv"\ndelimiter = ";"\ndecimal = ","', '"xlsx"\nsheet = "one"\nheading_line = 2')


def test_a_workbook_becomes_a_run(put, tmp_path):
    workbook(tmp_path / "data.xlsx", SHEET)
    columns = COLUMNS.replace('[columns.flow_l_min]\ncolumn = "Durchfluss"\nunit = "m3/h"\n', "")
    mapping = read_mapping(put("book.toml", BOOK + columns))
    run = read_run(import_table([tmp_path / "data.xlsx"], mapping, tmp_path / "runs"))
    assert run.samples["value"].tolist() == pytest.approx([0.587, 232.3], abs=0.01)


def test_a_workbook_with_xml_entities_is_refused(put, tmp_path):
    workbook(tmp_path / "data.xlsx", '<!DOCTYPE x [<!ENTITY a "aaaa">]>' + SHEET)
    mapping = read_mapping(put("book.toml", BOOK + COLUMNS))
    with pytest.raises(RunError, match="it declares XML entities"):
        import_table([tmp_path / "data.xlsx"], mapping, tmp_path / "runs")


ORIGIN = """
[origin]
date = "2019-05-02"
operator = "Ms Novak"
motor_serial = "A-17"
oil = "VG 32"
note = "<b>old</b> seals"
parent = "spring"
"""


def test_where_imported_data_come_from_goes_through_the_run_into_the_recording(imported):
    """The day of the import is not the day of the test."""
    told = {
        "date": "2019-05-02",
        "operator": "Ms Novak",
        "motor_serial": "A-17",
        "oil": "VG 32",
        "parent": "spring",
    }
    run = imported(columns=COLUMNS + ORIGIN)
    note = f"<b>old</b> seals; run {run.name}, bench elsewhere"
    assert recording_of(run).recording.origin == told | {"note": note}
    assert list(recording_of(imported()).recording.origin) == ["note"]


AXIS = """
format = "import/1"
title = "a slide"
source = "made up"
licence = "none"
[motor]
kind = "driven_axis"
mass_kg = 2.0
[table]
reader = "csv"
delimiter = "\\t"
decimal = "."
heading_line = 0
[columns.time_s]
column = 1
unit = "ms"
[columns.velocity_m_s]
column = 2
unit = "mm"
differentiate = true
factor = -1.0
noise_sd = 0.001
[columns.force_n]
constant = 2.0
unit = "kN"
noise_sd = 1.0
[[files]]
file = "slide.txt"
kind = "transient"
name = "first"
only = {column = 3, equals = 1.0}
[[files]]
file = "slide.txt"
kind = "transient"
name = "second"
start_s = 10.0
rows = [4, 7]
average_rows = 2
"""
SLIDE = "0\t0\t1\n100\t-10\t1\n200\t-30\t1\n0\t0\t2\n100\t-10\t2\n200\t-20\t2\n300\t-50\t2\n"


def test_another_rig_s_data_become_a_recording(put, tmp_path):
    mapping = read_mapping(put("slide.toml", AXIS + ORIGIN))
    folder = import_files([put("slide.txt", SLIDE)], mapping, tmp_path / "recording")
    recording = read_recording(folder)
    assert (recording.origin["motor_serial"], recording.origin["note"]) == ("A-17", "<b>old</b> seals")
    assert recording.motor == {"kind": "driven_axis", "mass_kg": 2.0}
    first, second = recording.files
    assert (first.file, second.file, second.start_s) == ("first.csv", "second.csv", 10.0)
    np.testing.assert_allclose(first.columns["velocity_m_s"].values, [np.nan, 0.1, 0.2])
    np.testing.assert_allclose(second.columns["time_s"].values, [0.1, 0.3])
    np.testing.assert_allclose(second.columns["velocity_m_s"].values, [np.nan, 0.2])  # 40 mm in 0.2 s
    assert list(first.columns["force_n"].values) == [2000.0] * 3
    assert "source: made up" in (folder / "notes.txt").read_text()


def test_files_and_the_mapping_s_entries_have_to_fit(put, tmp_path):
    mapping = read_mapping(put("slide.toml", AXIS))
    with pytest.raises(RunError, match=r"'slide.txt' is named in \[\[files\]\] and was not given"):
        import_recording([put("other.txt", SLIDE)], mapping, tmp_path / "recording")


def test_columns_of_other_rigs_are_no_run_of_the_motor(put, tmp_path):
    text = re.sub(r"\[motor\][^\[]*", "", AXIS).replace("licence", 'motor = "ptm3600"\nlicence')
    mapping = read_mapping(put("slide.toml", text))
    with pytest.raises(
        RunError, match=r"force_n, velocity_m_s: not in a run of this motor; .* give it as a table \[motor\]"
    ):
        import_files([put("slide.txt", SLIDE)], mapping, tmp_path / "runs")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_every_mapping_that_ships_can_be_read(path):
    mapping = read_mapping(Path(path.stem))
    assert mapping.file.source
    assert mapping.file.licence


PUBLIC = {
    "emps": ("emps/DATA_EMPS.mat", ("velocity_m_s", 0.1275)),
    "dexpand": ("dexpand/RVE_air_PDLT_steady_states_designconditions.csv", ("speed_rpm", 3281.15)),
    "pneumatic_cylinder": ("pneumatic_cylinder/friction/Circle_4bar.csv", ("pressure_bar_gauge", 4.08)),
    "ball_drops": ("ball_drops/Ball_drops_data.xls", ("velocity_m_s", 25.8)),
}


@pytest.mark.parametrize("name", PUBLIC)
def test_the_public_data_sets_become_recordings(name, tmp_path):
    file, (column, highest) = PUBLIC[name]
    if not (RECORDINGS / file).exists():
        pytest.skip(f"{file} is not here; SPINBENCH_RECORDINGS says where the public data sets are")
    folder = import_files([RECORDINGS / file], read_mapping(Path(name)), tmp_path / name)
    recording = read_recording(folder)
    values = recording.files[0].columns[column].values
    assert np.nanmax(values) == pytest.approx(highest, rel=0.01)


TIMED = """
[columns.time_s]
column = "t"
unit = "s"
[columns.pressure_bar_abs]
column = "p"
unit = "bar abs"
[columns.speed_rpm]
column = "n"
unit = "rpm"
"""


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0;2;300\n1;2;200\n;2;150\n3;2;100", "line 4: time_s is empty"),
        ("0;2;300\n\n1;2;200\n1;2;150", "line 5: time_s does not increase from the row before"),
        ("0;2;300\n2;2;200\n1;2;150", "line 4: time_s does not increase"),
        ("0;2;300\n1000000000000;2;200", "line 3: time_s is 1e.12 s; is its unit right"),
        ("0;2;-300\n1;2;-200", "line 2: speed_rpm is -300 rpm; .* factor = -1"),
    ],
)
def test_a_run_in_time_whose_rows_have_no_order_is_refused(imported, tmp_path, rows, words):
    head = HEAD.replace('"steady"', '"transient"')
    with pytest.raises(RunError, match=words):
        imported(f"t;p;n\n{rows}\n", head, TIMED)
    assert not (tmp_path / "runs").exists()


def test_a_cell_is_found_by_its_line_whatever_is_empty_before_it(imported):
    with pytest.raises(RunError, match="line 5, column 'n': 'x' is not a number"):
        imported("t;p;n\n0;2;300\n\n\n1;2;x\n", HEAD, TIMED)


def test_data_of_the_motor_become_a_recording_where_one_is_asked_for(put, tmp_path):
    """With columns that no run has."""
    text = HEAD.replace('"ptm3600"', '"ptm3600"\n[ambient]\npressure_bar_abs = 1.013', 1)
    text = text.replace('kind = "steady"\n', "").replace("licence", 'kind = "steady"\nlicence')
    mapping = read_mapping(put("locked.toml", text + TIMED + '[columns.rotor_locked]\ncolumn = "l"\nunit = "0/1"\n'))
    csv = put("data.csv", "t;p;n;l\n0;2;394;0\n1;2;0;1\n")
    with pytest.raises(RunError, match="rotor_locked: not in a run of this motor; make a recording of it with -o"):
        import_files([csv], mapping, tmp_path / "runs")
    made = read_recording(import_files([csv], mapping, tmp_path / "new" / "recording", as_recording=True))
    assert list(made.files[0].columns["rotor_locked"].values) == [0.0, 1.0]
