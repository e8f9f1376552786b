"""`runs import --guess`: a look at a file gives a mapping for a person to confirm, and never an import."""

import subprocess
import sys
import tomllib
import warnings

import h5py
import hypothesis
import hypothesis.strategies as st
import nptdms
import numpy as np
import pytest
from scipy.io import savemat

from configs import ConfigError
from rig.exchange.guess.proposal import propose
from rig.exchange.importing import import_recording
from rig.exchange.mapping import read_mapping
from rig.exchange.samples.export import export_samples
from rig.recording import read_recording
from rig.recording.header import read_heading
from rig.runlog import RunError, read_run
from tests.rig.runlog.test_runlog_import import workbook
from tests.synthetic_runs import write_sweep

ANSWERS = 'title = "a bench"\nsource = "a colleague"\nlicence = "none"\nmotor = "ptm3600"\nkind = "transient"\n'
GERMAN = """Messung vom 3.5.2024
Prüfer: Müller

Datum;Uhrzeit;Druck;Durchfluss;Drehzahl;Temp Zuluft;Richtung;Bemerkung
;;kPa abs;m³/h;1/min;°C;;
03.05.2024;10:00:00;160,5;2,64;232,3;20,5;auf;ok
03.05.2024;10:00:05;180,5;3,24;OL;20,5;auf;
03.05.2024;10:00:10;200,5;4,38;397,1;20,5;ab;ok
"""


@pytest.fixture
def proposed(tmp_path):
    """The proposal for a file of some content."""

    def text_of(content, name="data.csv"):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return propose(tmp_path / name)

    return text_of


def confirmed(text, *lines):
    """What a person makes of a proposal: the answers that no file tells, and commented lines without their mark."""
    for line in lines:
        assert f"# {line}\n" in text
        text = text.replace(f"# {line}\n", f"{line}\n", 1)
    return ANSWERS + text


def columns_of(tmp_path, source, mapping_text):
    (tmp_path / "map.toml").write_text(mapping_text)
    made = import_recording([source], read_mapping(tmp_path / "map.toml"), tmp_path / "recording")
    (file,) = read_recording(made).files
    return {name: column.values.tolist() for name, column in file.columns.items()}, file.direction


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "utf-16"])
def test_what_headings_units_and_times_say_is_proposed_and_imports_once_a_person_has_confirmed(
    proposed, tmp_path, encoding
):
    text = proposed(GERMAN.encode(encoding))
    found, direction = columns_of(tmp_path, tmp_path / "data.csv", confirmed(text))
    assert found["time_s"] == [0.0, 5.0, 10.0]
    assert found["pressure_bar_abs"] == pytest.approx([1.605, 1.805, 2.005])
    assert found["flow_l_min"] == pytest.approx([44.0, 54.0, 73.0])
    np.testing.assert_equal(found["speed_rpm"], [232.3, np.nan, 397.1])
    assert found["inlet_temperature_c"] == [20.5, 20.5, 20.5]
    assert list(direction) == ["up", "up", "down"]
    assert "#   'Bemerkung': such as 'ok'\n" in text


def test_no_proposal_can_be_imported_before_a_person_has_read_it(proposed, tmp_path):
    (tmp_path / "map.toml").write_text(proposed(GERMAN))
    with pytest.raises(ConfigError, match="the key 'title' is missing"):
        read_mapping(tmp_path / "map.toml")


def test_a_column_of_times_with_a_word_below_it_is_one(proposed):
    text = proposed(
        "Zeit;n [1/s]\n14.05.2026 14:05:00;2,5\n14.05.2026 14:05:40;2,6\n14.05.2026 14:06:20;1\nMittel;2,5\n"
    )
    assert '\n[columns.time_s]\ncolumn = "Zeit"\nunit = "D.M.Y h:m:s"\n' in text
    assert "'Mittel' is none: leave its row out" in text
    assert '\n[columns.speed_rpm]\ncolumn = "n [1/s]"\nunit = "rev/s"\n' in text


def test_numbers_with_marks_between_thousands_are_named(proposed):
    text = proposed('n [rpm],Flow (l/h)\n145.0,"1,602.2"\n187.3,"2,019.7"\n')
    assert "'Flow (l/h)': such as '1,602.2', whose thousands are parted; take these marks out" in text


def test_numbers_that_a_workbook_stores_as_text_are_no_marks(proposed, tmp_path):
    cells = "".join(f'<row r="{n}"><c r="A{n}"><v>2{n}.5</v></c><c r="B{n}"><v>9</v></c></row>' for n in (2, 3, 4))
    text = '<row r="{0}"><c r="A{0}" t="inlineStr"><is><t>{1}</t></is></c><c r="B{0}"><v>9</v></c></row>'
    headings = text.format(1, "Q [L/min]").replace("<v>9</v>", "<v>n</v>")
    rows = f"{headings}{cells}{text.format(5, '33,66')}"
    workbook(tmp_path / "made.xlsx", f"<worksheet MAIN><sheetData>{rows}</sheetData></worksheet>")
    said = proposed((tmp_path / "made.xlsx").read_bytes(), "data.xlsx")
    assert "'33,66' and others look like numbers with a decimal comma, stored as text" in said
    assert "over_range" not in said


UNSURE = {
    "Pressure [kPa]\n160.5": ("nothing says whether it is absolute or gauge", 'unit = "kPa gauge"'),
    "Pressure\n160.5": ("its unit is not said: one of bar abs, mbar abs", 'unit = ""'),
    "Flow [furlong]\n2.5": ("'furlong' is no unit that the import knows", 'unit = ""'),
    "Flow [NL/min]\n2.5": ("to which state does it refer?", "standard = {pressure_bar_abs = , temperature_c = }"),
    "Speed [Hz]\n2.5": ("Hz needs the pulses of a revolution", "pulses_per_rev ="),
    "Temperature [degC]\n2.5": ("is it the temperature of the air at the inlet?", 'unit = "degC"'),
    "Flow [rpm]\n2.5": ("its words say flow_l_min, its unit speed_rpm", 'column = "Flow [rpm]"'),
    "Valve\n0.0\n1.0": ("1 has to mean supply open", 'unit = "0/1"'),
    "n [rpm];n2 [rpm]\n1.5;2.5": ("more than one column could be speed_rpm", 'column = "n2 [rpm]"'),
    "Time [s]\n1.5\n1.0": ("its numbers do not increase", 'column = "Time [s]"'),
    "Time\n1/2/2024 10:00:00\n1/2/2024 10:00:01": ("which is the day, and which the month?", "[columns.time_s]"),
    "n2;n [Hz]\n1.5;2.5": ("Hz needs the pulses", 'column = "n [Hz]"'),
    "Time\n10:00\n10:01": ("no unit of time that the import knows reads all of it", "[columns.time_s]"),
    "Time [s];n [rpm]\n1;2\n2;3": ("no number here has one", 'decimal = ","'),
    "Kommentar\n2.5": ("no column is a time", "sample_period_s ="),
    "n [rpm];t [s]\n1.5;1.0\n2.5;2.0\nkaputt;3.0\n3.5;4.0": ("words among numbers", 'invalid = ["kaputt"]'),
}


OTHERS = {
    "target speed [rpm]": "target", "pressure setpoint [bar abs]": "setpoint", "max flow [l/min]": "max",
    "Flow std [L/min]": "std", "Normal flow [l/min]": "normal", "dac.setpoint_bar_gauge": "setpoint",
    "n_soll [1/min]": "soll", "Solldruck [bar abs]": "solldruck", "Pmax [bar abs]": "pmax",
}  # fmt: skip


@pytest.mark.parametrize("heading", OTHERS)
def test_what_may_be_a_set_point_or_a_limit_is_not_sure(proposed, heading):
    text = proposed(f"{heading};No\n2.5;1\n2.6;2\n")
    assert f"# Unsure: '{OTHERS[heading]}': is it a reading, and no set-point, limit or flow that" in text
    assert f'# column = "{heading}"' in text.splitlines()


@pytest.mark.parametrize("heading", ["flow_sl_min", "flowmeter.flow_sl_min", "Q nl_min"])
def test_a_flow_whose_name_ends_as_that_of_a_standard_one_is_one(proposed, heading):
    text = proposed(f"{heading};No\n2.5;1\n2.6;2\n")
    assert "# Unsure: to which state does it refer?\n# [columns.flow_l_min]" in text
    assert "# standard = {pressure_bar_abs = , temperature_c = }" in text


@pytest.mark.parametrize("content", UNSURE)
def test_what_is_not_sure_stands_as_a_comment_with_the_reason(proposed, content):
    text, (reason, line) = proposed(content + "\n"), UNSURE[content]
    lines = text.splitlines()
    assert any(one.startswith(f"# Unsure: {reason}") for one in lines), text
    assert f"# {line}" in lines
    assert line not in lines


@pytest.mark.parametrize(
    ("heading", "unit", "name"),
    [
        ("Drehzahl [min⁻¹]", "rpm", "speed_rpm"),
        ("Druck [mbar(a)]", "mbar abs", "pressure"),
        ("P / psig", "psi gauge", "pressure"),
        ("Volumenstrom in l/h", "L/h", "flow_l_min"),
        ("n [U/min]", "rpm", "speed_rpm"),
        ("speed_rpm", "rpm", "speed_rpm"),
        ("gauge.pressure_bar_abs", "bar abs", "pressure"),
        ("Zeit [ms]", "ms", "time_s"),
        ("Moment (Nm)", "N m", "torque_nm"),
        ("P_in [MPa]", "MPa", "pressure"),
        ("P_in [mPa]", "", "pressure"),
        ("Kommentar", "", None),
    ],
)
def test_a_heading_tells_a_unit_and_a_column(heading, unit, name):
    found = read_heading(heading)
    assert found.unit == unit
    assert next(iter(found.by_unit or found.by_words), None) == name


def test_a_table_without_headings_is_taken_by_place_and_loses_no_row(proposed, tmp_path):
    text = proposed("0.5;2.1;390\n1.0;2.2;391\n1.5;2.3;392\n")
    for place, (name, unit) in enumerate((("time_s", "s"), ("pressure_bar_abs", "bar abs"), ("speed_rpm", "rpm")), 1):
        text += f'[columns.{name}]\ncolumn = {place}\nunit = "{unit}"\n'
    assert "columns are taken by place" in text
    found, _ = columns_of(tmp_path, tmp_path / "data.csv", confirmed(text))
    assert found["pressure_bar_abs"] == [2.1, 2.2, 2.3]


def test_a_line_that_is_not_like_the_others_is_pointed_out(proposed):
    text = proposed("t [s];n [rpm]\n0.5;2.1\n1.0;2.2\nrestart\n0.5;2.0\n")
    assert "# Look at this: line 4 is not like the lines before it" in text


def test_a_workbook_is_looked_at_sheet_by_sheet(tmp_path):
    cell = '<c r="{}3" t="inlineStr"><is><t>{}</t></is></c>'
    headings = '<row r="3">' + cell.format("A", "P [bar abs]") + cell.format("B", "n [rpm]") + "</row>"
    data = "".join(f'<row r="{n}"><c r="A{n}"><v>{n}.5</v></c><c r="B{n}"><v>39{n}</v></c></row>' for n in (4, 5))
    sheet = f"<worksheet MAIN><sheetData>{headings}{data}</sheetData></worksheet>"
    workbook(tmp_path / "book.xlsx", sheet)
    text = propose(tmp_path / "book.xlsx").replace("# kind", "#kind")
    assert '\nsheet = "one"\nheading_line = 3\n' in text
    found, _ = columns_of(tmp_path, tmp_path / "book.xlsx", confirmed(text).replace('"transient"', '"steady"'))
    assert found == {"pressure_bar_abs": [4.5, 5.5], "speed_rpm": [394.0, 395.0]}


def write_tdms(path):
    clock = {"wf_start_time": np.datetime64("2024-05-01T10:00:00"), "wf_increment": 0.5}
    with nptdms.TdmsWriter(path) as writer:
        for name, unit in (("Druck", "bar abs"), ("n", "1/min")):
            writer.write_segment(
                [nptdms.ChannelObject("bench", name, np.array([2.5, 1.5]), clock | {"unit_string": unit})]
            )


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        for name, unit in (("Druck", "bar abs"), ("n", "rpm")):
            file[f"entry/{name}/value"], file[f"entry/{name}/time"] = [2.5, 1.5], [0.0, 0.5]
            file[f"entry/{name}/value"].attrs["units"] = unit
            file[f"entry/{name}/time"].attrs["units"] = "s"


def write_mdf(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal
    with MDF() as file:
        for name, unit in (("Druck", "bar abs"), ("n", "rpm")):
            file.append([Signal(np.array([2.5, 1.5]), np.array([0.0, 0.5]), unit=unit, name=name)], acq_name=name)
        file.save(path)


@pytest.mark.parametrize(("name", "write"), [("a.tdms", write_tdms), ("a.h5", write_hdf5), ("a.mf4", write_mdf)])
def test_channels_with_units_and_a_clock_are_proposed_as_they_are(tmp_path, name, write):
    write(tmp_path / name)
    found, _ = columns_of(tmp_path, tmp_path / name, confirmed(propose(tmp_path / name)))
    assert found == {"time_s": [0.0, 0.5], "pressure_bar_abs": [2.5, 1.5], "speed_rpm": [2.5, 1.5]}


@pytest.mark.parametrize("ending", [".h5", ".mf4", ".parquet"])
def test_an_exported_run_is_proposed_as_what_it_is(tmp_path, ending):
    run = read_run(write_sweep(tmp_path / "logs", captures=False))
    export_samples(run, tmp_path / f"run{ending}")
    names = {"time_s", "pressure_bar_abs", "flow_l_min", "speed_rpm"}  # and perhaps not the air's: the temperature
    assert set(tomllib.loads(propose(tmp_path / f"run{ending}"))["columns"]) == names


def test_a_matlab_file_s_vectors_have_no_units(tmp_path):
    savemat(tmp_path / "a.mat", {"speed_rpm": np.arange(3.0), "P": np.arange(3.0)})
    text = propose(tmp_path / "a.mat")
    assert '\n[columns.speed_rpm]\ncolumn = "speed_rpm"\nunit = "rpm"\n' in text
    assert "# Unsure: its unit is not said" in text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "an empty file"),
        (b" \r\n\n", "an empty file"),
        (b"only words\n", "no line of the first 400 has a number"),
        (b"\xd0\xcf\x11\xe0 old", "save it as .xlsx"),
        (b"\x1f\x8b\x00\x01", "neither a format that is known nor text"),
        (b"TDSm" + b"\1" * 60, "holds no column of numbers"),
        (b"PK\x03\x04" + b"\0" * 100, "not a workbook"),
        (b"\x89HDF\r\n\x1a\n" + b"\1" * 100, "not a hdf5 file that can be read"),
        (b"MDF     4.10    " + b"\1" * 100, "not a mdf file that can be read"),
    ],
)
def test_a_file_in_which_nothing_can_be_seen_is_refused(proposed, content, words):
    with pytest.raises(RunError, match=words):
        proposed(content)


@pytest.mark.long
@hypothesis.given(headings=st.lists(st.text(max_size=12), min_size=1, max_size=4), word=st.text(max_size=6))
@hypothesis.settings(max_examples=15)
def test_no_text_of_a_file_becomes_a_line_of_its_own(headings, word, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "data.csv"
    quoted = ";".join('"' + heading.replace('"', '""') + '"' for heading in headings)
    rows = "".join(";".join("1.5" for _ in headings) + "\n" for _ in range(4))
    path.write_text(f'{quoted}\n{rows}"{word}"\n{rows}', encoding="utf-8", errors="replace")
    try:
        text = propose(path)
    except RunError:
        return
    assert set(tomllib.loads(text)) <= {"format", "table", "columns"}
    assert set(tomllib.loads(text)["table"]) <= {
        "reader",
        "delimiter",
        "decimal",
        "encoding",
        "heading_line",
        "first_line",
    }


def command(*words, cwd):
    line = [sys.executable, "-m", "spinbench", "runs", "import", *words]
    return subprocess.run(line, capture_output=True, text=True, cwd=cwd, timeout=120, check=False)


def test_the_command_prints_a_proposal_or_writes_it_where_nothing_is_and_makes_no_run(tmp_path):
    (tmp_path / "data.csv").write_text(GERMAN)
    printed = command("--guess", "data.csv", cwd=tmp_path)
    written = command("--guess", "data.csv", "-o", "map.toml", cwd=tmp_path)
    assert (printed.returncode, written.returncode, written.stdout) == (0, 0, "map.toml\n")
    assert printed.stdout == (tmp_path / "map.toml").read_text()
    again = command("--guess", "data.csv", "-o", "map.toml", cwd=tmp_path)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data.csv", "map.toml"]


@pytest.mark.parametrize("words", ["data.csv", "--guess data.csv other.csv", "--guess data.csv --mapping map.toml"])
def test_the_command_wants_a_mapping_or_a_guess_of_one_file(tmp_path, words):
    done = command(*words.split(), cwd=tmp_path)
    assert (done.returncode, "give --mapping, or --guess and one file" in done.stderr) == (2, True)
