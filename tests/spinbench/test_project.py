"""A project folder: what `init` puts there, and that its files are found before the shipped ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import configs
from calibration.diagnosis.mismatch import fit_base
from calibration.fit import fit as fits
from calibration.fit.sampling import Settings
from configs import ConfigError
from model.motor import read_motor
from rig.bench.bench import bench_path, read_bench
from rig.clock import Clock
from rig.exchange.importing import import_table
from rig.exchange.mapping import read_mapping
from rig.recording import RecordingError, read_recording, write_recording
from rig.runlog import Circumstances, read_run, start_record
from spinbench.published import published_sweep

GAUGE = (configs.FOLDER / "instruments" / "keller_30x_abs.toml").read_text()


@pytest.fixture
def project(tmp_path, spinbench_here) -> Path:
    """A project as `init` makes it, in which the program runs; its motor drags more than the shipped one."""
    made = spinbench_here("init", "project", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    motor = tmp_path / "project" / "motors" / "motor.toml"
    text = motor.read_text()
    head, mark, tail = text.partition("[parameters.f_overall]")
    motor.write_text(head + mark + tail.replace("value = 0.0625", "value = 0.08", 1))
    assert read_motor(motor)["f_overall"].value == 0.08
    return tmp_path / "project"


def recorded(folder: Path, motor: str) -> Path:
    """The article's sweep, of this motor as recording.toml has it."""
    shutil.copytree(published_sweep(), folder)
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text().replace('motor = "ptm3600"', f"motor = {motor}"))
    return folder


@pytest.mark.parametrize(("taken", "named"), [("file", "file"), ("file", "file/below"), ("there/motors", "there")])
def test_init_says_which_file_stands_in_its_way(tmp_path, spinbench_here, taken, named):
    (tmp_path / taken).parent.mkdir(exist_ok=True)
    (tmp_path / taken).write_text("a file")
    done = spinbench_here("init", named, cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"{taken}: a file, where a folder is to be made; name another folder" in line
    assert [one.name for one in tmp_path.rglob("*") if one.is_file()] == [Path(taken).name]


def test_init_makes_a_project_that_works_and_overwrites_nothing(project, spinbench_here):
    assert {one.name for one in project.iterdir()} == {
        "spinbench.toml", "notes.md", "motors", "benches", "instruments", "imports", "logs",
    }  # fmt: skip
    before = (project / "motors" / "motor.toml").read_bytes()
    again = spinbench_here("init", "project", cwd=project.parent)
    assert again.returncode == 2
    assert "motors/motor.toml" in again.stderr and "Nothing is overwritten" in again.stderr
    assert (project / "motors" / "motor.toml").read_bytes() == before


def test_a_motor_of_the_project_comes_before_the_shipped_one_of_its_name(project, spinbench_here):
    below = project / "logs"
    assert (
        "0.08"
        in spinbench_here("simulate", "--motor", "motor", "--pressure-bar-abs", "2.0", "--json", "-", cwd=below).stdout
    )
    shutil.copy(project / "motors" / "motor.toml", project / "motors" / "ptm3600.toml")
    assert read_motor("ptm3600")["f_overall"].value == 0.08
    outside = spinbench_here("simulate", "--motor", "motor", "--pressure-bar-abs", "2.0", cwd=project.parent)
    assert outside.returncode == 2
    assert "motor.toml" in outside.stderr


def test_a_bench_finds_its_motor_and_instruments_in_its_project_from_anywhere(project, monkeypatch):
    own = GAUGE.replace("title = ", 'title = "our own, "\n#', 1)
    (project / "instruments" / "keller_30x_abs.toml").write_text(own)
    monkeypatch.chdir("/")
    bench = read_bench(project / "benches" / "bench.toml")
    assert isinstance(bench.motor, dict) and read_motor(bench.motor)["f_overall"].value == 0.08
    assert bench.instruments["gauge"].title == "our own, "
    (project / "benches" / "keller_30x_abs.toml").write_text(own.replace("our own, ", "beside it"))
    assert read_bench(project / "benches" / "bench.toml").instruments["gauge"].title == "beside it"


def test_a_bench_of_the_project_is_found_by_its_name_and_an_instrument_by_its_path(project, monkeypatch):
    monkeypatch.chdir(project / "logs")
    assert bench_path(Path("bench")) == project / "benches" / "bench.toml"
    assert bench_path(Path("virtual")) == configs.FOLDER / "benches" / "virtual.toml"
    (project / "instruments" / "mine.toml").write_text(GAUGE)
    file = project / "benches" / "bench.toml"
    file.write_text(file.read_text().replace('"keller_30x_abs"', '"../instruments/mine.toml"'))
    assert read_bench(file).instruments["gauge"].family == "keller_30x"
    (project / "instruments" / "mine.toml").unlink()
    with pytest.raises(
        ConfigError, match=r"there is no file '\.\./instruments/mine\.toml', counted from the bench file's folder"
    ):
        read_bench(file)


def test_an_import_of_the_project_is_found_by_its_name(project, monkeypatch):
    monkeypatch.chdir(project)
    shutil.copy(configs.FOLDER / "imports" / "emps.toml", project / "imports" / "ours.toml")
    assert read_mapping(Path("ours")).path == project / "imports" / "ours.toml"
    with pytest.raises(ConfigError, match=r"theirs\.toml"):
        read_mapping(Path("theirs"))


def test_a_run_and_its_export_hold_the_motor_in_full_and_need_no_project(project, monkeypatch, tmp_path):
    bench = read_bench(project / "benches" / "bench.toml")
    start = start_record(bench, "sweep", Clock(), {}, Circumstances())
    assert start.motor["name"] == "motor"
    assert "0.08" in start.sources["motors/motor.toml"].text
    read = read_recording(recorded(project / "logs" / "sweep", '"motor"'))
    monkeypatch.chdir("/")
    write_recording(read, tmp_path / "elsewhere")
    assert read_motor(read_recording(tmp_path / "elsewhere").motor)["f_overall"].value == 0.08


def test_an_imported_run_holds_the_motor_in_full(project, monkeypatch):
    head = 'format = "import/1"\ntitle = "t"\nsource = "s"\nlicence = "none"\nmotor = "motor"\nkind = "steady"\n'
    columns = {"pressure_bar_abs": "bar abs", "speed_rpm": "rpm"}
    tables = [f'[columns.{name}]\ncolumn = "{name}"\nunit = "{unit}"\n' for name, unit in columns.items()]
    (project / "imports" / "ours.toml").write_text(
        head + '[table]\nreader = "csv"\ndelimiter = ","\ndecimal = "."\n' + "".join(tables)
    )
    (project / "data.csv").write_text("pressure_bar_abs,speed_rpm\n1.6,232\n2.0,397\n")
    monkeypatch.chdir(project)
    folder = import_table([project / "data.csv"], read_mapping(Path("ours")), project / "logs")
    monkeypatch.chdir("/")
    assert read_motor(read_run(folder).start.motor)["f_overall"].value == 0.08


def test_what_a_recording_is_changes_with_the_motor_of_its_project(project):
    folder = recorded(project / "logs" / "sweep", '"motor"')
    before = read_recording(folder).sha256
    motor = project / "motors" / "motor.toml"
    motor.write_text(motor.read_text().replace("value = 0.08", "value = 0.09", 1))
    assert read_recording(folder).sha256 != before
    (project / "motors" / "motor.toml").unlink()
    with pytest.raises(RecordingError, match="motor 'motor' is not in configs/motors, nor in the project"):
        read_recording(folder)


def test_an_inline_radial_piston_motor_is_compared_as_the_file_of_its_name(tmp_path):
    by_name = read_recording(published_sweep())
    inline = read_recording(recorded(tmp_path / "inline", _inline()))
    assert isinstance(inline.motor, dict)
    modes = [fit_base(one, lambda _: None)[1] for one in (by_name, inline)]
    assert modes[0].log_evidence == modes[1].log_evidence
    assert fits.prepare(inline, [])[0] == fits.prepare(by_name, [])[0]


@pytest.mark.long
def test_an_inline_radial_piston_motor_is_fitted_as_the_file_of_its_name(tmp_path):
    settings = Settings(seed=1, effective_samples=500, most_steps=800, times_tau=12.0)
    folders = (published_sweep(), recorded(tmp_path / "inline", _inline()))
    one, other = (fits.fit(read_recording(folder), settings).posterior["f_overall"] for folder in folders)
    assert (one.mean, one.sd) == (other.mean, other.sd)


def test_a_mistake_in_an_inline_motor_is_told_with_its_place(tmp_path):
    folder = recorded(tmp_path / "wrong", _inline().replace('unit = "N m s"', 'unit = "N m"'))
    with pytest.raises(ConfigError, match=r"motor ptm3600: parameters\.f_overall: the unit is 'N m s'"):
        fits.prepare(read_recording(folder), [])


def _inline() -> str:
    """The shipped motor as an inline table."""
    from rig.recording.write import _value

    return _value(configs.read_toml(configs.FOLDER / "motors" / "ptm3600.toml"))


@pytest.mark.parametrize(
    ("command", "own", "meant"),
    [
        (("sweep", "bnch"), "benches/bnch.toml", "bench"),
        (("simulate", "--motor", "motr", "--pressure-bar-abs", "2"), "motors/motr.toml", "motor"),
    ],
)
def test_a_mistyped_name_is_held_against_those_of_the_project_too(project, spinbench_here, command, own, meant):
    (line,) = spinbench_here(*command, cwd=project / "logs").stderr.splitlines()
    words = f"no such file, and the program comes with none of that name; did you mean '{meant}'?"
    assert line == f"spinbench: {project / own}: {words}"


def test_a_name_that_is_like_no_other_is_answered_with_those_that_there_are(project, spinbench_here):
    (line,) = spinbench_here("sweep", "quite_else", cwd=project).stderr.splitlines()
    assert line.endswith("; known here: bench, lab, manual, virtual, virtual_alicat")


def test_an_instrument_s_mistyped_name_may_be_one_of_the_project(project, spinbench_here):
    (project / "instruments" / "our_gauge.toml").write_text(GAUGE)
    bench = project / "benches" / "bench.toml"
    bench.write_text(bench.read_text().replace('instrument = "keller_30x_abs"', 'instrument = "our_gauges"', 1))
    told = spinbench_here("doctor", "bench", cwd=project)
    assert (told.returncode, "did you mean 'our_gauge'?" in told.stderr) == (2, True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('format = "project/2"\n', "'format' should be 'project/1' (given: 'project/2')"),
        ('format = "project/1"\ntitel = "x"\n', "unknown key 'titel'; did you mean 'title'?"),
        ("", "the key 'format' is missing"),
    ],
)
def test_a_project_s_file_is_read_as_strictly_as_a_bench_s(project, spinbench_here, text, words):
    (project / "spinbench.toml").write_text(text)
    told = spinbench_here("runs", "list", cwd=project / "logs")
    assert (told.returncode, told.stderr) == (2, f"spinbench: {project / 'spinbench.toml'}: {words}\n")
