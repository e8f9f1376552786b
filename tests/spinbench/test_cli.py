"""The command as a person runs it: a process, its output, its files and its exit code."""

import contextlib
import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from model.motor import read_motor
from model.solvers.steady import steady
from rig.runlog import RunWriter
from spinbench.cli import app
from spinbench.cli.errors import EXIT_CODES, exit_code
from spinbench.cli.show import suit_the_terminal
from spinbench.published import published_sweep
from tests.synthetic_runs import start_of

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "numba", "scipy", "matplotlib", "pandas", "emcee", "pydantic", "jinja2")


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    program = "import spinbench; spinbench.main()"
    return subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, cwd=cwd, timeout=120, check=False
    )


def refused(result: subprocess.CompletedProcess[str]) -> str:
    """What a refusal says; that it is one."""
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    lines = result.stderr.splitlines()
    assert lines
    assert all(line.startswith("spinbench: ") for line in lines)
    return result.stderr


def test_help_names_the_commands_and_imports_nothing_heavy():
    program = (
        "import sys, spinbench\n"
        "sys.argv = ['spinbench', '--help']\n"
        "try:\n    spinbench.main()\n"
        "except SystemExit as end:\n    assert not end.code\n"
        f"print('loaded:', [name for name in {HEAVY!r} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    for command in ("simulate", "sensitivity", "reproduce"):
        assert command in result.stdout
    assert "loaded: []" in result.stdout


def test_version():
    root = Path(__file__).parents[2]
    told = run("--version").stdout
    assert told.startswith("spinbench 0.")
    if (root / ".git").exists():
        command = ["git", "-C", str(root), "rev-parse", "--short", "HEAD"]
        commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
        assert f"(commit {commit}" in told
    else:
        assert "commit" not in told


@pytest.mark.parametrize(("typed", "completed"), [("di", "diagnose"), ("runs ver", "verify"), ("fit --see", "--seed")])
def test_tab_completes_commands_and_options(typed, completed, spinbench_here, monkeypatch, tmp_path):
    words = ["spinbench", *typed.split()]
    asked = {"_SPINBENCH_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    assert spinbench_here(cwd=tmp_path).stdout.split() == [completed]


def test_simulate_writes_simulation_1_with_the_steady_solvers_figures():
    result = run("simulate", "--pressure-bar-abs", "2.0", "--set", "f_overall=0.0633", "--json", "-")
    assert result.returncode == 0
    data = json.loads(result.stdout)
    found = steady(read_motor("ptm3600").with_values({"f_overall": 0.0633}), [2.0e5])
    assert data["format"] == "simulation/1"
    assert data["speed_rpm"] == pytest.approx(found.speed_rad_s[0, 0] * 9.549296585513721, rel=1e-9)
    assert data["flow_l_min"] == pytest.approx(found.flow_m3_s[0, 0] * 6e4, rel=1e-9)
    assert data["gas_torque_nm"] == pytest.approx(found.gas_torque_nm[0, 0], rel=1e-9)
    assert data["parameters"]["f_overall_n_m_s"] == 0.0633


def test_simulate_prints_a_table_and_no_json():
    result = run("simulate", "--pressure-bar-abs", "2.0")
    assert result.returncode == 0
    assert "397.06" in result.stdout
    assert "rpm" in result.stdout
    assert "{" not in result.stdout


def test_a_sweep_lists_its_points_and_warns_of_stall_and_speed_limit(tmp_path):
    result = run(
        "simulate",
        "--pressure-bar-abs",
        "1.05",
        "--to",
        "2.6",
        "--points",
        "4",
        "--json",
        "sweep.json",
        "-o",
        "out",
        cwd=tmp_path,
    )
    assert result.returncode == 0
    assert "stalls at 1.05 bar" in result.stderr
    assert "manufacturer's 600 rpm at 2.6 bar" in result.stderr
    data = json.loads((tmp_path / "sweep.json").read_text())
    assert [point["pressure_bar_abs"] for point in data["points"]] == pytest.approx(
        [1.05, 1.05 + 1.55 / 3, 2.6 - 1.55 / 3, 2.6]
    )
    assert data["points"][0]["speed_rpm"] == 0.0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["simulation.json", "simulation.png"]


@pytest.mark.parametrize(("kind", "start_s", "end_s"), [("spin-up", 0.0, 0.3), ("coast-down", -0.1, 0.3)])
def test_a_transient_writes_arrays_by_time(kind, start_s, end_s):
    result = run("simulate", "--pressure-bar-abs", "2.0", "--transient", kind, "--duration-s", "0.3", "--json", "-")
    data = json.loads(result.stdout)
    assert data["transient"] == kind
    assert (data["time_s"][0], data["time_s"][-1]) == (start_s, end_s)
    assert len(data["speed_rpm"]) == len(data["time_s"]) == len(data["angle_rad"])
    assert max(data["speed_rpm"]) == pytest.approx(395.0, rel=0.02)


def test_a_misspelt_parameter_is_refused_with_the_nearest_and_writes_nothing(tmp_path):
    result = run(
        "simulate", "--pressure-bar-abs", "2", "--set", "f_overal=0.06", "--json", "x.json", "-o", "o", cwd=tmp_path
    )
    assert "did you mean 'f_overall'?" in refused(result)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--pressure-bar-abs", "9"), "outside 0.5 to 8 bar"),
        (("--pressure-bar-abs", "nan"), "outside 0.5 to 8 bar"),
        (("--pressure-bar-abs", "1.0"), "below the ambient"),
        (("--pressure-bar-abs", "2.0", "--to", "0.9"), "below the ambient"),
        (("--pressure-bar-abs", "2.0", "--motor", "ptm360"), "no such file; did you mean 'ptm3600.toml'?"),
        (("--pressure-bar-abs", "2.0", "--motor", "missing/motor.toml"), "no such file"),
        (("--pressure-bar-abs", "2.0", "--set", "f_overall=much"), "not a number"),
        (("--pressure-bar-abs", "2.0", "--set", "cylinder_diameter=-1"), "outside"),
        (("--pressure-bar-abs", "1.02", "--transient", "coast-down"), "nothing to coast down from"),
    ],
)
def test_unusable_input_is_one_clear_line(tmp_path, spinbench_here, arguments, words):
    assert words in refused(spinbench_here("simulate", *arguments, "-o", "out", cwd=tmp_path))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_negative_flywheel_is_refused_with_its_file_its_key_and_what_to_do(tmp_path, spinbench_here, command):
    shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / "sweep")
    with (tmp_path / "sweep" / "recording.toml").open("a", encoding="utf-8") as toml:
        toml.write('[[files]]\nfile = "coast.csv"\nkind = "transient"\nadded_inertia_kg_m2 = -0.02\n')
    assert refused(spinbench_here(command, "sweep", cwd=tmp_path)) == (
        "spinbench: sweep/recording.toml: 'added_inertia_kg_m2' in [[files]] entry 2 (file = 'coast.csv') should be "
        "greater than or equal to 0 (given: -0.02); or leave it out: 0.0 is taken then\n"
    )


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "--pressure-bar-abs", "2"),
        ("reproduce",),
        ("replay", "missing", "--with-model"),
        ("runs", "export", "missing"),
    ],
)
def test_a_place_that_cannot_be_written_is_told_before_the_work(tmp_path, spinbench_here, command):
    (tmp_path / "taken").write_text("a file")
    assert "taken" in refused(spinbench_here(*command, "-o", "taken", cwd=tmp_path))


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "sweep", "--json", "sweep/sweep.csv"),
        ("diagnose", "sweep", "-o", "sweep/"),
        ("many", "fit", "sweep", "-o", "sweep"),
        ("simulate", "--pressure-bar-abs", "2", "--json", "sweep/recording.toml"),
        ("runs", "export", "last", "-o", "sweep/last.parquet"),
        ("runs", "import", "sweep/sweep.csv", "--mapping", "any.toml", "-o", "sweep"),
        ("runs", "import", "sweep/sweep.csv", "--guess", "-o", "sweep/mapping.toml"),
        ("sheet", "manual", "-o", "sweep/sheet.csv"),
    ],
)
def test_results_are_not_written_over_a_recording(tmp_path, spinbench_here, words):
    shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / "sweep")
    before = {path.name: path.read_bytes() for path in (tmp_path / "sweep").iterdir()}
    assert "sweep is a recording or run, which stays as it is; name another folder" in refused(
        spinbench_here(*words, cwd=tmp_path)
    )
    assert {path.name: path.read_bytes() for path in (tmp_path / "sweep").iterdir()} == before


def test_results_are_not_written_below_a_recording(tmp_path, spinbench_here):
    shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / "sweep")
    assert "lies in" in refused(spinbench_here("runs", "export", "last", "-o", "sweep/below/it", cwd=tmp_path))
    said = refused(spinbench_here("diagnose", "sweep", "-o", "sweep/below/it", cwd=tmp_path))
    assert f"sweep/below/it lies in {tmp_path / 'sweep'}, which is a recording or run, which stays as it is" in said
    assert not (tmp_path / "sweep" / "below").exists()


@pytest.mark.parametrize(
    "words", [("--to", "3", "--transient", "spin-up"), ("--points", "5"), ("--to", "3", "--duration-s", "1")]
)
def test_options_that_do_not_go_together_are_a_usage_error(tmp_path, spinbench_here, words):
    result = spinbench_here("simulate", "--pressure-bar-abs", "2", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert "leave" in result.stderr and "Traceback" not in result.stderr


def test_sensitivity_ranks_at_every_pressure():
    result = run("sensitivity", "--pressure-bar-abs", "1.6", "--pressure-bar-abs", "2.0", "--json", "-")
    data = json.loads(result.stdout)
    assert data["format"] == "sensitivity/1"
    assert data["pressure_bar_abs"] == [1.6, 2.0]
    first = data["ranking"][0]
    assert first["name"] == "concave_reach"
    assert len(first["speed_rpm_per_percent"]) == 2
    assert first["speed_rpm_per_prior_sd"] is None


def test_sensitivity_writes_nothing_among_the_files_of_a_recording(tmp_path):
    shutil.copytree(published_sweep(), tmp_path / "sweep")
    place = tmp_path / "sweep" / "recording.toml"
    before = place.read_bytes()
    result = run("sensitivity", "--pressure-bar-abs", "1.6", "--json", place)
    assert (result.returncode, place.read_bytes()) == (2, before)


def test_sensitivity_prints_whole_names():
    assert "cylinder_surface_radius_mm" in run("sensitivity", "--pressure-bar-abs", "2.0").stdout


@pytest.mark.long
def test_reproduce_puts_figures_and_page_where_they_are_asked_for(tmp_path):
    result = run("reproduce", "-o", "docs/figures", "--page", "docs/page.md", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    page = (tmp_path / "docs" / "page.md").read_text(encoding="utf-8")
    assert "(figures/fig11_friction.png)" in page
    assert (tmp_path / "docs" / "figures" / "fig11_friction.png").stat().st_size > 10_000
    assert (tmp_path / "docs" / "figures" / "reproduce.json").exists()


def test_only_errors_that_are_the_users_are_told_in_words():
    assert exit_code(ValueError("ours")) is None
    assert exit_code(PermissionError(13, "denied", "x")) == 2
    assert {name.rpartition(".")[0] for name in EXIT_CODES} >= {"configs", "model.operation.performance"}


@pytest.mark.parametrize("name", EXIT_CODES)
def test_an_error_with_an_exit_code_is_where_its_name_says(name):
    module, _, error = name.rpartition(".")
    found = getattr(importlib.import_module(module), error)
    assert issubclass(found, Exception)
    assert f"{found.__module__}.{found.__qualname__}" == name


def test_the_command_is_also_a_module():
    command = [sys.executable, "-m", "spinbench", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.startswith("spinbench 0.")


def on_a_terminal(stream, *arguments):
    """What a process writes to a terminal of 80 columns."""
    ours, its = os.openpty()
    environment = os.environ | {"COLUMNS": "80", "TERM": "xterm"}
    process = subprocess.Popen([sys.executable, "-m", "spinbench", *arguments], env=environment, **{stream: its})
    os.close(its)
    shown = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while more := os.read(ours, 65536):
            shown += more
    os.close(ours)
    assert process.wait(60) == 0
    return shown.decode()


def test_whoever_waits_for_the_solvers_is_told_what_for():
    shown = on_a_terminal("stderr", "simulate", "--pressure-bar-abs", "2.0", "--json", os.devnull)
    assert "the solvers are compiled" in " ".join(shown.split())


def commands_below(command, *path):
    yield path, command
    for name, below in getattr(command, "commands", {}).items():
        yield from commands_below(below, *path, name)


@pytest.mark.parametrize(("path", "command"), list(commands_below(typer.main.get_command(app))), ids=str)
def test_a_help_text_is_shown_as_it_is_written_and_switches_have_no_type(path, command):
    shown = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "300", "TERM": "dumb"}).stdout
    flat = " ".join(shown.split())
    for parameter in command.params:
        assert " ".join(parameter.help.split()) in flat
    assert "--help" in flat and "<bool>" not in flat


@pytest.mark.parametrize(("path", "command"), list(commands_below(typer.main.get_command(app))), ids=str)
def test_a_help_of_80_columns_cuts_no_name_and_no_sentence(path, command):
    shown = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "80", "TERM": "dumb"}).stdout
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    for option in (one for one in command.params if one.opts[0].startswith("-")):
        assert {*option.opts, *option.secondary_opts} <= set(shown.replace(",", " ").split())
    for name, below in getattr(command, "commands", {}).items():
        assert f"{name} {' '.join(below.help.split()).partition('. ')[0].rstrip('.')}" in " ".join(shown.split())


def test_the_list_of_runs_shows_names_whole_on_a_narrow_terminal(tmp_path):
    start = start_of(bench="bench_with_a_name_of_its_own")
    with RunWriter.create(tmp_path, start) as writer:
        writer.end("finished")
    assert next(tmp_path.iterdir()).name in on_a_terminal("stdout", "runs", "list", "--logs", str(tmp_path))


def test_a_place_for_a_comparison_that_was_not_asked_for_is_refused(tmp_path, spinbench_here):
    done = spinbench_here("replay", "last", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert "is for the comparison with the model" in done.stderr


def test_a_comparison_with_what_is_left_out_already_is_refused(spinbench_here, tmp_path):
    done = spinbench_here("fit", "published_sweep", "--speed-only", "--compare", "-o", "out", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "which --speed-only leaves out: give one of them" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("again", "says"),
    [
        (["--set", "f_overall=0.06", "--set", "f_overall=0.07"], "--set f_overall=0.07: f_overall=0.06 is given too"),
        (["--set", "port_lap=8", "--set", "port_lap_deg=9"], "--set port_lap_deg=9: port_lap=8 is given too"),
        (["--points", "3", "--points", "4"], "--points is given twice; give it once"),
        (["-o", "here", "--out", "there"], "-o/--out is given twice; give it once"),
    ],
)
def test_what_is_given_twice_is_refused_and_not_left_out_in_silence(again, says, tmp_path):
    result = run("simulate", "--pressure-bar-abs", "2", *again, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert says in result.stderr
    assert not list(tmp_path.iterdir())


def test_effects_of_each_recording_may_stand_with_commas_between_them():
    result = run("diagnose", "published_sweep", "--per-recording", "windage, leakag")
    assert "no effect is called 'leakag'; the nearest is leakage" in result.stderr
    assert "'windage, leakag'" not in refused_last(result)


def refused_last(result: subprocess.CompletedProcess[str]) -> str:
    assert result.returncode == 2, result.stderr
    return result.stderr.splitlines()[-1]


@pytest.mark.parametrize(("encoding", "shown"), [("ascii", "+- 800"), ("latin-1", "\xb1 800"), ("utf-8", "± 800")])
def test_no_result_is_lost_where_the_terminal_lacks_a_character(encoding, shown):
    program = "import spinbench; spinbench.main()"
    result = subprocess.run(
        [sys.executable, "-c", program, "sensitivity", "--pressure-bar-abs", "2"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": encoding},
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert shown in result.stdout.decode(encoding)
    assert "?" not in result.stdout.decode(encoding)


def test_several_arguments_are_shown_once_in_the_help():
    told = run("fit", "--help").stdout
    assert "{RECORDING}..." in told and "RECORDING <path>" in told
    assert "list[" not in told


@pytest.mark.parametrize("command", [["fit", "last"], ["runs", "show", "last"], ["diagnose", "last", "--with-parents"]])
def test_the_last_of_no_runs_says_that_there_is_none(command, tmp_path):
    assert "there is no run in logs yet; take one, or say with --logs where runs are" in refused(
        run(*command, cwd=tmp_path)
    )


@pytest.mark.parametrize(
    "command", [["simulate", "--pressure-bar-abs", "2", "-o", "file"], ["console", "virtual", "--logs", "file"]]
)
def test_a_file_where_a_folder_is_needed_is_told(command, tmp_path):
    (tmp_path / "file").write_text("")
    assert "file: a file, where a folder is needed; name another place" in refused(run(*command, cwd=tmp_path))


def test_powers_are_told_in_plain_characters():
    text = "p < 10⁻⁶ of 3·10⁻⁴ N m s² ☃"
    suit_the_terminal()
    assert text.encode("ascii", "plain") == b"p < 10^-6 of 3*10^-4 N m s^2 ?"


@pytest.mark.parametrize("columns", [40, 60])
def test_a_narrow_terminal_cuts_no_figure(columns):
    pexpect = pytest.importorskip("pexpect", reason="pexpect is not installed")
    program = "import spinbench; spinbench.main()"
    arguments = ["-c", program, "simulate", "--pressure-bar-abs", "1.6", "--to", "2.0", "--points", "2"]
    told = pexpect.spawn(sys.executable, arguments, dimensions=(24, columns), encoding="utf-8", timeout=120)
    told.expect(pexpect.EOF)
    figures = told.before.rpartition("─")[2]
    assert "…" not in figures
    assert figures.split()[:6] == ["1.600", "229.42", "41.54", "1.5955", "38.33", "0.808"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("e.parqet", "e.parqet: unknown ending '.parqet'; did you mean '.parquet'? known: .parquet, .h5, "),
        ("e.csv", "e.csv: unknown ending '.csv'; known: .parquet, .h5, "),
    ],
)
def test_a_misspelt_ending_makes_no_folder(tmp_path, spinbench_here, name, words):
    with RunWriter.create(tmp_path / "logs", start_of()) as writer:
        writer.end("finished")
    result = spinbench_here("runs", "export", "last", "-o", name, cwd=tmp_path)
    assert refused(result).startswith(f"spinbench: {words}")
    assert [entry.name for entry in tmp_path.iterdir()] == ["logs"]


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "published_sweep", "-o", "x.json"),
        ("diagnose", "published_sweep", "-o", "x.HTML"),
        ("simulate", "--pressure-bar-abs", "2", "-o", "x.png"),
    ],
)
def test_a_folder_that_is_called_like_a_file_is_refused(tmp_path, spinbench_here, words):
    told = refused(spinbench_here(*words, cwd=tmp_path))
    assert told.startswith(f"spinbench: {words[-1]}: '.") and told.endswith("a folder is written; name a folder\n")
    assert not list(tmp_path.iterdir())


def test_a_place_in_which_nothing_can_be_made_is_refused_before_the_work(tmp_path, spinbench_here):
    """Root may write into /proc by its permissions, and still nothing can be made there."""
    assert refused(spinbench_here("fit", "published_sweep", "-o", "/proc/x", cwd=tmp_path)).startswith(
        "spinbench: /proc: "
    )


def test_a_folder_of_runs_that_is_none_is_refused(tmp_path, spinbench_here):
    (tmp_path / "notes.md").write_text("no runs")
    told = refused(spinbench_here("runs", "list", "--logs", "notes.md", cwd=tmp_path))
    assert told == "spinbench: notes.md: a file, where the folder of runs is to be; name another with --logs\n"
    told = refused(spinbench_here("runs", "show", "last", "--logs", "notes.md", cwd=tmp_path))
    assert told == "spinbench: notes.md: a file, where the folder of runs is to be; name another with --logs\n"
    told = refused(spinbench_here("runs", "list", "--logs", "nope", cwd=tmp_path))
    assert told == "spinbench: nope: there is no such folder; name with --logs the one that runs are in\n"
    nothing = spinbench_here("runs", "list", cwd=tmp_path)
    assert (nothing.returncode, nothing.stderr) == (0, "no runs in logs: there is no such folder\n")
