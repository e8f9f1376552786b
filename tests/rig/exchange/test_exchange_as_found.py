"""Tables as loggers and offices leave them: nothing is lost, moved or made up without a word; or it is refused."""

import os
import zipfile

import h5py
import numpy as np
import pytest
from asammdf import MDF, Signal
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.exchange.guess.proposal import propose
from rig.runlog import RunWriter
from tests.rig.runlog.test_runlog_import import CLOCKED, HEAD, SIMPLE, put, workbook  # noqa: F401 - a fixture

ROWS = "2,0;397,1\n2,2;450,2\n2,4;500,3\n"
LABELLED = "No;P;n\n1;2,0;397,1\n2;2,2;450,2\n3;2,4;500,3\nMean;2,2;449,2\n"


@pytest.fixture
def given(put, tmp_path, spinbench_here):  # noqa: F811 - the fixture
    """Imports a file by the command; returned are its exit code, what it said, and the table that it made, if any."""

    def run(content, columns=SIMPLE, reader="csv", more=""):
        head = HEAD
        if reader != "csv":
            head = head.replace('"csv"\ndelimiter = ";"\ndecimal = ","', f'"{reader}"')
        put("map.toml", head + more + columns)
        source = tmp_path / f"data.{reader}"
        content(source) if callable(content) else put(source.name, content)
        out = tmp_path / f"out{len(list(tmp_path.glob('out*')))}"
        done = spinbench_here("runs", "import", source.name, "--mapping", "map.toml", "-o", out, cwd=tmp_path)
        made = out / "data.csv"
        assert made.is_file() == out.exists() == (done.returncode == 0)
        return done.returncode, done.stderr, made.read_text() if made.is_file() else ""

    return run


REFUSED = {
    "rows in quotation marks": (
        'P;n;note\n2,0;397;"hose a\n2,2;450;\n2,4;500;b"\n2,6;550;\n',
        "",
        "data.csv, line 2: a cell in quotation marks holds what follows down to line 4; is a mark missing?",
    ),
    "milliseconds as a date": (
        "t;P;n\n1712050400123;2,0;397\n1712050401123;2,0;398\n",
        "ISO",
        "data.csv, line 2, column 't': '1712050400123' is not a time (ISO)",
    ),
    "an offset from UTC in some rows": (
        "t;P;n\n2024-05-01T10:00:00+02:00;2,0;397\n2024-05-01T08:00:01;2,0;398\n",
        "ISO",
        "data.csv, line 3, column 't': '2024-05-01T08:00:01' and '2024-05-01T10:00:00+02:00' before it: one tells its",
    ),
    "a year of three digits": ("t;P;n\n13.06.224 10:00:00;2,0;397\n", "D.M.Y h:m:s", "data.csv, line 2, column 't'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_read_wrongly_is_refused_with_its_line(given, name):
    content, unit, words = REFUSED[name]
    code, said, _ = given(content, SIMPLE + (CLOCKED.format(unit) if unit else ""))
    assert (code, words in said) == (2, True), said
    assert "Traceback" not in said


def test_a_remark_over_two_lines_loses_no_row(given):
    code, _, made = given('P;n;note\n2,0;397;"hose a\nhose b"\n2,2;450;\n')
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", "2.2,450.0"])


@pytest.mark.parametrize("mark", ["\x0c", "\x85", "\u2028", "\x1c"])
def test_a_line_ends_where_the_logger_ended_it(given, mark):
    code, _, made = given(f"P;n;note\n2,0;397;a{mark}b\n2,2;450;\n")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", "2.2,450.0"])
    code, said, _ = given(f"P;n;note\n2,0;397;a{mark}b\n2,2;kaputt;\n")
    assert (code, "line 3, column 'n'" in said) == (2, True)


def test_a_row_that_is_called_something_is_told(given):
    code, said, _ = given(LABELLED)
    assert (code, "line 5, column 1: 'Mean' among numbers" in said) == (0, True)


def test_a_row_that_is_called_something_is_left_out_as_it_is_told(given):
    files = '[[files]]\nfile = "data.csv"\nkind = "steady"\nrows = [1, 3]\n'
    code, said, made = given(LABELLED, SIMPLE + files)
    assert (code, said, len(made.splitlines())) == (0, "", 4)


def test_a_number_that_the_file_s_end_cuts_is_told(given):
    assert "line 4: '50' ends the file without a line's end" in given("P;n\n" + ROWS[:-4])[1]


@pytest.mark.parametrize("ending", ["", "\n"])
def test_a_file_that_ends_as_its_rows_do_is_not_suspected(given, ending):
    assert given("P;n\n" + ROWS.rstrip("\n") + ending)[:2] == (0, "")


def sheet(cell, more=""):
    """A workbook of two rows whose pressure in the second is a cell as it stands in the file."""

    def write(path):
        rows = [
            '<c r="A1" t="inlineStr"><is><t>P</t><rPh sb="0" eb="1"><t>kana</t></rPh></is></c>'
            '<c r="B1" t="inlineStr"><is><r><t>n</t></r></is></c>',
            '<c r="A2"><v>2.0</v></c><c r="B2"><v>397</v></c>',
            f'{cell}<c r="B3"><v>450</v></c>',
        ]
        text = "".join(f'<row r="{number}">{row}</row>' for number, row in enumerate(rows, start=1))
        workbook(path, f"<worksheet MAIN><sheetData>{text}</sheetData>{more}</worksheet>")

    return write


MERGED = '<mergeCells count="1"><mergeCell ref="A2:A3"/></mergeCells>'


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (sheet('<c r="A3"><f>A2*1.1</f></c>'), "line 3, column 'P': '=A2*1.1' is not a number"),
        (sheet('<c r="A3" t="b"><v>1</v></c>'), "line 3, column 'P': 'TRUE' is not a number"),
        (sheet('<c r="A3" t="b"><f>A2&gt;1</f></c>'), "line 3, column 'P': '=A2>1' is not a number"),
        (sheet('<c r="A3"/>', MERGED), "line 3, column 'P': 'merged with A2' is not a number"),
    ],
)
def test_a_cell_of_a_workbook_that_looks_empty_and_is_not_is_refused(given, write, words):
    code, said, _ = given(write, reader="xlsx", more='sheet = "one"\n')
    assert (code, words in said) == (2, True), said


def test_a_formula_that_gave_an_empty_text_is_an_empty_cell_and_a_heading_is_read_without_how_it_is_said(given):
    code, _, made = given(
        sheet('<c r="A3" t="str"><f>IF(1,"","")</f><v></v></c>'), reader="xlsx", more='sheet = "one"\n'
    )
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", ",450.0"])


def test_a_yes_or_no_of_a_workbook_that_is_empty_is_an_empty_cell(given):
    code, _, made = given(sheet('<c r="A3" t="b"/>'), reader="xlsx", more='sheet = "one"\n')
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", ",450.0"])


def test_a_workbook_in_strict_open_xml_is_refused_as_what_it_is(given):
    def write(path):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("xl/_rels/workbook.xml.rels", "<R/>")
            archive.writestr("xl/workbook.xml", '<workbook xmlns="http://purl.oclc.org/ooxml/spreadsheetml/main"/>')

    code, said, _ = given(write, reader="xlsx", more='sheet = "one"\n')
    assert (code, "was it saved as Strict Open XML?" in said) == (2, True), said


@pytest.mark.parametrize(
    ("values", "attributes"),
    [
        (np.array([400.0, 9999.0, 380.0]), {"valid_range": [0.0, 2000.0]}),
        (np.array([400, 9999, 380]), {"valid_max": 2000}),
        (np.float32([400.0, 0.1, 380.0]), {"missing_value": 0.1}),
    ],
)
def test_what_an_hdf5_file_calls_no_value_is_missing_and_told(given, values, attributes):
    def write(path):
        with h5py.File(path, "w") as file:
            file["P"], file["n"] = [2.0, 2.1, 2.2], values
            file["n"].attrs.update(attributes)

    code, said, made = given(write, reader="hdf5")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,400.0", "2.1,", "2.2,380.0"])
    assert "column 'n': no reading 1 times ('nan'), taken as missing" in said


UNWRITTEN = {
    "chunks": ({"chunks": (2,)}, {0: 400.0, 1: 390.0, 4: 370.0}, ["400.0", "390.0", "", "", "370.0", "0.0"]),
    "a stated fill value": (
        {"chunks": (4,), "fillvalue": -1.0}, {0: 400.0, 4: 390.0}, ["400.0", "", "", "", "390.0", ""]
    ),
    "a 0 that was written": ({"chunks": (6,)}, {0: 400.0, 5: 390.0}, ["400.0", "0.0", "0.0", "0.0", "0.0", "390.0"]),
}  # fmt: skip


@pytest.mark.parametrize("name", UNWRITTEN)
def test_what_was_never_written_into_an_hdf5_file_is_missing(given, name):
    options, written, cells = UNWRITTEN[name]

    def write(path):
        with h5py.File(path, "w") as file:
            file["P"] = np.full(6, 2.0)
            data = file.create_dataset("n", (6,), "f8", **options)
            for at, value in written.items():
                data[at] = value

    code, said, made = given(write, reader="hdf5")
    assert (code, [line.partition(",")[2] for line in made.splitlines()[1:]]) == (0, cells)
    assert ("'n': 2 of 6 values were never written" in said) == (name == "chunks")


@pytest.mark.parametrize("options", [{}, {"chunks": (2,)}])
def test_an_hdf5_column_that_was_never_written_is_told(given, options):
    def write(path):
        with h5py.File(path, "w") as file:
            file["P"] = np.full(6, 2.0)
            file.create_dataset("n", (6,), "f8", **options)

    code, said, _ = given(write, reader="hdf5")
    assert (code, "'n': 6 of 6 values were never written" in said) == (2, True), said


def test_a_sample_that_an_mdf_file_marks_as_invalid_is_told(given):
    def write(path):
        time, invalid = np.arange(3.0), np.array([False, True, False])
        with MDF(version="4.10") as file:
            file.append(
                [
                    Signal(np.array([2.0, 2.1, 2.2]), time, name="P"),
                    Signal(np.array([400.0, 390.0, 380.0]), time, name="n", invalidation_bits=invalid),
                ]
            )
            file.save(path.with_suffix(".mf4"))
        path.with_suffix(".mf4").rename(path)

    code, said, made = given(write, reader="mdf")
    assert (code, made.splitlines()[2]) == (0, "2.1,")
    assert "column 'n': no reading 1 times" in said


@pytest.mark.parametrize(("stated", "told"), [("Volts", True), ("mmHg", True), ("-", False), ("bar", False)])
def test_a_unit_that_the_import_does_not_know_is_told_too(given, stated, told):
    def write(path):
        channels = [ChannelObject("g", "P", np.array([2.0, 2.1]), {"unit_string": stated})]
        with TdmsWriter(path) as writer:
            writer.write_segment([*channels, ChannelObject("g", "n", np.array([397.0, 400.0]), {})])

    code, said, _ = given(write, reader="tdms")
    assert (code, f"'P': the file says '{stated}', the mapping 'bar abs'" in said) == (0, told)


@pytest.mark.parametrize("other", [np.arange(7.0), np.arange(2.0) + 1j])
def test_a_matlab_vector_that_is_not_taken_may_be_anything(given, other):
    code, _, made = given(lambda path: savemat(path, {"P": [2.0, 2.1], "n": [397.0, 400.0], "x": other}), reader="mat")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", "2.1,400.0"])


HOBO = """"Plot Title: bench"
"#","Date Time, GMT+02:00","Pressure, kPa","Host Connected"
1,05/13/24 10:00:00 AM,201.3,
2,05/13/24 10:00:01 AM,201.4,
"""


def test_a_date_of_two_digit_parts_is_proposed_as_one_of_several(put):  # noqa: F811 - the fixture
    for date, units in (("13.06.24", "Y-M-D h:m:s or D.M.Y"), ("05.06.24", "Y-M-D h:m:s or D.M.Y h:m:s or M/D/Y")):
        text = propose(put("data.csv", f"t;P [bar(a)]\n{date} 10:00:00;2,0\n{date} 10:00:01;2,1\n"))
        assert "# Unsure: which is the year, which the month, and which the day?\n# [columns.time_s]\n" in text
        assert f'# unit = "{units}' in text


def test_a_heading_may_hold_something_like_a_time(put):  # noqa: F811 - the fixture
    text = propose(put("data.csv", HOBO))
    assert "heading_line = 2\n" in text
    assert 'column = "Date Time, GMT+02:00"\nunit = "M/D/Y h:m:s"\n' in text


@pytest.mark.parametrize("cell", ["1 397,1", "1\xa0397,1", "\u22121,1"])
def test_a_number_that_cannot_be_read_does_not_hide_the_delimiter(put, cell):  # noqa: F811 - the fixture
    text = propose(put("data.csv", f"P [bar(a)];n [1/min]\n2,0;{cell}\n2,2;{cell}\n"))
    assert 'delimiter = ";"\ndecimal = ","\n' in text
    assert f"'n [1/min]': such as '{cell}'" in text.replace("\\xa0", "\xa0")


def test_marks_for_thousands_make_the_decimal_mark_unsure(put):  # noqa: F811 - the fixture
    text = propose(put("data.csv", "P [bar(a)];n [1/min]\n2.0;1,397\n2.2;1,450\n"))
    assert "# Unsure: some numbers have the one and some the other; does one part thousands?\n# decimal = " in text


@pytest.mark.parametrize(
    ("rows", "jump"),
    [
        (["2024-03-31T01:59:58", "2024-03-31T01:59:59", "2024-03-31T03:00:00", "2024-03-31T03:00:01"], "3601 s"),
        (["1904-01-01T00:00:00", "1904-01-01T00:00:01", "2024-06-13T10:00:00", "2024-06-13T10:00:01"], "3.80112e+09 s"),
        (["2024-03-31T01:59:58", "2024-03-31T01:59:59", "2024-03-31T02:00:30", "2024-03-31T02:00:31"], ""),
    ],
)
def test_a_clock_that_was_set_forward_in_a_run_is_told(given, rows, jump):
    files = '[[files]]\nfile = "data.csv"\nkind = "transient"\n'
    csv = "t;P;n\n" + "".join(f"{row};2,0;397\n" for row in rows)
    code, said, _ = given(csv, SIMPLE + CLOCKED.format("ISO") + files)
    assert (code, f"line 4: {jump} after the row before, where 1 s are usual" in said) == (0, bool(jump)), said


@pytest.mark.parametrize(
    ("heading", "told"),
    [("[kPa]", True), ("(bar gauge)", True), ("[bar]", False), ("(bar(a))", False), ("(CH1)", False)],
)
def test_a_unit_in_a_heading_that_is_another_than_the_mapping_s_is_told(given, heading, told):
    columns = SIMPLE.replace('"P"', f'"P {heading}"')
    code, said, _ = given(f"P {heading};n\n2,0;397\n", columns)
    assert (code, "the file says" in said) == (0, told), said


def test_a_factor_multiplies_the_source_s_number_before_the_unit_s_zero_counts(given):
    tenths = '[columns.inlet_temperature_c]\ncolumn = "T"\nunit = "degF"\nfactor = 0.1\nhighest = 680\n'
    code, said, made = given("P;n;T\n2,0;397;680\n2,2;450;500\n", SIMPLE + tenths)
    cells = [float(row.split(",")[2]) for row in made.splitlines()[1:]]
    assert (code, said, cells) == (0, "", pytest.approx([20.0, 10.0]))


def test_no_rate_is_made_of_what_is_off_scale(given):
    files = '[[files]]\nfile = "data.csv"\nkind = "transient"\n'
    turned = SIMPLE.replace('"n"\nunit = "rpm"', '"a"\nunit = "rev"\ndifferentiate = true\nhighest = 20')
    clock = "[columns.time_s]\nsample_period_s = 1.0\n"
    code, said, made = given("P;a\n2,0;0\n2,0;10\n2,0;OL\n2,0;OL\n2,0;20\n2,0;20\n", turned + clock + files)
    assert (code, "3 rates of speed_rpm left out: a value that they are made of is off scale" in said) == (0, True), (
        said
    )
    assert [row.split(",")[1] for row in made.splitlines()[1:]] == ["", "600.0", "", "", "", "0.0"]


def full(writer, row):
    writer._failure = (
        f"{writer.folder / 'plateaus.csv'}: cannot be written (No space left on device); the run ends here"
    )
    writer._check()


def interrupted(writer, row):
    raise KeyboardInterrupt


FAILS = {
    "a full disk": (full, 2, "No space left on device); the run ends here; no run was made\n"),
    "Ctrl-C": (interrupted, 130, "interrupted; nothing was imported\n"),
}


@pytest.mark.parametrize("name", FAILS)
def test_half_a_run_is_not_there(put, tmp_path, spinbench_here, monkeypatch, name):  # noqa: F811 - the fixture
    fails, code, said = FAILS[name]
    put("map.toml", HEAD + SIMPLE), put("data.csv", "P;n\n" + ROWS)
    monkeypatch.setattr(RunWriter, "plateau", fails)
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "map.toml", "--logs", "logs", cwd=tmp_path)
    assert (done.returncode, done.stderr.endswith(said), done.stderr.count("\n")) == (code, True, 1), done.stderr
    assert list((tmp_path / "logs").iterdir()) == []
    assert ".spinbench-" not in done.stderr


@pytest.mark.parametrize("out", ["bar", "in", "r"])
def test_an_error_is_whole_whatever_the_recording_is_to_be_called(put, tmp_path, spinbench_here, out):  # noqa: F811
    columns = SIMPLE.replace("bar_abs", "bar_gauge").replace("bar abs", "bar gauge")
    put("map.toml", HEAD + columns), put("data.csv", "P;n\n2,0;397\n-900;450\n")
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "map.toml", "-o", out, cwd=tmp_path)
    told = "data.csv, line 3, column pressure_bar_gauge: '-900.0': expected gauge inlet pressure, -1.1 to 40 bar; check"
    assert (done.returncode, done.stderr) == (2, f"spinbench: {told} the unit and the reading\n")
    put("map.toml", HEAD + columns + "[ambient]\npressure_bar_abs = 17.0\n"), put("data.csv", "P;n\n2,0;397\n")
    done = spinbench_here("runs", "import", "data.csv", "--mapping", "map.toml", "-o", out, cwd=tmp_path)
    assert (done.returncode, "map.toml" in done.stderr, "bar" in done.stderr) == (2, True, True), done.stderr


@pytest.mark.parametrize(
    ("name", "told"),
    [(b"caf\xe9.csv", r"caf\udce9.csv"), (b"a\x1b[31m.csv", r"a\x1b[31m.csv"), (b"a\nb.csv", r"a\nb.csv")],
)
def test_a_file_may_be_called_anything(put, tmp_path, spinbench_here, name, told):  # noqa: F811 - the fixture
    source = os.fsdecode(name)
    put("map.toml", HEAD + SIMPLE), put(source, "P;n\n2,0;397\n2,2;OL\n")
    done = spinbench_here("runs", "import", source, "--mapping", "map.toml", "-o", "out", cwd=tmp_path)
    assert (done.returncode, f"spinbench: {told}, column 'n': over range 1 times" in done.stderr) == (0, True), done
    assert f"imported with map.toml from {told}, SHA-256" in (tmp_path / "out" / "notes.txt").read_text()
    put(source, "P;n\n2,0;397\n2,2;kaputt\n")
    done = spinbench_here("runs", "import", source, "--mapping", "map.toml", "-o", "out2", cwd=tmp_path)
    assert (done.returncode, "line 3" in done.stderr, "\x1b" in done.stderr) == (2, True, False)


@pytest.mark.parametrize("factor", ["0.0", "1e308", "-1e-300"])
def test_a_factor_that_makes_no_reading_is_refused(given, factor):
    code, said, _ = given("P;n\n2,0;397\n", SIMPLE + f"factor = {factor}\n")
    assert (code, "columns.speed_rpm.factor" in said, "lies between 1e-12 and 1e12" in said) == (2, True, True), said


@pytest.mark.parametrize(("pressure", "words"), [("0", "0 bar abs"), ("-1,5", "-1.5 bar abs")])
def test_a_standard_flow_beside_no_pressure_is_one_error_of_the_pressure(given, pressure, words):
    flow = '[columns.flow_l_min]\ncolumn = "Q"\nunit = "NL/min"\n'
    state = "standard = {pressure_bar_abs = 1.013, temperature_c = 0.0}\n[ambient]\ntemperature_c = 20.0\n"
    code, said, _ = given(f"P;n;Q\n2,0;397;40\n{pressure};450;50\n", SIMPLE + flow + state)
    assert (code, said.count("\n")) == (2, 1), said
    assert said.startswith(f"spinbench: data.csv, line 3: the inlet's pressure is {words}, and the flow's unit needs")


def test_a_decimal_comma_of_a_workbook_is_of_its_cells_of_text(given):
    text = '<c r="A3" t="inlineStr"><is><t>2,25</t></is></c>'
    code, said, made = given(sheet(text), SIMPLE, "xlsx", 'decimal = ","\nsheet = "one"\n')
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", "2.25,450.0"]), said


def test_readings_without_times_are_counted_once(put, tmp_path, spinbench_here):  # noqa: F811 - the fixture
    put("map.toml", HEAD + SIMPLE)
    put("data.csv", "P;n\n2,0;397\n2,2;450\n2,4;500\n")
    assert spinbench_here("runs", "import", "data.csv", "--mapping", "map.toml", cwd=tmp_path).returncode == 0
    done = spinbench_here("runs", "export", "last", "-o", "out", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("of 3 readings in the plateaus, 3 unverified")) == (0, 2), done.stderr


@pytest.mark.parametrize(
    ("rows", "why"), [("[1, 500]", "the last of them is row 3"), ("[3, 1]", "the first comes behind the last")]
)
def test_rows_that_are_not_there_are_refused(given, rows, why):
    files = f'[[files]]\nfile = "data.csv"\nkind = "steady"\nrows = {rows}\n'
    code, said, _ = given("P;n\n2,0;397\n2,2;450\n2,4;500\n", SIMPLE + files)
    assert (code, f"data.csv: rows = {rows} of [[files]]: {why}" in said) == (2, True), said


CURES = {
    "a link": (lambda path: path.symlink_to("other.csv"), "a symbolic link, which is refused; give the file itself"),
    "a folder": (lambda path: path.mkdir(), "is not a plain file, but a folder; give a file"),
    "a pipe": (os.mkfifo, "is not a plain file, but a pipe or a device; give a file"),
    "no text": (
        lambda path: savemat(path, {"P": [1.0, 2.0]}, appendmat=False),
        "or, of a file that is no text, its reader",
    ),
    "times of day": ("t;P;n\n10:00:00;2,0;397\n", 'say how it is written: unit = "hh:mm:ss", "ISO" or another'),
}


@pytest.mark.parametrize("name", CURES)
def test_an_error_says_what_to_do(given, name):
    content, words = CURES[name]
    code, said, _ = given(content, SIMPLE + CLOCKED.format("s"))
    assert (code, words in said) == (2, True), said
