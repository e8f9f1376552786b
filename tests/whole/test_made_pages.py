"""The Python reference and the notebooks: as `make pages` makes them now, and the notebooks run."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import spinbench
from scripts import notebooks, python_reference
from tests.documented_commands import ROOT, commands_of, fresh_copy, not_in
from tests.documented_python import cells_of

NAMES = [tutorial.stem for tutorial in notebooks.TUTORIALS]
STALE = "not as the code has it: run `make pages`"


def code_of(name: str) -> list[str]:
    """The code cells of a notebook, without the one that it begins with."""
    cells = json.loads((notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"][1:]


def text_of(tutorial: str) -> str:
    return (ROOT / "docs" / "tutorials" / f"{tutorial}.md").read_text(encoding="utf-8")


def test_the_python_reference_is_made_from_the_docstrings() -> None:
    assert python_reference.PAGE.read_text(encoding="utf-8") == python_reference.page(), STALE


def test_the_python_reference_has_every_public_name_and_what_the_functions_give() -> None:
    told = re.findall(r"^### (\w+)$", python_reference.page(), re.MULTILINE)
    given = [place.partition(":")[2] for place in python_reference.GIVEN]
    assert told == [*(name for name in spinbench.__all__ if name != "main"), *given]


def test_what_a_function_of_the_reference_takes_gives_and_raises_is_told() -> None:
    told = python_reference.page().partition("\n### diagnose\n")[2].partition("\n### ")[0]
    assert "    workers: int = 1,\n) -> DiagnosisResult\n" in told
    assert "\n- `hold_out` (Opened, Recording, str or Path, optional): A recording that is kept back" in told
    assert "\nRaises:\n\n- [`RecordingError`](#recordingerror): When a recording cannot be used" in told


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_made_from_its_tutorial(name: str) -> None:
    text = (notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    assert text == notebooks.notebook(ROOT / "docs" / "tutorials" / f"{name}.md"), STALE
    nbformat.validate(json.loads(text))


def test_there_is_a_notebook_of_each_tutorial_and_no_other() -> None:
    assert {path.name for path in notebooks.FOLDER.iterdir()} == {f"{name}.ipynb" for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_every_block_of_code_of_a_tutorial_is_a_cell(name: str) -> None:
    blocks = re.findall(r"^```(?:python|sh)\n(.*?)\n```$", text_of(name), re.MULTILINE | re.DOTALL)
    assert blocks == [re.sub(r"\A%%bash.*\n", "", code) for code in code_of(name)]


@pytest.mark.parametrize("name", NAMES)
def test_a_link_of_a_notebook_leads_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)#]+)", (notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert links
    assert [link for link in links if not (notebooks.FOLDER / link).exists()] == []


LIVE = ("first-verdict",)  # its sweep is disturbed where the machine does something else


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.live] if one in LIVE else []) for one in NAMES])
def test_a_notebook_runs_and_its_cells_show_what_the_tutorial_says(tmp_path: Path, name: str) -> None:
    copy = tmp_path / "copy"
    fresh_copy(copy, kernels=True)
    book = nbformat.read(copy / "docs" / "notebooks" / f"{name}.ipynb", as_version=4)
    client = NotebookClient(book, timeout=1800, resources={"metadata": {"path": str(copy / "docs" / "notebooks")}})
    client.execute(env=os.environ | {"PYTHONPATH": str(copy), "COLUMNS": "250", "XDG_STATE_HOME": str(tmp_path)})
    pages = iter(cells_of(f"docs/tutorials/{name}.md"))
    for cell in [cell for cell in book.cells if cell.cell_type == "code"][1:]:
        outputs = sorted(cell.outputs, key=lambda one: one.get("name") == "stderr")  # the two come in any order
        said = "".join(one.get("text") or one.get("data", {}).get("text/plain", "") for one in outputs)
        if cell.source.startswith("%%bash"):
            commands = commands_of(name, f"```sh\n{cell.source.partition(chr(10))[2]}\n```\n")
            shown = [line for command in commands for line in command.shown]
            assert "\x1b" not in said  # a notebook is no terminal
        else:
            shown = ["…".join(next(pages).shown.splitlines())]
        assert [piece for piece in (not_in(said, line) for line in shown) if piece is not None] == [], said
