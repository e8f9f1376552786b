"""What was measured, as rows of one table: for the terminal, as JSON, and as a block of the page."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import groupby

import numba
from rich.table import Table

BEGIN = "<!-- begin: written by tests/bench/run.py --page; change the code, not this block -->"
END = "<!-- end -->"
PACKAGES = ("numpy", "numba", "scipy", "emcee", "dynesty")


@dataclass(frozen=True)
class Row:
    """One comparison.

    Attributes
    ----------
    topic, what : str
        Heading, and what was measured.
    ours, peer : float or None
        The two figures; None where there is none.
    unit : str
        Of both.
    more_is_better : bool
        For rates; less is better for times and errors.
    ratio_goal : float or None
        Least ratio wanted [-].
    most : float or None
        Most that ours may be, in the unit.
    note : str
        Conditions in a few words.
    """

    topic: str
    what: str
    ours: float | None
    peer: float | None
    unit: str
    more_is_better: bool = False
    ratio_goal: float | None = None
    most: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times better ours is than the peer's [-]."""
        if self.ours is None or self.peer is None:
            return None
        above, below = (self.ours, self.peer) if self.more_is_better else (self.peer, self.ours)
        return above / below if below > 0.0 else math.inf

    @property
    def goal(self) -> str:
        """The goal in words; empty without one."""
        if self.ratio_goal is not None:
            return f"{self.ratio_goal:g} times"
        return f"below {self.most:g} {self.unit}".strip() if self.most is not None else ""

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal or a figure."""
        if self.ratio_goal is not None and self.ratio is not None:
            return self.ratio >= self.ratio_goal
        if self.most is not None and self.ours is not None:
            return self.ours < self.most
        return None


def machine() -> dict[str, str | int]:
    """What the figures were taken on: processor cores, Python and the packages that matter."""
    found: dict[str, str | int] = {"cores": numba.config.NUMBA_NUM_THREADS, "python": platform.python_version()}
    return found | {name: version(name) for name in PACKAGES}


def as_json(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The rows with their ratios and goals, ready for `json.dumps`.

    Parameters
    ----------
    rows : sequence of Row
        What was measured, each in its own unit.
    """
    return [
        {
            "topic": row.topic,
            "what": row.what,
            "ours": row.ours,
            "peer": row.peer,
            "unit": row.unit,
            "ratio": row.ratio,
            "goal": row.goal,
            "met": row.met,
            "note": row.note,
        }
        for row in rows
    ]


def table(rows: Sequence[Row]) -> Table:
    """The rows for the terminal.

    Parameters
    ----------
    rows : sequence of Row
        What was measured, each in its own unit.
    """
    found = Table(title="spinbench against its peers")
    for name in ("what", "ours", "peer", "unit", "times better", "goal", "met"):
        found.add_column(name, justify="right" if name in ("ours", "peer", "times better") else "left")
    for topic, group in groupby(rows, lambda row: row.topic):
        found.add_section()
        found.add_row(f"[bold]{topic}[/bold]")
        for row in group:
            found.add_row(*_cells(row))
    return found


def page_block(rows: Sequence[Row], conditions: dict[str, str | int]) -> str:
    """The block of the page, its marks included.

    Parameters
    ----------
    rows : sequence of Row
        What was measured, each in its own unit.
    conditions : dict
        Of `machine`.
    """
    lines = [BEGIN, "", "Taken on: " + ", ".join(f"{name} {value}" for name, value in conditions.items()) + ".", ""]
    for topic, group in groupby(rows, lambda row: row.topic):
        lines += [f"### {topic}", "", "| what | ours | peer | unit | times better | goal | met | conditions |"]
        lines += ["|---|---|---|---|---|---|---|---|"]
        lines += ["| " + " | ".join((*_cells(row), row.note)) + " |" for row in group]
        lines.append("")
    return "\n".join([*lines, END])


def with_block(page: str, block: str) -> str:
    """The page with its generated block renewed.

    Parameters
    ----------
    page : str
        Text that holds both marks.
    block : str
        Of `page_block`.

    Raises
    ------
    ValueError
        When the page has no marks.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page has no block between {BEGIN!r} and {END!r}")
    return before + block + after


def _cells(row: Row) -> tuple[str, ...]:
    met = {None: "", True: "yes", False: "NO"}[row.met]
    return (row.what, _figure(row.ours), _figure(row.peer), row.unit, _figure(row.ratio), row.goal, met)


def _figure(value: float | None) -> str:
    """Three significant digits, without an exponent where the figure can be read at a glance."""
    if value is None:
        return "-"
    if value == 0.0 or not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2g}"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
