"""The Python of a page, run as a person would run the cells of a notebook.

A cell is a ``python`` block. What it prints, and what its last line amounts to, must have in it what a ``text`` block
behind it shows, line after line, where ``...`` or ``…`` stands for anything.
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from tests.documented_commands import ROOT, not_in

CELL = re.compile(r"^```python\n(.*?)^```\n(?:\n^```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL)
PAGES = ("docs/python.md", "docs/tutorials/own-machine.md")


@dataclass(frozen=True)
class Cell:
    """A block of a page, and what the page shows of its output."""

    place: str
    code: str
    shown: str


def cells_of(page: str) -> list[Cell]:
    """The cells of a page in order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        Cell(f"{page}:{text.count(chr(10), 0, match.start(1)) + 1}", match[1], match[2] or "")
        for match in CELL.finditer(text)
    ]


def run(cells: Iterable[Cell]) -> list[str]:
    """Run cells in one session, in the folder that is current; what is not as the page says."""
    names: dict[str, Any] = {"__name__": "notebook"}
    wrong = []
    for cell in cells:
        tree, said = ast.parse(cell.code), io.StringIO()
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        with contextlib.redirect_stdout(said):
            exec(compile(tree, cell.place, "exec", dont_inherit=True), names)  # noqa: S102  # a page of this repository
            if isinstance(last, ast.Expr):
                value = eval(ast.unparse(last.value), names)  # noqa: S307
                print("" if value is None else value)
        piece = not_in(said.getvalue(), "…".join(cell.shown.splitlines()))
        wrong += [] if piece is None else [f"{cell.place}: does not show '{piece}': {said.getvalue()}"]
    return wrong
