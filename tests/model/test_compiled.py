"""What is compiled and kept is made anew when a file changes that went into it."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from configs import sources

ROOT = Path(__file__).resolve().parents[2]
OUTER = """
from configs.compiled import njit
from model import layout_of_it as at
from model.inner import inner

@njit(cache=True)
def outer(x):
    return inner(x) + at.MORE

print(outer(1), sum(outer.stats.cache_hits.values()))
"""
INNER = """
from configs.compiled import njit

@njit(cache=True)
def inner(x):
    return {factor} * x
"""


@pytest.mark.parametrize(
    "kept", ["beside the source", pytest.param("in a folder of the user's", marks=pytest.mark.long)]
)
def test_a_caller_is_compiled_anew_when_what_it_calls_or_a_constant_changes(tmp_path: Path, kept: str) -> None:
    shutil.copytree(ROOT / "configs", tmp_path / "configs", ignore=shutil.ignore_patterns("__pycache__"))
    package = tmp_path / "model"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "outer.py").write_text(OUTER)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    if kept != "beside the source":
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "kept")

    def answer(factor: int, more: int) -> str:
        (package / "inner.py").write_text(INNER.format(factor=factor))
        (package / "layout_of_it.py").write_text(f"MORE = {more}\n")
        done = subprocess.run(
            [sys.executable, "-m", "model.outer"],
            cwd=tmp_path,
            env=environment | {"PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    assert [answer(2, 0), answer(2, 0), answer(3, 0), answer(3, 0), answer(3, 4)] == ["2 0", "2 1", "3 0", "3 1", "7 0"]
    folder = tmp_path / ("kept" if kept != "beside the source" else "model")
    assert any(folder.rglob("outer.outer-*.nbc"))


def test_all_kernels_are_compiled_by_the_decorator_that_sees_what_they_import() -> None:
    for path in _sources():
        if path.name != "compiled.py":
            assert "import njit" not in path.read_text(encoding="utf-8").replace(
                "from configs.compiled import njit", ""
            )


def test_imports_are_those_that_python_s_own_parser_finds() -> None:
    for path in _sources():
        assert set(sources.imports_of(path)) == _parsed(path), path


def test_a_file_of_another_project_is_not_ours(tmp_path: Path) -> None:
    assert not sources.is_ours(str(tmp_path / "model" / "air.py"))
    assert not sources.is_ours(str(ROOT / "tests" / "model" / "test_compiled.py"))
    assert sources.is_ours(str(ROOT / "model" / "layout.py"))


def _parsed(path: Path) -> set[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return set(sources.ours_among(names))


def _sources() -> list[Path]:
    return [path for name in sources.OURS for path in (ROOT / name).rglob("*.py")]
