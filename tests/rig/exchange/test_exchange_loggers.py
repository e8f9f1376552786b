"""Files in the manner of loggers: read as they were meant, told where they may be meant otherwise, or refused."""

import re
import zipfile

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from rig.exchange.export import recording_of
from rig.exchange.guess.proposal import propose
from rig.exchange.importing import import_recording, import_table
from rig.exchange.mapping import read_mapping
from rig.recording import read_recording
from rig.runlog import RunError, read_run
from tests.rig.exchange.test_exchange_as_found import sheet
from tests.rig.runlog.test_runlog_import import CLOCKED, HEAD, SIMPLE, TDMS, put, workbook  # noqa: F401 - a fixture

FLOW = '[columns.flow_l_min]\ncolumn = "Q"\nunit = "L/min"\n'
STATES = ("standard", "rotameter")
PLACES = SIMPLE.replace('"P"', "1").replace('"n"', "2")
ROWS = '[[files]]\nfile = "data.csv"\nkind = "steady"\nrows = [1, 2]\n'
RUN = '[[files]]\nfile = "data"\nkind = "transient"\n'
POINT = HEAD.replace('decimal = ","', 'decimal = "."')


@pytest.fixture
def taken(put, tmp_path):  # noqa: F811 - the fixture
    """Imports a file as a recording; returned are the columns of its first file, and what was told."""

    def run(content, columns=SIMPLE, head=POINT, name="data.csv"):
        told = []
        mapping = read_mapping(put("map.toml", head + columns))
        source = tmp_path / name
        content(source) if callable(content) else put(name, content)
        folder = import_recording([source], mapping, tmp_path / "out", told.append)
        columns = read_recording(folder).files[0].columns
        return {key: column.values.tolist() for key, column in columns.items()}, " | ".join(told)

    return run


CLOCKS = {
    "thousandths after a colon": ("M/D/Y h:m:s", ["05/13/2024 10:00:00:123", "05/13/2024 10:00:01:623"], 1.5),
    "ISO with hour 24": ("ISO", ["2023-12-31T23:59:58", "2023-12-31T24:00:00"], 2.0),
    "ISO with hour 24 in a zone": ("ISO", ["2023-12-31T23:59:58+01:00", "2023-12-31 24:00:00.0+01:00"], 2.0),
}


@pytest.mark.parametrize("name", CLOCKS)
def test_a_time_is_read_as_loggers_write_it(taken, name):
    unit, (first, second), apart = CLOCKS[name]
    found, _ = taken(f"t;P;n\n{first};2.0;397\n{second};2.1;398\n", SIMPLE + CLOCKED.format(unit))
    assert found["time_s"] == [0.0, apart]


def test_a_date_and_a_time_that_excel_counts_in_two_columns_are_added(taken):
    columns = SIMPLE + '[columns.time_s]\ncolumn = ["d", "t"]\nunit = "Excel days"\n'
    found, _ = taken("d;t;P;n\n45291;0.75;2.0;397\n45292;0.25;2.1;398\n", columns)
    assert found["time_s"] == [0.0, 43_200.0]


def test_a_sign_may_stand_apart_from_its_number(taken):
    assert taken("P;Q;n\n+  2.00;- 0.1;+ 397\n", SIMPLE + FLOW)[0]["flow_l_min"] == [-0.1]


@pytest.mark.parametrize("mark", ["Infinity", "+OVER", "+1.#INF", "+++++++", "Over Range"])
def test_more_words_of_loggers_for_a_range_that_ended(taken, mark):
    assert "over range 1 times" in taken(f"P;n\n2.0;397\n2.1;{mark}\n")[1]


@pytest.mark.parametrize("mark", ["-Infinity", "-nan(ind)", "#DIV/0!", "BURNOUT", "-1.#INF", "1.#QNAN0"])
def test_more_words_of_loggers_for_no_reading(taken, mark):
    assert f"no reading 1 times ('{mark}')" in taken(f"P;n\n2.0;397\n2.1;{mark}\n")[1]


TOLD = {
    "thousands": (
        "P;n\n2.0;980\n2.1;1.012\n",
        SIMPLE,
        "column 'n': '1.012' beside '980': does '.' part thousands? It is read as decimal",
    ),
    "a number for none": (
        "P;n\n2.0;397\n2.1;9999\n2.2;9999\n",
        SIMPLE,
        "column 'n': '9999' 2 times, far from the others: many loggers write it where there is no value",
    ),
    "the first row for headings": ("2.0;397\n2.1;398\n", PLACES, "'2.0' is taken for a heading; if the file has none"),
    "a unit after a comma": (
        "P, kPa;n\n2.0;397\n",
        SIMPLE.replace('"P"', '"P, kPa"'),
        "'P, kPa': the file says 'kPa', the mapping 'bar abs'",
    ),
    "a unit in a heading that is taken by its place": ("P [kPa];n\n2.0;397\n", PLACES, "the file says 'kPa'"),
    "a gauge pressure": ("Überdruck [bar];n\n2.0;397\n", PLACES, "'Überdruck [bar]': the heading says gauge"),
    "a zero of a rotor that turns": (
        "P;n\n1.0;0\n1.0;397\n",
        SIMPLE + ROWS.replace("steady", "zero"),
        "line 3: a zero is read with the rotor at rest, and here it turns at 397 rpm",
    ),
    "a row that is taken twice": (
        "P;n\n2.0;397\n2.1;398\n2.2;399\n",
        SIMPLE + ROWS + ROWS.replace("1, 2", "2, 3"),
        "data.csv, lines 3 to 3: two of [[files]] take them, and they count twice",
    ),
}


@pytest.mark.parametrize("name", TOLD)
def test_what_may_be_meant_otherwise_is_read_as_it_stands_and_told(taken, name):
    content, columns, words = TOLD[name]
    assert words in taken(content, columns)[1]


QUIET = {
    "decimals of one width": "P;n\n2.0;980.000\n2.1;1012.000\n",
    "whole numbers": "P;n\n2.0;980\n2.1;1012\n",
    "numbers near such a one": "P;n\n2.0;9990\n2.1;9999\n2.2;9997\n",
    "headings": "P (bar);n\n2.0;980\n2.1;1012\n",
}


@pytest.mark.parametrize("name", QUIET)
def test_what_is_plain_is_not_doubted(taken, name):
    assert taken(QUIET[name], PLACES)[1] == ""


@pytest.mark.parametrize("unit", ["kPa", '"kPa"'])
def test_a_unit_that_stands_below_its_heading_is_minded(taken, unit):
    _, told = taken(f"P;n\n{unit};rpm\n2.0;397\n", head=POINT + "first_line = 3\n")
    assert told.count("the file says") == 1 and "'P': the file says 'kPa', the mapping 'bar abs'" in told


@pytest.mark.parametrize("footer", ["End of log\n", "End;of;the;log\n", "\x1a", "\0\0\0\0"])
@pytest.mark.parametrize("delimiter", [";", " "])
def test_what_stands_below_the_rows_that_are_taken_may_be_anything(taken, footer, delimiter):
    head, footer = POINT.replace('";"', f'"{delimiter}"'), footer.replace(";", delimiter)
    rows = "P;n\n2.0;397\n2.1;398\n".replace(";", delimiter)
    assert taken(rows + footer, SIMPLE + ROWS, head)[0]["speed_rpm"] == [397.0, 398.0]
    with pytest.raises(RunError, match="line 4"):
        taken(rows + footer, SIMPLE, head)


def test_a_row_without_anything_that_is_taken_is_none(taken):
    csv = "t;P;n;note\n0;2.0;397;\n;;;by Ms N.\n1;2.1;398;\n"
    found, _ = taken(csv, SIMPLE + CLOCKED.format("s") + RUN.replace('"data"', '"data.csv"'))
    assert (found["time_s"], found["speed_rpm"]) == ([0.0, 1.0], [397.0, 398.0])


def test_where_rows_are_counted_by_a_period_an_empty_one_counts(taken):
    period = "[columns.time_s]\nsample_period_s = 0.5\n"
    found, _ = taken("P;n;note\n2.0;397;\n;;by Ms N.\n2.1;398;\n", SIMPLE + period)
    np.testing.assert_equal(found["speed_rpm"], [397.0, np.nan, 398.0])
    assert found["time_s"] == [0.0, 0.5, 1.0]


REFUSED = {
    "AM in some rows": (
        "t;P;n\n11:59:59 AM;2.0;397\n12:00:00;2.1;398\n",
        SIMPLE + CLOCKED.format("hh:mm:ss"),
        "line 3, column 't': '12:00:00' and '11:59:59 AM' before it: one tells AM or PM, and the other does not",
    ),
    "times of each channel": (
        "X;P;X;n\n0.0;2.0;0.05;397\n0.1;2.1;0.15;398\n",
        '[columns.time_s]\ncolumn = 1\nunit = "s"\n' + SIMPLE,
        "columns 1, 3 are all called 'X' and differ",
    ),
    "a sign before a flag": (
        "P;n;v\n2.0;397;>0\n",
        SIMPLE + '[columns.supply_open]\ncolumn = "v"\nunit = "0/1"\n',
        "line 2, column 'v': '>0' is not a number",
    ),
    "two states of a flow": (
        "P;Q;n\n2.0;70;397\n",
        SIMPLE + FLOW + "".join(f"{key} = {{pressure_bar_abs = 1.0, temperature_c = 0.0}}\n" for key in STATES),
        "columns.flow_l_min: a rotameter's scale refers to no standard state",
    ),
    "one column for two": ("P;n\n2.0;397\n", SIMPLE.replace('"n"', '"P"'), "columns.speed_rpm: 'P' is columns."),
    "more than the highest": (
        "P;n\n2.0;397\n2.1;OL\n",
        SIMPLE.replace('"rpm"', '"rpm"\nhighest = 100.0'),
        "line 2, column 'n': '397' is above highest = 100 rpm",
    ),
    "the same rows twice": (
        "P;n\n2.0;397\n2.1;398\n",
        SIMPLE + ROWS + ROWS,
        "data.csv: the same readings twice, which would count twice",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_read_wrongly_is_refused(taken, tmp_path, name):
    content, columns, words = REFUSED[name]
    with pytest.raises(RunError, match=re.escape(words)):
        taken(content, columns)
    assert not (tmp_path / "out").exists()


def test_two_files_of_the_same_readings_are_refused(put, tmp_path):  # noqa: F811 - the fixture
    files = [put(name, "P;n\n2.0;397\n2.1;398\n") for name in ("a.csv", "b.csv")]
    mapping = read_mapping(put("map.toml", POINT + SIMPLE))
    with pytest.raises(RunError, match=r"a\.csv and b\.csv: the same readings twice"):
        import_recording(files, mapping, tmp_path / "out")


def test_a_period_counts_the_rows_that_only_leaves_out(taken):
    period = "[columns.time_s]\nsample_period_s = 0.5\n"
    only = RUN.replace('"data"', '"data.csv"') + 'only = {column = "k", equals = "a"}\n'
    found, told = taken("P;n;k\n2;400;b\n2;399;a\n2;398;b\n2;397;a\n2;396;a\n", SIMPLE + period + only)
    assert (found["time_s"], found["speed_rpm"], told) == ([0.0, 1.0, 1.5], [399.0, 397.0, 396.0], "")


def test_an_empty_line_that_a_period_does_not_count_is_told(taken):
    period = "[columns.time_s]\nsample_period_s = 0.5\n"
    found, told = taken("P;n\n2;400\n;\n2;398\n\n", SIMPLE + period)
    assert found["time_s"] == [0.0, 0.5]
    assert (
        told
        == f"{told.partition(', line')[0]}, line 4: empty lines before it are no rows, and sample_period_s does not "
        "count them"
    )


def test_a_mark_of_utf_8_under_another_encoding_is_refused(taken):
    with pytest.raises(RunError, match="begins with the mark of utf-8, and the mapping says cp1252"):
        taken("\ufeffP;n\n2.0;397\n", head=POINT + 'encoding = "cp1252"\n')


# Several files in a run, which has one clock

ZERO_AND_SWEEP = '[[files]]\nfile = "zero.csv"\nkind = "zero"\n[[files]]\nfile = "data.csv"\nkind = "steady"\n'
COASTS = '[[files]]\nfile = "a.csv"\nkind = "transient"\n[[files]]\nfile = "b.csv"\nkind = "transient"\n'
SUPPLY = '[columns.supply_open]\ncolumn = "v"\nunit = "0/1"\n'
COAST = "t;P;n\n{0};2.0;397\n{1};1.5;390\n{2};1.0;300\n"


def test_a_zero_without_times_holds_its_own_readings(put, tmp_path):  # noqa: F811 - the fixture
    files = [put("zero.csv", "P;n\n1.01;0\n1.03;0\n"), put("data.csv", "P;n\n2.0;397\n2.1;410\n")]
    mapping = read_mapping(put("map.toml", POINT + SIMPLE + ZERO_AND_SWEEP))
    found = recording_of(read_run(import_table(files, mapping, tmp_path / "runs"))).recording
    zero, sweep = sorted(found.files, key=lambda file: file.kind, reverse=True)
    assert (zero.kind, zero.columns["pressure_bar_abs"].values) == ("zero", pytest.approx([1.02]))
    assert sweep.columns["pressure_bar_abs"].values.tolist() == [2.0, 2.1]


def test_two_runs_in_time_at_the_same_time_are_refused_and_at_their_own_are_kept_apart(
    put,  # noqa: F811 - the fixture
    tmp_path,
):
    files = [put("a.csv", COAST.format(0, 1, 2)), put("b.csv", COAST.format(0, 1, 2).replace("397", "396"))]
    text = POINT + SIMPLE + CLOCKED.format("s") + COASTS
    with pytest.raises(RunError, match=r"a\.csv and b\.csv are at the same time"):
        import_table(files, read_mapping(put("map.toml", text)), tmp_path / "runs")
    assert not (tmp_path / "runs").exists()
    told = []
    text += "start_s = 60.0\nnoise_scale = 2.0\n"
    run = read_run(import_table(files, read_mapping(put("map.toml", text)), tmp_path / "runs", told.append))
    found = [file.columns["speed_rpm"].values.tolist() for file in recording_of(run).recording.files]
    assert found == [[397.0, 390.0, 300.0], [396.0, 390.0, 300.0]]
    assert told == ["b.csv: a run has no noise_scale; make a recording with -o, or it counts as 1"]


FLAGS = {
    "a coast-down whose last speed is misread": ([1, 1, 0, 0], [397, 396, 390, 398], "coast_down.csv"),
    "shut all the time": ([0, 0, 0, 0], [397, 390, 380, 370], "coast_down.csv"),
    "open all the time": ([1, 1, 1, 1], [100, 200, 300, 390], "spin_up.csv"),
    "not known in a row": ([1, "", 0, 0], [397, 396, 390, 380], "coast_down.csv"),
}


@pytest.mark.parametrize("name", FLAGS)
def test_a_run_tells_of_the_supply_what_its_column_says(put, tmp_path, name):  # noqa: F811 - the fixture
    flags, speeds, made = FLAGS[name]
    rows = "".join(f"{at};2.0;{speed};{flag}\n" for at, (flag, speed) in enumerate(zip(flags, speeds, strict=True)))
    text = POINT.replace("steady", "transient") + SIMPLE + CLOCKED.format("s") + SUPPLY
    run = read_run(
        import_table([put("a.csv", "t;P;n;v\n" + rows)], read_mapping(put("map.toml", text)), tmp_path / "r")
    )
    (file,) = recording_of(run).recording.files
    found = file.columns["supply_open"].values.tolist()
    assert (file.file, [one for one, flag in zip(found, flags, strict=True) if flag != ""]) == (
        made,
        [flag for flag in flags if flag != ""],
    )


def test_a_supply_in_a_workbook_s_words_is_a_supply(taken):
    text = SIMPLE + CLOCKED.format("s") + SUPPLY
    found, _ = taken("t;P;n;v\n0;2.0;397;TRUE\n1;1.5;390;False\n2;1.0;300;0\n", text)
    assert found["supply_open"] == [1.0, 0.0, 0.0]


def test_a_supply_that_is_switched_twice_is_no_run(put, tmp_path):  # noqa: F811 - the fixture
    text = POINT.replace("steady", "transient") + SIMPLE + CLOCKED.format("s") + SUPPLY
    source = put("a.csv", "t;P;n;v\n0;1;0;0\n1;2;200;1\n2;2;397;1\n3;1;300;0\n")
    with pytest.raises(RunError, match=r"a\.csv, line 3, 5: supply_open changes more than once"):
        import_table([source], read_mapping(put("map.toml", text)), tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(("start_s", "is_told"), [(0.0, True), (3600.0, False)])
def test_dates_of_several_files_that_their_start_does_not_tell_are_told(
    put,  # noqa: F811 - the fixture
    tmp_path,
    start_s,
    is_told,
):
    day = "2024-05-01T{}:00:0"
    files = [
        put(name, COAST.format(*(day.format(hour) + str(second) for second in range(3))).replace("397", speed))
        for name, hour, speed in (("a.csv", 10, "397"), ("b.csv", 11, "396"))
    ]
    text = POINT + SIMPLE + CLOCKED.format("ISO") + COASTS + f"start_s = {start_s}\n"
    told = []
    import_recording(files, read_mapping(put("map.toml", text)), tmp_path / "out", told.append)
    assert [words.partition(", by")[0] for words in told] == [
        "b.csv: by its dates it begins 3600 s after a.csv"
    ] * is_told


@pytest.mark.parametrize(("day", "is_told"), [("2024-05-01", False), ("2024-05-02", False), ("2024-06-01", True)])
@pytest.mark.parametrize(("unit", "cell"), [("ISO", "2024-05-01T10:00:00"), ("D.M.Y h:m:s", "01.05.2024 10:00:00")])
def test_times_of_another_day_than_the_mapping_states_are_told(taken, day, is_told, unit, cell):
    head = POINT.replace("[table]", f'[origin]\ndate = "{day}"\n[table]')
    _, told = taken(f"t;P;n\n{cell};2.0;397\n", SIMPLE + CLOCKED.format(unit), head)
    assert ("its times begin on 2024-05-01, and [origin] date says 2024-06-01" in told) == is_told


OTHER_TIMES = {
    "later by half a step": ("t_n [s]", ["0.05", "0.15", "0.25"], True),
    "at another rate": ("Time 2 (s)", ["0.0", "0.1", "0.3"], True),
    "in another unit": ("t [ms]", ["0", "100", "200"], False),
    "from another beginning": ("time (s)", ["1000.0", "1000.1", "1000.2"], False),
    "of another quantity": ("x", ["0.05", "0.15", "0.25"], False),
}


@pytest.mark.parametrize("name", OTHER_TIMES)
def test_times_of_another_channel_are_told(taken, name):
    heading, times, is_told = OTHER_TIMES[name]
    csv = f"t;P;{heading};n\n" + "".join(f"{0.1 * at:.1f};2.0;{time};397\n" for at, time in enumerate(times))
    _, told = taken(csv, SIMPLE + CLOCKED.format("s"))
    assert (f"'{heading}' is a time too, and another than 't'" in told) == is_told


def test_an_empty_column_of_directions_is_told(taken):
    columns = SIMPLE + '[columns.direction]\ncolumn = "d"\n'
    assert "column 'd': no word in it" in taken("P;n;d\n2.0;397;\n", columns)[1]


# Workbooks

XLSX = TDMS.replace("tdms", "xlsx") + 'sheet = "one"\n'


HIDDEN = (
    '<worksheet MAIN><sheetData><row r="1"><c r="A1" t="inlineStr"><is><t>P</t></is></c>'
    '<c r="B1" t="inlineStr"><is><t>n</t></is></c></row>'
    '<row r="2" hidden="1"><c r="A2"><v>2.0</v></c><c r="B2"><v>397</v></c></row></sheetData></worksheet>'
)


def test_a_hidden_row_is_told(taken):
    found, told = taken(lambda path: workbook(path, HIDDEN), head=XLSX, name="data.xlsx")
    assert (found["speed_rpm"], "line 2: a hidden row" in told) == ([397.0], True)


def test_a_formula_over_several_rows_is_told(taken):
    formula = '<c r="A3"><f>AVERAGE(A$1:A2)</f><v>2.0</v></c>'
    _, told = taken(sheet(formula), head=XLSX, name="data.xlsx")
    assert "line 3: the formula 'AVERAGE(A$1:A2)' takes several rows" in told


def test_a_formula_below_the_rows_that_are_taken_is_not_told(taken):
    head = XLSX.replace('kind = "steady"\n', "")
    formula = '<c r="A3"><f>AVERAGE(A$1:A2)</f><v>2.0</v></c>'
    part = '[[files]]\nfile = "data.xlsx"\nkind = "steady"\nrows = [1, 1]\n'
    found, told = taken(sheet(formula), SIMPLE + part, head, "data.xlsx")
    assert (len(found["pressure_bar_abs"]), "formula" in told) == (1, False)


STYLES = (
    '<styleSheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><numFmts>'
    '<numFmt numFmtId="164" formatCode="{}"/></numFmts><cellXfs><xf numFmtId="0"/><xf numFmtId="{}"/></cellXfs>'
    "</styleSheet>"
)


def dated(code, number=164):
    """Writes a workbook with a pressure of 2.0 whose cell is shown by a format."""

    def write(path):
        sheet('<c r="A3" s="1"><v>2.0</v></c>')(path)
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("xl/styles.xml", STYLES.format(code, number))

    return write


@pytest.mark.parametrize(("code", "number"), [("dd/mm/yyyy", 164), ("[h]:mm:ss", 164), ("0.0", 14), ("mm:ss.0", 164)])
def test_a_number_that_a_workbook_shows_as_a_date_is_refused(taken, code, number):
    with pytest.raises(RunError, match=r"line 3, column 'P': the workbook shows '2\.0' as a date or a time"):
        taken(dated(code, number), head=XLSX, name="data.xlsx")


@pytest.mark.parametrize("code", ["General", "0.00", "[Red]0.0", "0.00E+00", "0.0 &quot;sd&quot;", "_-* 0.0_-"])
def test_a_number_that_a_workbook_shows_as_one_is_read(taken, code):
    found, _ = taken(dated(code), head=XLSX, name="data.xlsx")
    assert found["pressure_bar_abs"] == [2.0, 2.0]


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"\xd0\xcf\x11\xe0" + bytes(600), "a workbook of an old Excel"), (b"P;n\n2;397\n", "not a zip file")],
)
def test_what_is_no_workbook_is_told_as_what_it_is(taken, content, words):
    with pytest.raises(RunError, match=words):
        taken(content, head=XLSX, name="data.xlsx")


# TDMS

BEGIN = np.datetime64("2024-05-01T10:00:00")
NO_START = np.datetime64("1904-01-01T00:00:00")
WAVES = TDMS + SIMPLE + CLOCKED.format("s").replace('"t"', '"@time"') + RUN.replace('"data"', '"data.tdms"')


def segments(*starts, units=(), names="Pn"):
    """Writes a TDMS file of waveforms in steps of 0.1 s: a segment of two samples for each start."""

    def write(path):
        with TdmsWriter(path) as writer:
            for at, start in enumerate(starts):
                said = {"wf_start_time": start, "wf_increment": 0.1} if start is not None else {}
                said |= {"unit_string": units[at]} if units else {}
                writer.write_segment([ChannelObject("g", name, np.array([2.0, 1.9]) - at, said) for name in names])

    return write


@pytest.mark.parametrize(
    ("late_ms", "time", "told"),
    [(60_000, [0.0, 0.1, 60.0, 60.1], True), (200, [0.0, 0.1, 0.2, 0.3], False), (None, [0.0, 0.1, 0.2, 0.3], False)],
)
def test_a_tdms_clock_that_was_started_anew_is_read_from_there(taken, late_ms, time, told):
    second = None if late_ms is None else BEGIN + np.timedelta64(late_ms, "ms")
    found, said = taken(segments(BEGIN, second), WAVES, head="", name="data.tdms")
    assert found["time_s"] == pytest.approx(time)
    assert ("'n': its clock is set anew: from 2024-05-01T10:00:00" in said) == told


def test_a_tdms_clock_that_was_set_back_is_refused(taken):
    with pytest.raises(RunError, match="line 3: time_s does not increase"):
        taken(segments(BEGIN, BEGIN - np.timedelta64(60, "s")), WAVES, head="", name="data.tdms")


def test_a_start_that_labview_never_set_is_no_date(taken):
    def write(path):
        with TdmsWriter(path) as writer:
            for name, start in (("P", NO_START), ("n", BEGIN)):
                said = {"wf_start_time": start, "wf_increment": 0.1}
                writer.write_segment([ChannelObject("g", name, np.array([2.0, 1.9]), said)])

    with pytest.raises(RunError, match=r"two clocks: 'P' from no date .*; one tells no date"):
        taken(write, WAVES, head="", name="data.tdms")


@pytest.mark.parametrize("unit", ["Hz", "ms"])
def test_a_tdms_axis_that_is_not_in_seconds_is_no_clock(taken, unit):
    def write(path):
        said = {"wf_increment": 1.0, "wf_xunit_string": unit}
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("g", name, np.array([2.0, 1.9]), said) for name in "Pn"])

    with pytest.raises(RunError, match="no column is called '@time'"):
        taken(write, WAVES, head="", name="data.tdms")


def test_a_tdms_channel_whose_unit_changes_is_refused(taken):
    with pytest.raises(RunError, match="'P': its scale or unit is another from sample 3 on"):
        taken(segments(None, None, units=("bar", "kPa")), TDMS + SIMPLE, head="", name="data.tdms")


# Guesses


def test_a_channel_that_is_no_column_does_not_hide_the_others(tmp_path):
    with TdmsWriter(tmp_path / "data.tdms") as writer:
        writer.write_segment(
            [ChannelObject("g", "n [rpm]", np.array([397.0, 398.0])), ChannelObject("g", "z", np.array([1j, 2j]))]
        )
    assert 'column = "n [rpm]"\nunit = "rpm"' in propose(tmp_path / "data.tdms")


def test_utf_16_without_its_mark_is_proposed(put):  # noqa: F811 - the fixture
    text = propose(put("data.csv", "P [bar(a)];n [rpm]\n2.0;397\n2.1;398\n".encode("utf-16-le")))
    assert 'encoding = "utf-16"\n' in text and 'column = "n [rpm]"' in text
