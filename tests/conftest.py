"""What several rooms of the tests share: recordings as a person would put them on disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

# Before numpy is there. The matrices are small: a second thread of BLAS only waits, and takes a core while it does.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest

import spinbench

# Started in the background of a shell, a process inherits that Ctrl-C is ignored, and so would those that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time: a run that passed here passes anywhere.
hypothesis.settings.register_profile("fixed", derandomize=True, deadline=None)
hypothesis.settings.load_profile("fixed")

AMBIENT = "[ambient]\npressure_bar_abs = 1.01325\npressure_sd_bar = 0.0015\ntemperature_c = 20.0\n"
# noise_sd, bias_sd, scale_sd, resolution
FIGURES = {
    "pressure_bar_abs": (0.0015, 0.005, 0.002, 0.001),
    "pressure_bar_gauge": (0.0015, 0.005, 0.002, 0.001),
    "flow_l_min": (0.5, 0.5, 0.02, 0.5),
    "speed_rpm": (0.4, 0.1, 0.0005, 0.1),
}


# Files that take longest go first: the two processes then end together. The second has kernels of its own, so that the
# two do not begin by compiling the same ones.
LONGEST = (
    "test_fit",
    "test_second_rig",
    "test_sbc",
    "test_running",
    "test_live_check",
    "test_cli",
    "test_challenge_command",
    "test_kills",
    "test_sampling",
    "test_nulls",
    "test_fit_page",
    "test_diagnosis_verdict",
    "test_bench",
    "test_rigs_diagnosis",
    "test_diagnosis_page",
    "test_virtual_process",
    "test_lines",
    "test_diagnosis_search",
    "test_fit_effects",
    "test_diagnosis_side_by_side",
    "test_evidence_check",
    "test_doctor",
    "test_acquisition",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; within a file the order stays."""

    def rank(item: pytest.Item) -> int:
        name = item.path.stem
        return LONGEST.index(name) if name in LONGEST else len(LONGEST)

    items.sort(key=rank)


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


@pytest.fixture
def put_recording(tmp_path: Path) -> Callable[..., Path]:
    """Writes a recording of files given as (name, kind, csv), each instrument with the figures above."""

    def put(*files: tuple[str, str, str], ambient: str = AMBIENT, more: str = "", name: str = "bench") -> Path:
        folder = tmp_path / name
        folder.mkdir()
        headers = ",".join(csv.partition("\n")[0] for _, _, csv in files).split(",")
        toml = f'format = "recording/1"\nmotor = "ptm3600"\n{ambient}{more}'
        for column in FIGURES:
            if column in headers:
                figures = zip(("noise_sd", "bias_sd", "scale_sd", "resolution"), FIGURES[column], strict=True)
                toml += f"[channels.{column}]\n" + "".join(f"{key} = {value}\n" for key, value in figures)
        for file, kind, csv in files:
            toml += f'[[files]]\nfile = "{file}"\nkind = "{kind}"\n'
            (folder / file).write_text(csv, encoding="utf-8")
        (folder / "recording.toml").write_text(toml, encoding="utf-8")
        return folder

    return put
