"""The program as a user installs it: the wheel in an environment where no checkout can be imported."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"spinbench", "rig", "model", "calibration", "configs"}
# Python alone is quicker for a point or two than compiling the solvers anew in every fresh environment.
ENVIRONMENT = {"NUMBA_DISABLE_JIT": "1", "COLUMNS": "200", "PYTHONNOUSERSITE": "1"}


def environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | ENVIRONMENT


@dataclass(frozen=True)
class Installed:
    """The wheel, the environment it is in, and a folder far from the checkout to work in."""

    wheel: Path
    bin: Path
    work: Path

    def run(self, *words: object, program: str = "spinbench", code: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [str(self.bin / program), *map(str, words)],
            cwd=self.work,
            env=environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
        return done


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Installed:
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    build = [*pip, "wheel", "--no-deps", "--no-index", "--no-build-isolation", "-w", str(folder / "wheels"), str(ROOT)]
    subprocess.run(build, check=True, timeout=120)
    (wheel,) = (folder / "wheels").iterdir()
    venv.create(folder / "venv", symlinks=True)
    scripts = folder / "venv" / "bin"
    place = [sys.executable, "-m", "pip", "--python", str(scripts / "python"), *pip[3:]]
    subprocess.run([*place, "install", "--no-deps", "--no-index", str(wheel)], check=True, timeout=120)
    # What this environment has, but not the checkout that a .pth file in it leads to: such a file counts only at home.
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    (site / "dependencies.pth").write_text(f"{sysconfig.get_paths()['purelib']}\n", encoding="utf-8")
    (folder / "work").mkdir()
    return Installed(wheel, scripts, folder / "work")


def test_the_wheel_holds_the_packages_and_the_published_sweep_and_nothing_else(installed):
    names = zipfile.ZipFile(installed.wheel).namelist()
    assert {name.partition("/")[0] for name in names if ".dist-info/" not in name} == PACKAGES
    for name in ("recording.toml", "sweep.csv"):
        assert (
            zipfile.ZipFile(installed.wheel).read(f"spinbench/published_sweep/{name}")
            == (ROOT / "logs" / "published_sweep" / name).read_bytes()
        )
    assert not [name for name in names if name.startswith("calibration/studies")]
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    console = {path.relative_to(ROOT).as_posix() for path in (ROOT / "spinbench/console/static").iterdir()}
    assert len(console) == 6
    assert console <= set(names)
    of_the_wheel = {name for name in names if name.startswith("configs/")}
    here = (path for path in (ROOT / "configs").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    assert of_the_wheel == {path.relative_to(ROOT).as_posix() for path in here}


def test_it_is_what_runs_and_the_checkout_cannot_be_imported(installed):
    program = "import sys, spinbench, rig, configs; print(spinbench.__file__, rig.__file__, configs.__file__, sys.path)"
    told = installed.run("-c", program, program="python").stdout
    assert str(installed.bin.parent) in told
    assert f"'{ROOT}'" not in told
    assert (
        "No module named"
        in subprocess.run(
            [installed.bin / "python", "-c", "import tests"], cwd=installed.work, capture_output=True, text=True
        ).stderr
    )


def test_its_help_and_version(installed):
    assert "simulate" in installed.run("--help").stdout
    assert installed.run("--version").stdout.startswith("spinbench 0.")
    assert installed.run("-m", "spinbench", "--version", program="python").stdout.startswith("spinbench 0.")


def test_it_finds_its_motor(installed):
    assert "397.06" in installed.run("simulate", "--pressure-bar-abs", "2.0").stdout


def test_it_finds_its_bench_and_serves_it(installed):
    command = [installed.bin / "spinbench", "virtual", "virtual", "--state", "bench"]
    with subprocess.Popen(
        command, cwd=installed.work, env=environment(), stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as bench:
        said = bench.stderr.readline()
        bench.send_signal(signal.SIGINT)
        assert bench.wait(60.0) == 0
    assert said == "serving virtual until Ctrl-C; bench/ports.json tells the ports\n"


def test_it_finds_the_published_sweep_by_its_name(installed):
    """The fit reads it before it refuses the effect."""
    told = installed.run("fit", "published_sweep", "--effects", "leakge", code=2).stderr
    assert "leakage" in told
    (installed.work / "published_sweep").mkdir()  # a folder of the user's comes first
    assert "recording.toml" in installed.run("fit", "published_sweep", code=2).stderr


def test_its_runs_are_those_of_the_folder_that_it_is_started_in(installed):
    assert installed.run("runs", "list").stderr == "no runs in logs: there is no such folder\n"


def test_it_has_no_ledger_of_its_own(installed):
    told = installed.run("challenge", "ledger", code=2).stderr
    assert told == "spinbench: this program is in no repository with a ledger; name yours with --ledger FILE\n"
