"""What several rooms of the tests share: recordings as a person would put them on disk."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

# Before numpy is there. The matrices are small: a second thread of BLAS only waits, and takes a core while it does.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # the processes share the cores

import hypothesis
import pytest

import spinbench
from tests import declared

# Started in the background of a shell, a process inherits that Ctrl-C is ignored, and so would those that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time: a run that passed here passes anywhere.
hypothesis.settings.register_profile("fixed", derandomize=True, deadline=None)
hypothesis.settings.load_profile("fixed")

AMBIENT = "[ambient]\npressure_bar_abs = 1.01325\npressure_sd_bar = 0.0015\ntemperature_c = 20.0\n"


# Seconds that files take, the longest first: in that order they go, so that the processes end together. `make quick`
# leaves these files out.
SLOW = {
    "test_fit": 110,
    "test_console_page": 150,
    "test_second_rig": 100,
    "test_whole": 100,
    "test_chain": 100,
    "test_running": 92,
    "test_continued": 90,
    "test_diagnosis_verdict": 80,
    "test_challenge_command": 75,
    "test_sbc": 65,
    "test_changes": 55,
    "test_with_parents": 50,
    "test_nulls": 47,
    "test_diagnosis_search": 42,
    "test_concealed_bench": 40,
    "test_live_check": 40,
    "test_commands_of_the_docs": 51,
    "test_several_recordings": 37,
    "test_diagnosis_side_by_side": 32,
    "test_left_out": 31,
    "test_diagnosis_page": 30,
    "test_fit_effects": 29,
    "test_fit_quality": 28,
    "test_sampling": 26,
    "test_acquisition": 26,
    "test_second_rig_supply": 24,
    "test_fit_page": 22,
    "test_virtual_bus": 22,
    "test_console_terminal": 22,
    "test_rigs_diagnosis": 22,
    "test_per_recording": 20,
    "test_readings_as_they_come": 20,
    "test_diagnosis_abrupt": 20,
    "test_kills": 19,
    "test_diagnosis_undetected": 18,
    "test_lines": 17,
    "test_doctor": 17,
    "test_interlock_watchdog": 16,
    "test_exchange_binary": 16,
    "test_bench": 15,
    "test_cli": 15,
    "test_exchange_guess": 13,
    "test_evidence": 13,
    "test_extras": 13,
    "test_diagnosis_law": 13,
    "test_demonstrations": 13,
    "test_trend": 12,
    "test_python_door": 12,
    "test_python_of_the_docs": 10,
    "test_exchange_fuzz": 10,
    "test_recording": 12,
    "test_drift": 12,
    "test_virtual_process": 12,
    "test_diagnosis_tails": 10,
    "test_sweep_virtual": 9,
    "test_replay": 9,
    "test_diagnosis_standing": 8,
    "test_many": 8,
    "test_recording_clock": 8,
    "test_installed": 8,
    "test_clock_and_range": 6,
    "test_diagnosis_next_test": 6,
    "test_run_page": 6,
    "test_runlog_import": 6,
    "test_likelihood": 5,
    "test_challenge_campaign": 4,
    "test_reproduction": 3,
    "test_demo_page": 3,
}


# Their long tests run a bench, a sweep and a watchdog at once.
LIVE = {
    "test_chain",
    "test_concealed_bench",
    "test_console_entries",
    "test_console_page",
    "test_console_starts",
    "test_console_terminal",
    "test_kills",
    "test_live_check",
    "test_running",
    "test_sweep_virtual",
    "test_with_parents",
}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where no slow test is wanted, a slow file need not be read."""
    return True if "not slow" in config.getoption("markexpr") and collection_path.stem in SLOW else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow files and put the longest first; within a file the order stays."""
    order = list(SLOW)
    for item in items:
        if item.path.stem in SLOW:
            item.add_marker(pytest.mark.slow)
        if item.path.stem in LIVE and item.get_closest_marker("long"):
            item.add_marker(pytest.mark.live)
    items.sort(key=lambda item: order.index(item.path.stem) if item.path.stem in SLOW else len(order))


@pytest.fixture
def spinbench_here(monkeypatch, capsys) -> Callable[..., subprocess.CompletedProcess[str]]:
    """The command line in this process, from arguments to exit code: a process of its own takes a second to start."""

    def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
        words = ["spinbench", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", words)
        monkeypatch.chdir(cwd)
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            spinbench.main()
        out, err = capsys.readouterr()
        return subprocess.CompletedProcess(words, end.value.code or 0, out, err)

    return run


@pytest.fixture(scope="session")
def spinbench_anywhere() -> Callable[..., subprocess.CompletedProcess[str]]:
    """The same for fixtures that several tests share."""

    def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
        words = ["spinbench", *map(str, arguments)]
        said = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)]
        with (
            pytest.MonkeyPatch.context() as patched,
            contextlib.redirect_stdout(said[0]),
            contextlib.redirect_stderr(said[1]),
            pytest.raises(SystemExit) as end,
        ):
            patched.setattr(sys, "argv", words)
            patched.chdir(cwd)
            spinbench.main()
        out, err = (stream.buffer.getvalue().decode("utf-8") for stream in said)
        return subprocess.CompletedProcess(words, end.value.code or 0, out, err)

    return run


@pytest.fixture
def put_recording(tmp_path: Path) -> Callable[..., Path]:
    """Writes a recording of files given as (name, kind, csv), each instrument with its figures of `declared`."""

    def put(*files: tuple[str, str, str], ambient: str = AMBIENT, more: str = "", name: str = "bench") -> Path:
        folder = tmp_path / name
        folder.mkdir()
        headers = ",".join(csv.partition("\n")[0] for _, _, csv in files).split(",")
        told = declared.channels(column for column in declared.FIGURES if column in headers)
        toml = f'format = "recording/1"\nmotor = "ptm3600"\n{ambient}{more}{told}'
        for file, kind, csv in files:
            toml += f'[[files]]\nfile = "{file}"\nkind = "{kind}"\n'
            (folder / file).write_text(csv, encoding="utf-8")
        (folder / "recording.toml").write_text(toml, encoding="utf-8")
        return folder

    return put
