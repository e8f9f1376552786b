"""The stretches of a run that an export looks at: zero phases, captures, and the readings within them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.acquisition.derived import CHANNEL as DERIVED_CHANNEL
from rig.acquisition.derived import DEVICE as DERIVED_DEVICE
from rig.acquisition.stage import ROOM
from rig.readings import NS, USABLE, Quality
from rig.runlog.folder import RunError
from rig.runlog.plateaus import columns_of
from rig.runlog.reader import Run
from rig.runlog.schema import CAPTURE, ZERO, ZERO_TAKEN_BACK, AmbientRecord, EventLine

CAPTURES = ("coast-down", "spin-up")


@dataclass(frozen=True)
class Phase:
    """A stretch of a run. `event_s`: of a capture: when the supply was shut or opened [s]."""

    kind: str
    start_s: float
    end_s: float
    event_s: float | None = None
    cut_short: bool = False


@dataclass(frozen=True)
class Series:
    """The usable readings of one channel over a stretch, oldest first, and how many others there were.

    `value`, shape (n,): in the channel's unit.
    `censored`, shape (n,): -1 and 1 beyond the scale [-].
    `lasted_ns`, shape (n,): from the request to the reply: within it each was measured [ns].
    `unusable`, `unverified`: readings that failed, and those among the usable ones that nothing checked [-].
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float64]
    censored: NDArray[np.int64]
    lasted_ns: NDArray[np.int64]
    unusable: int
    unverified: int


def quantity_channels(run: Run) -> dict[str, str]:
    """The channel of each quantity, ``device.channel``, by the name of its recording/1 column.

    `run`: its roles say it; for the flow, the derived channel goes before the meter's own.
    """
    columns = columns_of(run.start.roles)
    channels = {column: run.start.roles[role] or "" for role, column in columns.items()}
    if "flow_l_min" in channels and (run.samples["device"] == DERIVED_DEVICE).any():
        channels["flow_l_min"] = f"{DERIVED_DEVICE}.{DERIVED_CHANNEL}"
    elif "flow_l_min" in channels and channels["flow_l_min"].partition(".")[2] != "flow_l_min":
        del channels["flow_l_min"]  # standard litres, and nothing brought them to the inlet's state
    return channels


def series(run: Run, channel: str, start_s: float, end_s: float) -> Series:
    """The readings of a channel over a stretch; what a person did not read is none.

    `start_s`, `end_s`: both ends are taken in [s].
    """
    device, _, name = channel.partition(".")
    samples = run.samples
    time_ns = samples["time_ns"].to_numpy()
    within = samples[(time_ns >= round(start_s * NS)) & (time_ns <= round(end_s * NS))]
    rows = within[(within["device"] == device) & (within["channel"] == name)]
    rows = rows[rows["value"].notna() | (rows["quality"] != Quality.MANUAL.value)]
    usable = rows["value"].notna().to_numpy() & rows["quality"].isin(USABLE).to_numpy()
    kept = rows[usable]
    order = np.argsort(kept["time_ns"].to_numpy(), kind="stable")
    return Series(
        kept["time_ns"].to_numpy()[order],
        kept["value"].to_numpy()[order],
        kept["censored"].to_numpy()[order],
        (kept["reply_ns"] - kept["request_ns"]).to_numpy()[order],
        int((~usable).sum()),
        int((kept["quality"] == Quality.UNVERIFIED.value).sum()),
    )


def zeros(run: Run) -> tuple[list[Phase], list[str]]:
    """The zero phases of a run, and what was left out."""
    events: list[EventLine] = []
    for event in run.events:
        if event.event == ZERO:
            events.append(event)
        elif event.event == ZERO_TAKEN_BACK:
            which = event.details.get("which")
            events = [zero for zero in events if zero.details.get("which") != which]
    phases = [Phase(ZERO, *_span(event)) for event in events if event.details.get("vented") is not False]
    notes = [f"a zero phase was left out: the line was not vented ({len(events) - len(phases)} times)"]
    if not events and run.start.kind == ZERO:
        phases = [_whole(run, ZERO)]
    return phases, notes if len(phases) < len(events) else []


def corrections(run: Run) -> list[EventLine]:
    """What the person has put right of the room, oldest first."""
    return [event for event in run.events if event.event == ROOM]


def room_said(run: Run) -> AmbientRecord:
    """The room at the start, as the person has put it right since. Raises RunError when that makes no sense."""
    corrected = corrections(run)
    if not corrected:
        return run.start.ambient
    said = {key: value for key, value in corrected[-1].details.items() if key in AmbientRecord.model_fields}
    try:
        return AmbientRecord(**(run.start.ambient.model_dump() | said))
    except ValueError:
        raise RunError(f"{run.folder}: the room in its events makes no sense; the file is damaged") from None


def captures(run: Run) -> tuple[list[Phase], list[str]]:
    """The captures of a run, and what was left out.

    `run`: its events ``capture end`` hold ``capture`` (the kind), ``start_s``, ``event_s`` and ``end_s``; a run of kind
        ``coast-down`` or ``spin-up`` that was imported without such an event is one capture from end to end.
    """
    phases: list[Phase] = []
    notes: list[str] = []
    for event in run.events:
        which, lost = event.details.get("capture"), event.details.get("left_out")
        if event.event == CAPTURE and lost:
            notes.append(f"{which} from {_span(event)[0]:.1f} s: left out: {lost}")
            continue
        if event.event == CAPTURE and which in CAPTURES and "end_s" in event.details:
            when = event.details.get("event_s")
            event_s = float(when) if isinstance(when, int | float) else None
            phases.append(Phase(which, *_span(event), event_s, event.details.get("cut_short") is True))
    if not phases and run.start.kind in CAPTURES and run.start.imported:
        phases.append(_whole(run, run.start.kind))
    return phases, notes


def _span(event: EventLine) -> tuple[float, float]:
    """From when to when; an event that does not say it has no length."""
    ends = (event.details.get(key) for key in ("start_s", "end_s"))
    start, end = (float(value) if isinstance(value, int | float) else event.time_s for value in ends)
    return start, end


def _whole(run: Run, kind: str) -> Phase:
    times = run.samples["time_s"]
    return Phase(kind, float(times.min()), float(times.max())) if len(times) else Phase(kind, 0.0, 0.0)
