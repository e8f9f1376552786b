"""The packages that only some commands need: without one, the others work, and those that need it say so at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.rig.runlog.test_runlog_import import COLUMNS, HEAD
from tests.synthetic_runs import write_sweep

OF_FILES = ("asammdf", "h5netcdf", "h5py", "nptdms", "pyarrow")
EXTRAS = (*OF_FILES, "arviz", "cryptography", "distributed", "dask", "paho", "xarray")
WITHOUT = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
absent = sys.argv.pop(1).split(",")
sys.meta_path.insert(0, Absent())
"""
RUN = WITHOUT + "import spinbench\nspinbench.main()\n"
IMPORT_ALL = (
    WITHOUT
    + """
import importlib, pkgutil
for room in ("spinbench", "rig", "model", "calibration", "configs"):
    for module in pkgutil.walk_packages(importlib.import_module(room).__path__, f"{room}."):
        importlib.import_module(module.name)
print(sorted({name.partition(".")[0] for name in sys.modules} & set(absent)))
"""
)


def without(absent: str, *words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", RUN, absent, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120, check=False)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    write_sweep(tmp_path / "logs")
    return tmp_path / "logs"


@pytest.mark.long
def test_no_module_needs_them_to_be_imported():
    command = [sys.executable, "-c", IMPORT_ALL, ",".join(EXTRAS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "[]\n", done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("absent", "extra", "words"),
    [
        ("cryptography", "seal", "challenge make campaign --cases 1"),
        ("cryptography", "seal", "challenge score campaign"),
        ("cryptography", "seal", "reveal seal"),
        ("cryptography", "seal", "sweep virtual --conceal seal"),
        ("cryptography", "seal", "virtual virtual --state state --conceal seal"),
        ("distributed", "cluster", "challenge run campaign --scheduler tcp://localhost:1"),
        ("distributed", "cluster", "challenge score campaign --scheduler tcp://localhost:1"),
        ("distributed", "cluster", "many diagnose recording -o out --scheduler tcp://localhost:1"),
        ("distributed", "cluster", "many fit recording -o out --scheduler tcp://localhost:1"),
        ("paho", "mqtt", "console virtual --mqtt localhost"),
        ("pyarrow", "formats", "challenge run campaign"),
        ("pyarrow", "formats", "many diagnose recording -o out"),
        ("pyarrow", "formats", "many fit recording -o out"),
    ],
)
def test_a_command_without_its_package_says_what_to_install_and_writes_nothing(tmp_path, absent, extra, words):
    done = without(absent, *words.split(), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.endswith(
        f'needs the package {absent}, which is not installed; install it with `pip install "spinbench[{extra}]"`'
    )
    assert not list(tmp_path.iterdir())


def test_an_export_as_parquet_without_pyarrow_writes_nothing(logs, tmp_path):
    done = without("pyarrow", "runs", "export", "last", "-o", "run.parquet", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        'spinbench: a Parquet file needs the package pyarrow; install it with `pip install "spinbench[formats]"`\n'
    )
    assert [entry.name for entry in tmp_path.iterdir()] == ["logs"]


def test_an_import_of_tdms_without_nptdms_writes_nothing(tmp_path):
    (tmp_path / "mapping.toml").write_text(HEAD.replace('"csv"', '"tdms"') + COLUMNS, encoding="utf-8")
    (tmp_path / "data.tdms").write_bytes(b"")
    done = without("nptdms", "runs", "import", "data.tdms", "--mapping", "mapping.toml", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        'spinbench: a TDMS file needs the package npTDMS; install it with `pip install "spinbench[formats]"`\n'
    )
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["data.tdms", "mapping.toml"]


def test_a_run_is_listed_and_exported_without_any_of_them_as_with_them(logs, tmp_path):
    assert "finished" in without(",".join(EXTRAS), "runs", "list", cwd=tmp_path).stdout
    for absent, out in ((",".join(EXTRAS), "without"), ("nothing", "with")):
        done = without(absent, "runs", "export", "last", "-o", out, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    for file in (tmp_path / "with").iterdir():
        assert (tmp_path / "without" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.long
@pytest.mark.parametrize(("absent", "kept"), [("arviz", False), ("nothing", True)])
def test_a_fit_keeps_its_draws_for_arviz_where_that_is_installed(tmp_path, absent, kept):
    done = without(absent, "fit", "published_sweep", "-o", "out", "--effective-samples", "200", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "posterior.json").exists()
    assert (tmp_path / "out" / "posterior.nc").exists() == kept
    assert "Warning" not in done.stderr
