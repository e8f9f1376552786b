"""Every Python block of the pages that have some runs as it stands there, and shows what the page says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import spinbench
from calibration.systems.machines.system import systems
from rig.recording import schema
from tests.documented_commands import ROOT
from tests.documented_python import PAGES, cells_of, run
from tests.synthetic_runs import write_sweep


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A folder with a run in its logs; machines that a page adds are gone after it."""
    write_sweep(tmp_path / "logs")
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(schema, "_OTHER_RIGS", dict(schema._OTHER_RIGS))
    yield
    systems.cache_clear()


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    "page", [pytest.param(one, marks=[pytest.mark.long] if one == "docs/python.md" else []) for one in PAGES]
)
def test_the_cells_of_a_page_show_what_it_says(page: str) -> None:
    wrong = run(cells_of(page))
    assert not wrong, "\n".join(wrong)


def test_a_page_with_python_is_run_or_is_code_of_the_program() -> None:
    pages = (ROOT / "docs").rglob("*.md")
    found = {page.relative_to(ROOT).as_posix() for page in pages if "```python\n" in page.read_text(encoding="utf-8")}
    assert found == set(PAGES)
    for page in PAGES:
        assert len(cells_of(page)) == (ROOT / page).read_text(encoding="utf-8").count("```python\n")


def test_every_name_is_on_its_page_and_no_other() -> None:
    table = (ROOT / "docs" / "python.md").read_text(encoding="utf-8").partition("## All names")[2]
    named = {name for row in re.findall(r"^\| (`.+?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert named == set(spinbench.__all__) - {"main"}
