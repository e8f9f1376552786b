"""A page from its template, every text in it escaped, and what all pages are made of."""

from __future__ import annotations

import base64
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

HTML, PNG = "report.html", "report.png"
PACKAGES = ("spinbench", "numpy", "scipy", "numba", "emcee")


@dataclass(frozen=True)
class Grid:
    """A table of the page: text only, the first ``words`` columns to the left, the others to the right."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1


def render(template: str, filled: Mapping[str, Any]) -> bytes:
    """The page, UTF-8; in Markdown nothing is escaped."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("calibration.report"),
        autoescape=jinja2.select_autoescape(["html.j2"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page = environment.get_template(template).render(filled)
    return page.encode(errors="backslashreplace")  # the name of a file may hold any bytes


def inline(png: bytes) -> str:
    """A picture as the address of itself."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


def findings(rows: Iterable[tuple[str, str]]) -> Table:
    """A table for the terminal: what, and what was found. A name of a file is no markup."""
    from rich.markup import escape
    from rich.table import Table

    made = Table("what", "finding", show_header=False)
    for row in rows:
        made.add_row(*map(escape, row))
    return made


def step_times(seconds: Mapping[str, float]) -> Grid:
    """How long each step took [s]."""
    return Grid(("step", "time, s"), tuple((step, f"{one:.2f}") for step, one in seconds.items()))


def versions() -> str:
    """Of Python and of the packages that a result hangs on."""
    return ", ".join([f"Python {platform.python_version()}", *map(_version, PACKAGES)])


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} not installed"
