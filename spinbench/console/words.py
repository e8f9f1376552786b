"""What a state of a sweep means, what it waits for, what to do about an alarm: in words."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Any

from rig.runlog import StartRecord
from rig.runlog.reader import BEING_WRITTEN, KILLED
from rig.runlog.schema import ended
from rig.runlog.tail import SET_POINT, STATE, Tail
from rig.sweep.machine import VENT_TIMEOUT_S
from spinbench.next_steps import bench_named, kept_in, show_command

# Of each state: what happens in it, and what it waits for.
STATES = {
    "zero": (
        "The line is vented and the rotor at rest. Every instrument is read like this.",
        "a vented line, a rotor at rest, and the zero readings",
    ),
    "next": ("The guard predicts the speed at the next level.", "the guard's prediction"),
    "ramp": ("The regulator's set-point moves to the next level.", "the set-point to arrive"),
    "settle": ("Pressure and speed are watched until neither drifts.", "pressure and speed to settle"),
    "dwell": ("Readings are averaged: they become the plateau.", "the readings of this plateau"),
    "capture": ("The supply is opened or shut, and every tooth is timed.", "the end of the run in time"),
    "vent": ("The regulator is at zero and the line empties.", "the gauge to show the room's pressure"),
    "level": ("A person sets the valve and reads the instruments.", "what the person types"),
    "done": ("The course is done.", "the run to be sealed"),
    "stopping": ("The run was stopped.", "the run to be sealed"),
    "failed": ("Something of the bench does not work.", "the run to be sealed"),
}
STARTING = ("starting", "The instruments are identified and the failsafes set.", "the bench")
CLOSE_SUPPLY = "Close the supply by hand now, and use the bench's own shut-off."
GOES_ON, HAS_ENDED = "The run goes on. Press STOP if it should not.", "The run has ended. Read it before the next one."
GUIDANCE = {
    "level refused": "The guard expects too high a speed there, so the level is left out. See docs/safety.md.",
    "set-point not taken": f"Watch the pressure. If it does not follow, press STOP. {CLOSE_SUPPLY}",
    "capture failed": "This run in time cannot be used. Take it again: spinbench capture.",
    "model check failed": "The sweep is not touched by it. Diagnose the run once it has ended.",
    "line lost": "Look at the cable and the instrument's supply. Under pressure the run vents by itself.",
}


def is_imported(start: StartRecord) -> bool:
    """Whether a run's readings were taken elsewhere and brought in as a file."""
    return start.kind == "import" or bool(start.imported)


@dataclass(frozen=True)
class Badge:
    """The state in one word, and what goes with it.

    `still_s`, `of_s`: how long still, and of how much, on the bench's clock [s]; None where nobody can say.
    `at_most`: whether it may be over sooner.
    """

    word: str
    explanation: str
    waits_for: str = ""
    still_s: float | None = None
    of_s: float | None = None
    at_most: bool = False


def badge_of(tail: Tail, now_s: float) -> Badge:
    """Where a run is. `now_s`: on the bench's clock [s]."""
    if tail.state != BEING_WRITTEN:
        return _ended(tail)
    event = tail.latest.get(STATE)
    if event is None:
        return Badge(*STARTING)
    state = state_word(event.details)
    explanation, waits_for = STATES.get(state, ("", ""))
    length_s, at_most = _length(tail, state, event.details)
    if length_s is None:
        return Badge(state, explanation, waits_for)
    still_s = max(event.time_s + length_s - now_s, 0.0)
    return Badge(state, explanation, waits_for, still_s, length_s, at_most)


def state_word(details: dict[str, Any]) -> str:
    """A state of the log in the word that people are shown."""
    state = str(details.get("state", ""))
    return "stopping" if state == "aborted" else state


def _length(tail: Tail, state: str, details: dict[str, Any]) -> tuple[float | None, bool]:
    """How long a state lasts [s], and whether that is the most."""
    table = tail.start.sweep
    if state == "dwell":
        return _number(table.get("dwell_s")), False
    if state == "settle":
        return _number(table.get("settle_timeout_s")), True
    if state == "vent":
        return VENT_TIMEOUT_S, True
    if state == "ramp":
        target, ramp = _number(details.get("target_bar_abs")), _number(table.get("ramp_bar_s"))
        held = _number(tail.details(SET_POINT).get("bar_abs"))
        if target is not None and ramp:
            event = tail.latest[STATE]
            passed_s = tail.now_s - event.time_s
            return passed_s + abs(target - (held if held is not None else target)) / ramp, False
    return None, False


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _ended(tail: Tail) -> Badge:
    if tail.end is None:
        is_killed = tail.state == KILLED
        why = "Its program ended without sealing it: spinbench runs repair seals it." if is_killed else ""
        return Badge(tail.state or "loading", why)
    end = tail.end
    if end.outcome == "finished" and is_imported(tail.start):
        return Badge("imported", "Readings that were taken elsewhere, brought in as a file.")
    if end.outcome == "finished":
        return Badge("finished", "The course was gone through to its end.")
    if end.outcome == "failed":
        return Badge("failed", f"Something of the bench does not work: {end.reason}.")
    if end.stopped_by == "operator":
        return Badge("stopped", "A person stopped it.")
    if end.stopped_by == "interlock":
        return Badge("tripped", f"An interlock stopped it: {end.reason}.")
    return Badge("stopped", f"It was stopped: {end.reason}.")


def guidance_for(kind: str, tail: Tail) -> str:
    """What to do about an alarm of a kind."""
    is_over = tail.state != BEING_WRITTEN or "reason" in tail.details(STATE)
    return GUIDANCE.get(kind, HAS_ENDED if is_over else GOES_ON)


def _continuing(tail: Tail, bench: str) -> str:
    """The command that takes the levels that are left."""
    words = ["spinbench", "sweep", bench_named(tail.start, bench), "--continue", tail.folder.name]
    return shlex.join([*words, *kept_in(tail.folder)])


def after_the_end(tail: Tail, bench: str = "") -> tuple[str, str] | None:
    """What the end of a run asks of a person, and what to do; None where it asks nothing.

    `bench`: as the bench of the console is typed; empty where its name is enough.
    """
    badge = _ended(tail)
    end = tail.end
    if end is None:
        return (f"the run was killed: {tail.folder.name}", CLOSE_SUPPLY) if tail.state == KILLED else None
    unvented = end.vented is False
    if end.outcome == "finished" and not unvented:
        return None
    text = ended(end.outcome, end.stopped_by, end.reason)
    if unvented:
        return f"{text}; the line is NOT known to be without pressure", CLOSE_SUPPLY
    if badge.word == "stopped":
        left = f" To take the levels that are left: {_continuing(tail, bench)}" if tail.start.kind == "sweep" else ""
        return text, f"The line is vented.{left}"
    return text, f"The line is vented. Find the cause before you go on: {show_command(tail.folder)}"
