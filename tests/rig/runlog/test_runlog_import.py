"""Other people's data: units are said and never guessed, and what is imported is what was there."""

import os
import re
import sys
import zipfile
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from configs import ConfigError
from rig.exchange.export import recording_of
from rig.exchange.importing import import_files, import_recording, import_table
from rig.exchange.mapping import FOLDER, read_mapping
from rig.exchange.units import known_units, unit_of
from rig.recording import RecordingError, read_recording
from rig.recording.units import UNITS
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
        ('"kPa gauge"', '"psig"', r"'psig' is not known; did you mean 'psi gauge'\? Known for pressure_bar_gauge: "),
        ('"kPa gauge"', '"PSI gauge"', r"'PSI gauge' is not known; did you mean 'psi gauge'\?"),
        ('"kPa gauge"', '"PSI"', r"'PSI' does not say absolute or gauge; write 'psi abs' or 'psi gauge'"),
        ('"kPa gauge"', '"psia"', r"'psia', read as 'psi abs', is a unit of absolute pressure, and pressure_bar_gauge"),
        ('"m3/h"', '"SCFM"', r"'SCFM' is not known; did you mean 'scfm'\?"),
        ('"m3/h"', '"SLPM"', r"did you mean 'sL/min'\?"),
        ('"m3/h"', '"liters/min"', r"did you mean 'L/min'\?"),
        ('"rad/s"', '"RPM"', r"did you mean 'rpm'\?"),
        ('"rad/s"', '"rads/s"', r"did you mean 'rad/s'\?"),
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
        ("28,578", "fast", r"data.csv, line 3, column 'Drehzahl': 'fast' is not a number.* rows = \[first, last\]"),
        ("2,64", "1.002,64", r"'1.002,64' is not a number, decimals with ',': its other marks part thousands; take"),
        ("Drehzahl", "Speed", r"no column is called 'Drehzahl'; there are 'Druck', 'Durchfluss', 'Speed'"),
        ("58,7;", "58,7;1;", r"data.csv, line 2: 4 cells, expected 3; is the delimiter right\?"),
        ("Durchfluss", "Druck", r"2 columns are called 'Druck'; give the place of one: column = 1 or 2"),
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


@pytest.mark.parametrize("factor", [1.0, 1.1])  # puts the gauge right
def test_pulses_and_standard_litres_are_brought_to_rpm_and_to_the_inlet(imported, factor):
    columns = COLUMNS.replace('"rad/s"', '"Hz"\npulses_per_rev = 20').replace(
        '"m3/h"', '"NL/min"\nfactor = 2.0\nstandard = {pressure_bar_abs = 1.01325, temperature_c = 0.0}'
    )
    columns = columns.replace('"kPa gauge"', f'"kPa gauge"\nfactor = {factor}')
    ambient = "[ambient]\npressure_bar_abs = 1.0\ntemperature_c = 20.0\n"
    run = imported("Druck;Durchfluss;Drehzahl\n100,0;50,0;131,6\n", columns=columns + ambient)
    read = dict(zip(run.samples["channel"], run.samples["value"], strict=True))
    assert read["speed_rpm"] == pytest.approx(394.8)
    assert read["pressure_bar_gauge"] == pytest.approx(factor)
    assert read["flow_l_min"] == pytest.approx(100.0 * (1.01325 / (1.0 + factor)) * (293.15 / 273.15))


def test_a_flow_whose_pressure_is_missing_is_told(put, tmp_path, spinbench_here):
    state = '"scfm"\nstandard = {pressure_bar_abs = 1.01325, temperature_c = 20.0}'
    head = HEAD + COLUMNS.replace('"m3/h"', state) + "[ambient]\npressure_bar_abs = 1.0\ntemperature_c = 20.0\n"
    put("m.toml", head)
    put("data.csv", "Druck;Durchfluss;Drehzahl\n50,0;1,5;20,0\n;<1,6;21,0\n;;22,0\n70,0;1,7;23,0\n")
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "m.toml", "-o", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = "data.csv, line 3, column 'Durchfluss': 1 left out: the flow's unit needs the inlet's pressure"
    assert told in done.stderr
    assert told in (tmp_path / "out" / "notes.txt").read_text()


def test_what_no_mean_is_made_of_is_told(put, tmp_path):
    files = '[[files]]\nfile = "data.csv"\nkind = "steady"\naverage_rows = 2\n'
    mapping = read_mapping(put("m.toml", HEAD + COLUMNS + files))
    csv = put(
        "data.csv", "Druck;Durchfluss;Drehzahl\n50,0;1,5;20,0\n51,0;;21,0\n60,0;1,6;22,0\n61,0;1,6;22,0\n9,0;1,6;9\n"
    )
    told = []
    import_files([csv], mapping, tmp_path / "out", as_recording=True, tell=told.append)
    assert [words.partition(": ")[2] for words in told] == [
        "left out at the end: 1 of the 2 rows that average_rows takes",
        "1 readings of flow_l_min left out: others that average_rows takes with them are missing or off scale",
    ]


@pytest.mark.parametrize(
    ("said", "csv", "seems"),
    [
        (";", "Druck,Durchfluss,Drehzahl\n58.7,2.64,24.3\n", ","),
        (",", "Druck;Durchfluss;Drehzahl\n58,7;2,64;24,3\n", ";"),
        (",", "Druck\tDurchfluss\tDrehzahl\n58.7\t2.64\t24.3\n", "\\t"),
        (" ", "Druck;Durchfluss;Drehzahl\n58.7;2.64;24.3\n", ";"),
    ],
)
def test_what_the_delimiter_seems_to_be_is_said(put, tmp_path, spinbench_here, said, csv, seems):
    (
        put("m.toml", HEAD.replace('decimal = ","', 'decimal = "."').replace('";"', f'"{said}"') + COLUMNS),
        put("data.csv", csv),
    )
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "m.toml", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert f"the delimiter seems to be '{seems}', and the mapping says '{said}'" in done.stderr


@pytest.mark.parametrize(
    ("named", "says"), [("nomap", "known here: ball_drops.toml"), ("emp", "did you mean 'emps.toml'?")]
)
def test_a_mapping_that_is_not_there_is_another_s_name_only_where_that_is_near(tmp_path, spinbench_here, named, says):
    done = spinbench_here("runs", "import", "data.csv", "--mapping", named, cwd=tmp_path)
    assert done.returncode == 2
    assert f"{named}.toml: no such file; {says}" in done.stderr


def test_a_place_that_is_taken_is_named(put, tmp_path, spinbench_here):
    put("m.toml", HEAD + COLUMNS), put("data.csv", CSV)
    (tmp_path / "out_log").mkdir()
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "m.toml", "-o", "out_log", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "spinbench: out_log: exists already; nothing is overwritten, give a name that is free\n"


def test_a_transient_with_clock_times_over_midnight_becomes_a_capture(imported):
    columns = COLUMNS + '[columns.time_s]\ncolumn = "Zeit"\nunit = "hh:mm:ss"\n'
    csv = "Zeit;Druck;Durchfluss;Drehzahl\n23:59:59;100,0;1,0;40,0\n00:00:00,5;0,0;0,5;20,0\n"
    run = imported(csv, head=HEAD.replace("steady", "transient"), columns=columns)
    (file,) = recording_of(run).recording.files
    assert (file.file, file.kind, list(file.columns["time_s"].values)) == ("coast_down.csv", "transient", [0.0, 1.5])


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


def test_a_supply_that_was_told_within_averaged_rows_is_kept(put, tmp_path):
    flag = '[columns.supply_open]\ncolumn = 4\nunit = "0/1"\n[[files]]'
    entry = AXIS.rpartition("[[files]]")[2].replace('name = "second"\nstart_s = 10.0\nrows = [4, 7]\n', "")
    mapping = read_mapping(put("slide.toml", AXIS.partition("[[files]]")[0] + flag + entry))
    rows = [f"{100 * i}\t{-10 * i}\t1\t{flag}" for i, flag in enumerate(["1", "", "", "", "0", ""])]
    folder = import_files([put("slide.txt", "\n".join(rows) + "\n")], mapping, tmp_path / "recording")
    assert list(read_recording(folder).files[0].columns["supply_open"].values) == [1.0, 1.0, 0.0]


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


# What loggers write


SIMPLE = """
[columns.pressure_bar_abs]
column = "P"
unit = "bar abs"
[columns.speed_rpm]
column = "n"
unit = "rpm"
"""
CLOCKED = '[columns.time_s]\ncolumn = "t"\nunit = "{}"\n'


@pytest.fixture
def columns_of(put, tmp_path):
    """Imports a table as a recording; returned are its columns of values and what was told."""

    def run(csv, columns, head=HEAD, name="data.csv"):
        told = []
        mapping = read_mapping(put("elsewhere.toml", head + columns))
        folder = import_recording([put(name, csv)], mapping, tmp_path / "recording", told.append)
        (file,) = read_recording(folder).files
        return {key: one.values.tolist() for key, one in file.columns.items()}, told, file

    return run


@pytest.mark.parametrize("mark", ["OL", "ol", "9.9E37", "9.99999999e+37", "1.#INF"])
def test_where_the_range_ended_there_is_no_number_and_it_is_said(columns_of, mark):
    head = HEAD.replace('decimal = ","', 'decimal = "."')
    found, told, _ = columns_of(f"P;n\n2.0;397\n2.1;{mark}\n", SIMPLE, head)
    np.testing.assert_equal(found["speed_rpm"], [397.0, np.nan])
    assert len(told) == 1 and "column 'n': over range 1 times, taken as missing" in told[0] and "highest" in told[0]


def test_over_range_is_more_than_the_highest_that_the_instrument_shows(columns_of):
    columns = SIMPLE.replace('unit = "rpm"', 'unit = "rad/s"\nhighest = 60.0')
    found, told, file = columns_of("P;n\n2,0;41,5\n2,1;OL\n", columns)
    assert found["speed_rpm"][1] == pytest.approx(60.0 * 30.0 / np.pi)
    assert file.columns["speed_rpm"].censor.tolist() == [0, 1]
    assert told == [f"{told[0].partition(',')[0]}, column 'n': over range 1 times, taken as more than 60 rad/s"]


@pytest.mark.parametrize("mark", ["NaN", "----", "1.#QNAN", "9.91E37", "***", "n/a"])
def test_what_is_no_reading_is_missing_and_counted(columns_of, mark):
    head = HEAD.replace('decimal = ","', 'decimal = "."')
    found, told, _ = columns_of(f"P;n\n2.0;397\n2.1;{mark}\n2.1;{mark}\n", SIMPLE, head)
    np.testing.assert_equal(found["speed_rpm"], [397.0, np.nan, np.nan])
    assert told == [f"{told[0].partition(',')[0]}, column 'n': no reading 2 times ('{mark}'), taken as missing"]


def test_other_marks_are_said_in_the_mapping_and_a_word_that_is_none_is_refused(columns_of):
    with pytest.raises(RunError, match=r"line 3, column 'n': 'kaputt' is not a number"):
        columns_of("P;n\n2,0;397\n2,1;kaputt\n", SIMPLE)
    found, _, _ = columns_of("P;n\n2,0;397\n2,1;kaputt\n", SIMPLE, HEAD + 'invalid = ["kaputt"]\n')
    np.testing.assert_equal(found["speed_rpm"], [397.0, np.nan])


TIMES = {
    "comma": ("hh:mm:ss", ["12:00:00,250", "12:00:00,500"], 0.25),
    "noon": ("hh:mm:ss", ["11:59:59 AM", "12:00:00 PM"], 1.0),
    "midnight": ("hh:mm:ss", ["11:59:59 p.m.", "12:00:00 a.m."], 1.0),
    "hour 24": ("hh:mm:ss", ["23:59:58", "24:00:00"], 2.0),
    "german": ("D.M.Y h:m:s", ["31.12.2023 23:59:59", "01.01.2024 00:00:01,5"], 2.5),
    "american": ("M/D/Y h:m:s", ["2/28/2024 11:59:59 PM", "2/29/2024 12:00:00 AM"], 1.0),
    "slashes": ("Y-M-D h:m:s", ["2023/12/31 12:00:00", "2023/12/31 12:00:10"], 10.0),
    "iso": ("ISO", ["2023-12-31T12:00:00,5", "2023-12-31T12:00:01"], 0.5),
    "zone": ("ISO", ["2023-10-29T02:59:59+02:00", "2023-10-29T02:00:00+01:00"], 1.0),
    "excel": ("Excel days", ["45291,5", "45291,75"], 21_600.0),
}


@pytest.mark.parametrize("name", TIMES)
def test_times_are_read_as_loggers_write_them(columns_of, name):
    unit, (first, second), apart = TIMES[name]
    found, _, _ = columns_of(f"t;P;n\n{first};2,0;397\n{second};2,1;398\n", SIMPLE + CLOCKED.format(unit))
    assert found["time_s"] == pytest.approx([0.0, apart], abs=1e-5)


NO_TIMES = {
    "13 PM": ("hh:mm:ss", "13:00:00 PM"),
    "0 AM": ("hh:mm:ss", "00:10:00 AM"),
    "hour 25": ("hh:mm:ss", "25:00:00"),
    "month 13": ("D.M.Y h:m:s", "01.13.2023 10:00:00"),
    "no time": ("D.M.Y h:m:s", "01.12.2023"),
    "empty": ("Excel days", ""),
}


@pytest.mark.parametrize("name", NO_TIMES)
def test_what_is_no_time_is_refused_with_its_place(columns_of, name):
    unit, cell = NO_TIMES[name]
    with pytest.raises(RunError, match=r"data.csv, line 3, column 't'.* is not a time"):
        columns_of(f"t;P;n\n{TIMES_BEFORE[unit]};2,0;397\n{cell};2,1;398\n", SIMPLE + CLOCKED.format(unit))


def test_a_decimal_comma_where_points_were_said_is_told(columns_of):
    with pytest.raises(RunError, match=r"'397,5' is not a number.* it has a decimal comma; say decimal"):
        columns_of("P;n\n2.0;397,5\n", SIMPLE, HEAD.replace('decimal = ","', 'decimal = "."'))


def test_a_mean_below_the_rows_is_refused_with_how_to_leave_it_out(columns_of):
    with pytest.raises(RunError, match=r"line 3.*'Mittelwert' is not a time .*rows = \[first, last\] in \[\[files\]\]"):
        columns_of("t;P;n\n00:00:01;2,0;397\nMittelwert;2,1;398\n", SIMPLE + CLOCKED.format("hh:mm:ss"))


TIMES_BEFORE = {"hh:mm:ss": "00:00:01", "D.M.Y h:m:s": "01.01.2023 00:00:00", "Excel days": "45291,5"}


def test_a_date_and_a_time_in_two_columns_are_one(columns_of):
    columns = SIMPLE + '[columns.time_s]\ncolumn = ["Datum", "Zeit"]\nunit = "D.M.Y h:m:s"\n'
    csv = "Datum;Zeit;P;n\n31.12.2023;23:59:59;2,0;397\n01.01.2024;00:00:01;2,1;398\n"
    assert columns_of(csv, columns)[0]["time_s"] == [0.0, 2.0]


def test_a_clock_that_is_set_back_is_refused_with_its_line(columns_of):
    csv = "t;P;n\n2023-10-29T02:59:59;2,0;397\n2023-10-29T02:00:00;2,1;398\n"
    with pytest.raises(RunError, match=r"data.csv, line 3, column 't': the clock goes back by 3599 s.*summer time"):
        columns_of(csv, SIMPLE + CLOCKED.format("ISO"))


def test_a_source_without_times_has_a_period(columns_of):
    columns = SIMPLE + "[columns.time_s]\nsample_period_s = 0.25\n"
    assert columns_of("P;n\n2,0;397\n2,0;390\n2,0;380\n", columns)[0]["time_s"] == [0.0, 0.25, 0.5]


def test_a_value_that_the_logger_held_is_no_reading(columns_of):
    columns = SIMPLE.replace('unit = "rpm"', 'unit = "rpm"\ndrop_repeats = true')
    found, _, _ = columns_of("P;n\n2,0;397\n2,0;397\n2,0;390\n2,0;390\n2,0;397\n", columns)
    np.testing.assert_equal(found["speed_rpm"], [397.0, np.nan, 390.0, np.nan, 397.0])
    assert found["pressure_bar_abs"] == [2.0] * 5


@pytest.mark.parametrize(("unit", "factor"), [("kg/h", 1.0), ("g/s", 3.6), ("kg/s", 3600.0)])
def test_a_flow_of_mass_is_a_volume_at_the_inlet_s_state(columns_of, unit, factor):
    columns = SIMPLE + f'[columns.flow_l_min]\ncolumn = "Q"\nunit = "{unit}"\n'
    head = HEAD + "[ambient]\npressure_bar_abs = 1.0\ntemperature_c = 20.0\n"
    head, ambient = head.split("[ambient]")[0], "[ambient]" + head.split("[ambient]")[1]
    csv = f"P;Q;n\n2,0;{10.0 / factor:.9f};397\n".replace(".", ",")
    found, _, _ = columns_of(csv, columns + ambient, head)
    density = 2.0e5 / (287.05 * 293.15)
    assert found["flow_l_min"][0] == pytest.approx(10.0 / 3600.0 / density * 6e4, rel=1e-4)


# Tables that are not quite


def test_any_number_of_spaces_parts_columns_and_a_short_row_is_refused(columns_of):
    head = HEAD.replace('";"', '" "')
    found, _, _ = columns_of("   P     n\n 2,0   397\n 2,1    40\n", SIMPLE, head)
    assert (found["pressure_bar_abs"], found["speed_rpm"]) == ([2.0, 2.1], [397.0, 40.0])
    with pytest.raises(
        RunError, match=r"line 3: 1 cells, expected 2; where spaces part the columns, none can be empty"
    ):
        columns_of("   P     n\n 2,0   397\n         40\n", SIMPLE, head)


def test_a_row_that_was_cut_off_is_refused_where_a_column_is_taken(columns_of):
    with pytest.raises(RunError, match=r"line 3: 1 cells, and column 2 \('n'\) is not among them"):
        columns_of("P;n;remark\n2,0;397;a\n2,1\n", SIMPLE)
    assert columns_of("P;n;remark\n2,0;397\n2,1;398;b\n", SIMPLE)[0]["speed_rpm"] == [397.0, 398.0]


def test_what_stands_before_the_headings_may_hold_any_marks(columns_of):
    preamble = 'Comment: hose 3/4"\n"unfinished\n'
    assert columns_of(f"{preamble}P;n\n2,0;397\n", SIMPLE, HEAD + "heading_line = 3\n")[0]["speed_rpm"] == [397.0]
    with pytest.raises(RunError, match=r"data.csv, line 2: not a row of CSV"):
        columns_of('P;n\n2,0;"397\n', SIMPLE)


def test_a_column_that_is_taken_and_holds_no_number_is_told(columns_of):
    columns = SIMPLE + '[columns.flow_l_min]\ncolumn = "Q"\nunit = "L/min"\n'
    found, told, _ = columns_of("P;Q;n\n2,0;;397\n", columns)
    assert "flow_l_min" not in found
    assert len(told) == 1 and told[0].endswith("column 'Q': no number in it, so there is no flow_l_min")


def test_a_mistake_names_the_line_and_the_column_of_the_source(put, tmp_path):
    mapping = read_mapping(put("elsewhere.toml", HEAD + "heading_line = 2\n" + SIMPLE))
    source = put("data.csv", "a bench\nP;n\n2,0;397\n\n548,2;398\n")
    for make in (import_recording, import_table):
        with pytest.raises(RecordingError, match=r"data.csv, line 5, column pressure_bar_abs: '548.2'"):
            make([source], mapping, tmp_path / "out")
        assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def waveforms(path, **starts):
    """A TDMS file of two waveforms of 5 samples in steps of 10 ms; each starts so many seconds late."""
    nptdms = pytest.importorskip("nptdms", reason="npTDMS is not installed")
    begin = np.datetime64("2024-05-01T10:00:00")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "g", name, 2.0 + np.arange(5.0),
                    {"wf_start_time": begin + np.timedelta64(int(1000 * late), "ms"), "wf_increment": 0.01},
                )
                for name, late in starts.items()
            ]
        )  # fmt: skip


TDMS = HEAD.replace('"csv"\ndelimiter = ";"\ndecimal = ","', '"tdms"')


def test_waveforms_on_one_clock_are_rows_and_on_two_are_refused(put, tmp_path):
    mapping = read_mapping(put("labview.toml", TDMS + SIMPLE + CLOCKED.format("s").replace('"t"', '"@time"')))
    waveforms(tmp_path / "one.tdms", P=0.0, n=0.0)
    (file,) = read_recording(import_recording([tmp_path / "one.tdms"], mapping, tmp_path / "one")).files
    assert file.columns["time_s"].values == pytest.approx(0.01 * np.arange(5))
    waveforms(tmp_path / "two.tdms", P=0.0, n=0.5)
    with pytest.raises(RunError, match=r"two clocks: 'P' from 2024-05-01T10:00:00.0* .* and 'n' from .*10:00:00.5"):
        import_recording([tmp_path / "two.tdms"], mapping, tmp_path / "two")


def test_a_channel_that_is_not_taken_may_have_another_clock(put, tmp_path):
    mapping = read_mapping(put("labview.toml", TDMS + SIMPLE + CLOCKED.format("s").replace('"t"', '"@time"')))
    waveforms(tmp_path / "data.tdms", room=0.25, P=0.0, n=0.0)
    (file,) = read_recording(import_recording([tmp_path / "data.tdms"], mapping, tmp_path / "out")).files
    assert set(file.columns) == {"time_s", "pressure_bar_abs", "speed_rpm"}


CASES = SHARED / "cases"
OF_CASES = {
    "space_columns": {"pressure_bar_abs": [1.6, 1.8, 2.0, 2.2, 2.4], "flow_l_min": [44.0, 57.0, 73.0, 89.0, 104.0]},
    "marks_ol": {"speed_rpm": [397.1, np.nan, 396.9]},
    "marks_nan": {"speed_rpm": [397.1, np.nan, 396.9]},
    "time_ampm": {"time_s": [0.0, 1.0, 2.0]},
    "time_comma": {"time_s": [0.0, 0.25]},
    "quoted_preamble": {"speed_rpm": [397.1]},
    "empty_column": {"speed_rpm": [232.3, 316.5, 397.1]},
    "negative_zero": {"speed_rpm": [0.0, 397.2]},
}


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not beside the repository")
@pytest.mark.parametrize("case", OF_CASES)
def test_a_case_after_a_public_report_is_read_as_it_should_be(case, tmp_path):
    (source,) = (path for path in (CASES / case).iterdir() if path.suffix != ".toml")
    (mapping,) = (CASES / case).glob("*.toml")
    (file,) = read_recording(import_recording([source], read_mapping(mapping), tmp_path / "out")).files
    for name, values in OF_CASES[case].items():
        np.testing.assert_allclose(file.columns[name].values[: len(values)], values)


# Files of any bytes


def read_or_refused(folder):
    """Import `data` there; what is refused is refused in words, and leaves nothing behind."""
    try:
        import_recording([folder / "data"], read_mapping(folder / "elsewhere.toml"), folder / "out")
    except (RunError, RecordingError) as error:
        assert str(error)
        assert not (folder / "out").exists()


@pytest.mark.parametrize("reader", ["csv", "xlsx"])
@hypothesis.given(data=st.data())
def test_no_file_ends_in_anything_but_a_sentence(reader, data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any")
    cells = st.sampled_from(
        ["2,0", "397", "", "OL", "NaN", '"', "\n", ";", "1e400", "-5", "12:00:00", "\x00", "٣", "="]
    )
    text = st.lists(cells, max_size=30).map(lambda parts: ("P;n\n" + ";".join(parts)).encode())
    content = data.draw(st.one_of(text, st.binary(max_size=200)))
    head = HEAD if reader == "csv" else TDMS.replace("tdms", reader)
    (folder / "elsewhere.toml").write_text(head + ('sheet = "a"\n' if reader == "xlsx" else "") + SIMPLE)
    (folder / "data").write_bytes(content)
    read_or_refused(folder)
