"""The same facts in the terminal, for a bench that is reached over ssh."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from spinbench.console.access import ConsoleError
from spinbench.console.desk import Desk

TICK_S = 0.25
SHOWN_EVENTS, SHOWN_ALARMS = 8, 4
NAME = "the terminal"
MARKS = {"good": "✓", "unsure": "?", "bad": "✕", "old": "!", "none": "-", "past": "-"}
STEP_MARKS = {"done": "✓", "running": "▶", "left out": "✕", "to come": "·"}
LAMPS = {"none": "- not checked", "waits": "○ too early", "fits": "✓ model fits", "differs": "▲ MISMATCH"}


def watch(desk: Desk) -> None:
    """Show the newest run until q is typed; s stops it, a acknowledges its alarms.

    Raises ConsoleError where keys cannot be typed, or nothing can be shown.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConsoleError("--terminal needs a terminal for keys and for what is shown; without one leave it out")
    screen = Console()
    with _keys() as key, Live(console=screen, screen=True, auto_refresh=False) as live:
        while True:
            desk.follow()
            live.update(view(desk), refresh=True)
            typed = key(TICK_S)
            if typed in ("s", "S"):
                desk.stop(NAME)
            elif typed in ("a", "A"):
                _acknowledge(desk)
            elif typed in ("q", "Q"):
                return


def view(desk: Desk) -> Group:
    """What is shown now."""
    parts: list[Any] = []
    told = desk.stop_told()
    if told is not None:
        style = "bold white on red" if told["word"] == "NOT DELIVERED" else "bold"
        parts.append(Panel(Text(f"STOP {told['word']}: {told['text']}", style=style)))
    keys = Text("s STOP: vents    a acknowledge    q quit (a sweep goes on)", style="bold")
    if desk.showing is None:
        return Group(*parts, Text(desk.unreadable or f"idle: no run in {desk.logs} yet"), keys)
    found = desk.facts(desk.showing, 60.0)
    return Group(
        *parts,
        _head(found, desk.unreadable),
        _figures(found["figures"]),
        _course(found["steps"], found["state"]["word"]),
        _model(found),
        *_alarms(found["alarms"]),
        _events(found["events"]),
        keys,
    )


def _head(found: dict[str, Any], unreadable: str) -> Panel:
    state, run = found["state"], found["run"]
    still = ""
    if state["still_s"] is not None:
        still = f": {'at most ' if state['at_most'] else ''}{state['still_s']:.0f} of {state['of_s']:.0f} s left"
    waits = f"waits for {state['waits_for']}{still}" if state["waits_for"] else ""
    text = Text(f" {state['word'].upper()} ", style="bold reverse")
    text.append(f"  {state['explanation']}\n", style="not reverse").append(unreadable or waits)
    return Panel(text, title=Text(run["name"] + (" (virtual bench)" if run["simulated"] else "")), title_align="left")


def _figures(figures: list[dict[str, Any]]) -> Table:
    table = Table("", "", "", "quality", expand=True, show_edge=False)
    for one in figures:
        style = {"good": "bold", "past": "dim"}.get(one["mark"], "bold reverse")
        value = Text(one["text"], style=style, justify="right")
        table.add_row(one["role"], value, one["unit"], Text(f"{MARKS[one['mark']]} {one['quality']}"))
    return table


def _course(course: dict[str, Any], word: str) -> Text:
    text = Text("course  ", style="bold")
    for step in course["steps"]:
        way = {"up": "↑", "down": "↓"}.get(step["direction"], "")
        running = step["status"] == "running"
        added = " added" if step["added"] else ""
        text.append(
            f"{STEP_MARKS[step['status']]} {step['level']:.2f}{way}{added}",
            style="reverse" if running else "not bold",
        )
        text.append("  ", style="not bold")
    done = sum(step["status"] == "done" for step in course["steps"])
    left = f", about {course['still_s']} s left" if course["still_s"] is not None else ""
    return text.append(f"\n        {done} of {len(course['steps'])} plateaus, {word}{left}", style="not bold")


def _model(found: dict[str, Any]) -> Text:
    text = Text("model   ", style="bold").append(LAMPS[found["check"]["lamp"]])
    text.append(f"  {found['check']['text']}", style="not bold")
    f = found["picture"]["f_overall"]
    told = "" if f is None else f"\n        f_overall so far {f['mean']:.4f} ± {f['sd']:.4f} N m s"
    return text.append(told, style="not bold")


def _alarms(alarms: list[dict[str, Any]]) -> list[Panel]:
    new = [one for one in alarms if not one["acknowledged"]]
    if not new:
        return []
    text = Text()
    for one in new[:SHOWN_ALARMS]:
        text.append(f"▲ {one['at_s']:.0f} s  {one['text']}\n", style="bold").append(
            f"  what to do: {one['guidance']}\n"
        )
    return [Panel(text, title=f"{len(new)} alarms", title_align="left")]


def _events(events: list[dict[str, Any]]) -> Table:
    table = Table.grid(padding=(0, 2))
    for one in events[-SHOWN_EVENTS:]:
        table.add_row(f"{one['at_s']:9.1f} s", Text(one["kind"]), Text(one["text"], overflow="ellipsis", no_wrap=True))
    return table


def _acknowledge(desk: Desk) -> None:
    if desk.showing is None:
        return
    name = desk.showing.tail.folder.name
    for one in desk.facts(desk.showing, 60.0)["alarms"]:
        desk.kept.acknowledge(name, one["n"])


@contextlib.contextmanager
def _keys() -> Iterator[Any]:
    """Gives the next key that is typed within some seconds, without Enter, or an empty text."""
    handle = sys.stdin.fileno()
    before = termios.tcgetattr(handle)

    def key(within_s: float) -> str:
        if not select.select([handle], [], [], within_s)[0]:
            return ""
        typed = os.read(handle, 1)
        return typed.decode("ascii", "replace") if typed else "q"

    try:
        tty.setcbreak(handle)
        yield key
    finally:
        termios.tcsetattr(handle, termios.TCSADRAIN, before)
