"""One run that is to be taken: a sweep or a capture, as a window, a table or a diagnosis asks for it."""

from __future__ import annotations

import csv
import io
import math
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from spinbench.console.access import RefusedError, is_plain

SWEEP, PLATEAUS = "sweep", "plateaus"
KINDS = (SWEEP, "coast-down", "spin-up", PLATEAUS, "zero")
BY_HAND = (SWEEP, PLATEAUS, "zero")  # kinds that a person at a valve can take
MOST_ROWS, MOST_PLATEAUS, MOST_NOTE = 100, 1000, 500
MOST_INERTIA = 100.0  # kg m2, as in a bench file
COMMAND = ("spinbench", "capture")


@dataclass(frozen=True)
class Planned:
    """What `spinbench sweep` or `spinbench capture` is to take; what is None is the bench file's.

    `after`: the run that a capture belongs to.
    """

    kind: str
    level_bar_abs: float | None = None
    plateaus: int | None = None
    added_inertia_kg_m2: float | None = None
    after: str = ""
    note: str = ""

    def arguments(self) -> list[str]:
        """Of the command line, without bench, logs and note."""
        if self.kind == SWEEP:
            return []
        values = {"kind": self.kind, **asdict(self)}
        del values["note"]
        return [f"--{name.replace('_', '-')}={value}" for name, value in values.items() if value not in (None, "")]

    def told(self, bench: Bench) -> dict[str, Any]:
        """For the page: its parts, and all of it in words."""
        words = [self.kind]
        words += [] if self.level_bar_abs is None else [f"at {self.level_bar_abs:g} bar abs"]
        words += [f"{self.plateaus or 10} times"] if self.kind == PLATEAUS else []
        words += [f"after {self.after}"] if self.after else []
        return {**asdict(self), "words": " ".join(words), "flywheel": flywheel(self, bench)}


def kinds_of(bench: Bench) -> tuple[str, ...]:
    """What a bench can take."""
    return BY_HAND if bench.file.roles.regulator is None else KINDS


def flywheel(planned: Planned, bench: Bench) -> str:
    """What a person has to mount first; empty where the bench is as its file says."""
    inertia = planned.added_inertia_kg_m2
    if inertia is None or inertia == bench.file.added_inertia_kg_m2:
        return ""
    return f"a flywheel of {inertia:g} kg m2 on the shaft" if inertia else "no flywheel on the shaft"


def planned_of(asked: Mapping[str, Any], bench: Bench) -> Planned:
    """A run from what a window or a row says.

    `asked`: by the names of `Planned`; an empty text counts as left out.
    Raises RefusedError: every mistake.
    """
    said = {name: str(value).strip() for name, value in asked.items() if value is not None}
    said = {name: text for name, text in said.items() if text}
    mistakes: list[str] = []

    def number(name: str, low: float, high: float, read: Callable[[str], float] = float) -> Any:
        if name not in said:
            return None
        try:
            value = read(said[name])
        except ValueError:
            value = math.nan
        if low <= value <= high:
            return value
        mistakes.append(f"{name} '{said[name][:20]}': expected {low:g} to {high:g}")
        return None

    room = bench.file.ambient.pressure_bar_abs or 0.0
    planned = Planned(
        said.get("kind", ""),
        number("level_bar_abs", room, bench.file.safety.highest_pressure_bar_abs),
        number("plateaus", 1, MOST_PLATEAUS, int),
        number("added_inertia_kg_m2", 0.0, MOST_INERTIA),
        said.get("after", ""),
        said.get("note", ""),
    )
    if mistakes := [*_mistakes(planned, set(said), bench), *mistakes]:
        raise RefusedError(400, "; ".join(mistakes))
    return planned


def _mistakes(planned: Planned, said: set[str], bench: Bench) -> Iterator[str]:
    """What is wrong with a run, its numbers apart. `said`: the names of what was stated."""
    kind, kinds = planned.kind, kinds_of(bench)
    if kind not in kinds:
        yield f"kind '{kind[:20]}': expected {', '.join(kinds)}"
    if unknown := sorted(said - {*Planned.__dataclass_fields__}):
        yield f"{unknown[0][:40]}: no such entry; known are {', '.join(Planned.__dataclass_fields__)}"
    if planned.after and not is_plain(planned.after):
        yield f"after '{planned.after[:40]}': expected the name of a run"
    if len(planned.note) > MOST_NOTE:
        yield f"note: longer than {MOST_NOTE} characters"
    others = sorted(said & {"level_bar_abs", "plateaus", "added_inertia_kg_m2", "after"})
    if kind == SWEEP and others:
        yield f"{others[0]}: a sweep takes what the bench file says; leave it out, or edit the bench file"
    if kind in KINDS and kind != PLATEAUS and "plateaus" in said:
        yield f"plateaus: a {kind} has none"


def of_table(text: str, bench: Bench) -> list[Planned]:
    """Runs from CSV, a row each, with columns named as `Planned` has them.

    Raises RefusedError: every mistake, with its row.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(text.removeprefix("\ufeff")), strict=True, restkey="", restval=""))
    except csv.Error as error:
        raise RefusedError(400, f"not a table of CSV: {error}") from None
    if not rows or len(rows) > MOST_ROWS:
        raise RefusedError(400, f"{len(rows)} rows under a header: expected 1 to {MOST_ROWS}")
    found, mistakes = [], []
    for number, row in enumerate(rows, start=1):
        try:
            if "" in row:
                raise RefusedError(400, "more cells than the header has")
            found.append(planned_of({str(name).strip(): value for name, value in row.items()}, bench))
        except RefusedError as error:
            mistakes.append(f"row {number}: {error}")
    if mistakes:
        raise RefusedError(400, f"nothing was added. {'. '.join(mistakes[:10])}")
    return found


def of_command(command: str, run: str, bench: Bench) -> Planned:
    """What a diagnosis recommends, from its command; nothing of it is ever run as it stands.

    `run`: that the diagnosis is of; the capture is taken after it.
    Raises RefusedError: it is no such command, or not for this bench.
    """
    try:
        words = shlex.split(command[:MOST_NOTE])
    except ValueError:
        words = []
    options = words[len(COMMAND) + 1 :]
    if tuple(words[: len(COMMAND)]) != COMMAND or len(options) % 2 or not all(o[:2] == "--" for o in options[::2]):
        raise RefusedError(400, "its command is no capture that can be started from here")
    asked = {name[2:].replace("-", "_"): value for name, value in zip(options[::2], options[1::2], strict=True)}
    asked.pop("logs", None)  # it is taken into the console's own folder
    return planned_of(asked | {"after": run}, bench)


def bench_words(path: Path, planned: Planned, logs: Path) -> list[str]:
    """The command, after `spinbench`."""
    name = SWEEP if planned.kind == SWEEP else COMMAND[1]
    return [name, str(path), f"--logs={logs}", *planned.arguments()]
