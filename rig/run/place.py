"""Where a bench is: the ports of its file, or a virtual one that is started and ended here."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.acquisition.opening import port_of
from rig.bench.bench import Bench, LineTable
from rig.clock import Clock
from rig.lines import Port

# Shows words while something is done, and takes them away.
Waiting = Callable[[str], AbstractContextManager[object]]


def no_words(words: str) -> AbstractContextManager[object]:
    """Shows nothing."""
    return contextlib.nullcontext()


@dataclass(frozen=True)
class Place:
    """Where a bench is: its clock, its ports, and what a watchdog has to know of a virtual one's.

    `seal`: SHA-256 of what the bench conceals; empty where it conceals nothing.
    """

    clock: Clock
    ports: Callable[[str, LineTable, Clock], Port]
    virtual: dict[str, Any] | None
    seal: str = ""


@contextlib.contextmanager
def place_of(
    bench: Bench,
    path: Path,
    rate: float | None = None,
    server: tuple[str, ...] | None = None,
    added_inertia_kg_m2: float | None = None,
    waiting: Waiting = no_words,
) -> Iterator[Place]:
    """The bench as it stands, or a virtual one that is started and ended here.

    `rate`: seconds of a virtual bench in one of the wall [-]; the file's when left out.
    `server`: module and options of the process that serves a virtual bench; its own when left out.
    `added_inertia_kg_m2`: of a flywheel on the shaft of a virtual bench; the file's when left out.
    `waiting`: shows that a virtual bench is being started.
    Raises VirtualBenchError when a virtual bench does not start.
    """
    if bench.file.virtual is None:
        yield Place(Clock(), port_of, None)
        return
    from rig.virtual.launch import SERVER, launch

    flywheel = () if added_inertia_kg_m2 is None else ("--added-inertia", str(added_inertia_kg_m2))
    with waiting("starting the virtual bench"):
        started = launch(path, rate, server=(*(server or SERVER), *flywheel))
    with started as virtual:
        yield Place(virtual.clock, virtual.port_for, virtual.ports["lines"], virtual.ports.get("seal", ""))
