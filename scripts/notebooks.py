"""Write docs/notebooks/*.ipynb from the tutorials: their blocks of Python and of commands become cells."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1] / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
FOLDER = DOCS / "notebooks"  # as deep as the tutorials, so that their links lead on
MARKS = re.compile(r"(?:<!-- run: .+ -->\n)+\n?")
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
MADE = """
This is [the tutorial]({link}) as a notebook, made from its text. Run the next cell first: it goes to the repository's
root, where everything is run, and lets the commands be found.
"""
BEGIN = """\
import os
import sys
from pathlib import Path

os.chdir(next(at for at in (Path.cwd(), *Path.cwd().parents) if (at / "pyproject.toml").is_file()))
os.environ.pop("FORCE_COLOR", None)  # or bars are drawn for a terminal
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
"""


def notebook(tutorial: Path) -> str:
    """A tutorial as a notebook without outputs."""
    text = MARKS.sub("", tutorial.read_text(encoding="utf-8"))
    title, _, text = text.partition("\n")
    cells = [("markdown", title + "\n" + MADE.format(link=f"../tutorials/{tutorial.name}")), ("code", BEGIN)]
    at = 0
    for block in BLOCK.finditer(text):
        code = block[2] if block[1] == "python" else _bash(block[2])
        cells += [("markdown", text[at : block.start()]), ("code", code)]
        at = block.end()
    cells.append(("markdown", text[at:]))
    made = [_cell(kind, source.strip(), number) for number, (kind, source) in enumerate(cells) if source.strip()]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    document = {"cells": made, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, ensure_ascii=False, indent=1) + "\n"


def _bash(commands: str) -> str:
    """A cell of commands; where one is shown to fail, the notebook goes on."""
    return f"%%bash{' --no-raise-error' if '# exit code' in commands else ''}\n{commands}"


def _cell(kind: str, source: str, number: int) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}}
    cell |= {"execution_count": None, "outputs": []} if kind == "code" else {}
    return cell | {"source": source.splitlines(keepends=True)}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for tutorial in TUTORIALS:
        (FOLDER / f"{tutorial.stem}.ipynb").write_text(notebook(tutorial), encoding="utf-8")
