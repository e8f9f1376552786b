"""What a sweep goes through, and the states it can be in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from rig.bench.bench import SweepTable
from rig.plateaus.plan import Step
from rig.plateaus.plateau import Plateau
from rig.sweep.capturing import CaptureTask


class State(StrEnum):
    """Where the sweep is."""

    ZERO = "zero"
    NEXT = "next"
    RAMP = "ramp"
    SETTLE = "settle"
    DWELL = "dwell"
    CAPTURE = "capture"
    VENT = "vent"
    DONE = "done"
    ABORTED = "aborted"
    FAILED = "failed"


ENDED = frozenset({State.DONE, State.ABORTED, State.FAILED})


@dataclass(frozen=True)
class Course:
    """What the machine goes through.

    `zero_channels`: full names; read with the line vented.
    `known`: of the runs that this one continues, oldest first: the guard learns from them too.
    """

    steps: Sequence[Step]
    captures: Sequence[CaptureTask]
    table: SweepTable
    ambient_bar: float
    roles: tuple[str, ...]
    zero_channels: tuple[str, ...]
    by_hand: bool = False
    zeros: tuple[str, ...] = ("start", "end")
    known: Sequence[Plateau] = ()
