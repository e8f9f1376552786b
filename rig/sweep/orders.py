"""What the machine of a sweep is shown, and what it wants done. Both are data; the runner does the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rig.acquisition.channels import Window
from rig.interlock.step import Verdict
from rig.plateaus.plan import Step
from rig.plateaus.plateau import Mean, Plateau
from rig.readings import Reading

VENTED = 0.0  # bar abs: a set-point that asks for no pressure at all, whatever the regulator calls it

FINISHED, ABORTED, FAILED = "finished", "aborted", "failed"
OPERATOR, INTERLOCK = "operator", "interlock"  # who stopped a run that was aborted


class View(Protocol):
    """What can be known of the bench at one moment."""

    stops: int  # how often the operator has asked to stop
    answer: str | None  # to the last `Ask`, once
    set_ns: int | None  # when the last set-point was taken: half way from its order to the answer [ns]
    set_unsure: str  # why that moment is not known; empty where it is

    def window(self, channel: str, start_ns: int, end_ns: int) -> Window:
        """The usable readings between two times."""

    def last(self, channel: str) -> Reading | None:
        """The newest reading, failed or not."""

    def since(self, channel: str, after_ns: int) -> list[Reading]:
        """The readings, failed or not, whose replies came after a time [ns]."""


Predict = Callable[[float, Sequence[Plateau]], Verdict]  # from a level [bar abs] and the plateaus so far
Doubt = Callable[[Sequence[Plateau]], str]  # why the speeds of the latest plateaus cannot be so; empty when they can
Trip = Callable[[View, int, bool], str | None]  # from view, time and whether there may be pressure: why to vent now


@dataclass(frozen=True)
class SetPressure:
    """Set the line's pressure [bar abs]; `VENTED` for none."""

    bar_abs: float


@dataclass(frozen=True)
class Ask:
    """Ask the person at the valve, and go on meanwhile."""

    text: str


@dataclass(frozen=True)
class Say:
    """Tell the person."""

    text: str
    warning: bool = False


@dataclass(frozen=True)
class Entered:
    """A state was entered, for the log."""

    state: str
    details: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """A plateau was taken."""

    plateau: Plateau


@dataclass(frozen=True)
class Zero:
    """Every channel with the line vented and the rotor at rest: ``which`` is start or end."""

    which: str
    start_ns: int
    end_ns: int
    means: dict[str, Mean]
    vented: bool


@dataclass(frozen=True)
class Refused:
    """A level, and with it the higher ones, is left out."""

    level_bar_abs: float
    text: str
    left_out: tuple[Step, ...]


@dataclass(frozen=True)
class CaptureStart:
    """Read every tooth from now on."""

    kind: str
    level_bar_abs: float


@dataclass(frozen=True)
class CaptureEnd:
    """Back to ordinary reading. `left_out`: why the capture cannot be used; empty when it can."""

    kind: str
    start_ns: int
    event_ns: int
    end_ns: int
    cut_short: bool = False
    left_out: str = ""


@dataclass(frozen=True)
class Finish:
    """It is over: ``finished``, ``aborted`` or ``failed``, why, and who aborted it."""

    outcome: str
    reason: str
    vented: bool
    stopped_by: str | None = None


Order = SetPressure | Ask | Say | Entered | Record | Zero | Refused | CaptureStart | CaptureEnd | Finish
