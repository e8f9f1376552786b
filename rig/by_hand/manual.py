"""A sweep whose instruments a person reads: one prompt a plateau, answered in one line.

Channels that are not typed are averaged from the prompt to the end of the plateau. Whatever is typed is in the log.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import Any

from configs.units import BAR
from rig.acquisition import Acquisition
from rig.bench.bench import Bench
from rig.by_hand import entry
from rig.by_hand.by_hand import on_the_dial
from rig.by_hand.conversation import Command, Conversation, EndedError, StoppedError
from rig.by_hand.prompter import JumpedError, Prompter, TrippedError
from rig.instruments.codecs.values import Value
from rig.plateaus.plan import UP, Step, stepping_stone
from rig.plateaus.plateau import Mean, Plateau, mean_of
from rig.readings import NS, Reading
from rig.runlog import columns_of
from rig.runlog.schema import ADDED, ZERO, ZERO_TAKEN_BACK
from rig.sweep.course import Course
from rig.sweep.hooks import Hooks, gauge_sd_of
from rig.sweep.orders import ABORTED, FINISHED, INTERLOCK, OPERATOR
from rig.sweep.runner import Outcome, PlateauSink

CLOSED_QUESTION = "Is it closed, and the line vented?"
MOST_ENTRIES = 10  # of one plateau, while agreement is waited for


class ManualSweep:
    """Goes through the steps with a person who reads the instruments.

    `acquisition`: started, with ``conversation.ports``; it is not stopped here.
    `course`: its steps and its table; captures are not made by hand.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        sink: PlateauSink,
        bench: Bench,
        course: Course,
        conversation: Conversation,
        hooks: Hooks,
    ) -> None:
        self.acquisition, self.sink, self.bench, self.course = acquisition, sink, bench, course
        self.person, self.hooks, self.clock = conversation, hooks, acquisition.clock
        self.table = course.table
        self.prompter = Prompter(acquisition, bench, course, conversation, hooks.trip)
        self.columns = columns_of(bench.file.roles.model_dump())
        self.is_gauge = self.prompter.pressure.endswith("_gauge")
        self.steps: deque[Step] = deque(course.steps)
        self.plateaus: list[Plateau] = []
        self.left_out: list[Step] = []
        self._numbered = 0
        self._begun = False
        conversation.log = self._event

    def run(self) -> Outcome:
        """Take the zero, every level, and the zero again. ``vented`` is what the person said."""
        self.person.say("Type help for what can be typed.")
        while True:
            with self.prompter.watched():
                outcome, reason, by = self._levels()
            vented = self._close_valve(may_undo=outcome == FINISHED and bool(self.plateaus))
            if vented is not None:
                break
            self._undo()
        if vented and outcome == FINISHED:
            try:
                with self.prompter.watched():
                    self._zero("end")
            except (StoppedError, EndedError, TrippedError) as error:
                self._event("note", text=f"no zero at the end: {error or 'stopped'}")
        if not vented:
            reason = f"{reason}; nobody has said that the valve is closed".removeprefix("; ")
        return Outcome(outcome, reason, vented, list(self.plateaus), self.left_out, by)

    def _levels(self) -> tuple[str, str, str | None]:
        """The zero, where there is none yet, and the levels that are left; outcome, reason and who stopped it."""
        try:
            if not self._begun:
                self._begun = True
                self._zero("start")
            while self.steps:
                self._step(self.steps.popleft())
        except StoppedError:
            return ABORTED, "stopped by the operator", OPERATOR
        except EndedError as error:
            return ABORTED, str(error), OPERATOR
        except TrippedError as error:
            self.person.say(f"\n*** {error} ***")
            return ABORTED, str(error), INTERLOCK
        return FINISHED, "", None

    def _step(self, step: Step) -> None:
        """One level, until it is taken, left out, or left."""
        wanted = step
        verdict = self.hooks.predict(step.level_bar_abs, self._known)
        if not verdict.allowed:
            taken = [self._ambient_bar, *(plateau.step.level_bar_abs for plateau in self._known)]
            stone = stepping_stone(step.level_bar_abs, verdict.highest_pa_abs / BAR, taken)
            if stone is None or not self.hooks.predict(stone, self._known).allowed:
                self._refuse(step, verdict.text)
                return
            self.person.say(f"  measuring {stone:g} bar abs first: {verdict.text}")
            self.steps.appendleft(step)
            step = Step(stone, UP, 1)
        added = {} if step in self.course.steps else {ADDED: True}
        self._event("state", state="level", level_bar_abs=step.level_bar_abs, direction=step.direction, **added)
        try:
            self._take(step)
        except JumpedError as jump:
            self._jump(step, jump.command, wanted)

    @property
    def _known(self) -> list[Plateau]:
        """What was measured here, and in the runs that this one continues."""
        return [*self.course.known, *self.plateaus]

    def _take(self, step: Step) -> None:
        self.prompter.note = ""
        self.person.say(self._heading(step))
        start_ns = self.clock.now_ns()
        doubt = partial(self._doubt, step.level_bar_abs)
        entries = [self.prompter.entry(doubt=doubt)]
        wanted = self.table.agreeing_readings or 1
        while not self._agreed(entries, wanted) and len(entries) < MOST_ENTRIES:
            left = f"again, until {wanted} agree: " if len(entries) < wanted else "they differ; again: "
            entries.append(self.prompter.entry(left, doubt))
        settled = self._agreed(entries, wanted)
        said = entry.remarks(self._shown_bar(), step.level_bar_abs, step.direction)
        for text in said:
            self.person.say(f"  ! {text}")
        after = None
        if self.prompter.pressure_is_typed:
            after = self.prompter.pressure_now(partial(self._doubt, self._shown_bar() or step.level_bar_abs))
        self._record(step, start_ns, entries[-wanted:], after, said if settled else [*said, self._differ()])

    def _doubt(self, level_bar_abs: float, values: Mapping[str, Value], at_rest: bool = False) -> str:
        """Why typed values may be a slip of the hand: held against the limits, the level and what the guard expects."""
        safety, added_bar = self.bench.file.safety, self._ambient_bar if self.is_gauge else 0.0

        def expect(bar_abs: float) -> tuple[float, float] | None:
            return (0.0, 0.0) if at_rest else self.hooks.expect(bar_abs, self._known)

        doubts = entry.doubts(values, added_bar, level_bar_abs, safety, expect)
        if not at_rest:
            doubts = entry.impossible(values, added_bar, self._ambient_bar, gauge_sd_of(self.bench), safety) | doubts
        return "; ".join(doubts.values())

    @property
    def _ambient_bar(self) -> float:
        """The room's pressure [bar], as the person has put it right."""
        return self.course.ambient_bar if self.person.room is None else self.person.room.pressure_bar_abs

    def _agreed(self, entries: list[dict[str, Reading]], wanted: int) -> bool:
        last = entries[-wanted:]
        return len(last) == wanted and all(entry.agree(last[0], other, self.prompter.typed) for other in last[1:])

    def _record(
        self, step: Step, start_ns: int, entries: list[dict[str, Reading]], after: Reading | None, said: list[str]
    ) -> None:
        end_ns = self.clock.now_ns()
        means = {role: self._mean(role, entries, start_ns, end_ns) for role in self.course.roles}
        if after is not None:
            means["pressure"] = entry.with_drift(means["pressure"], after)
        notes = [note for note in (self.prompter.note, *said) if note]
        settled = self._differ() not in said
        self._numbered += 1
        plateau = Plateau(self._numbered, step, start_ns, end_ns, settled, means, "; ".join(notes))
        self.plateaus.append(plateau)
        self.sink.plateau(plateau.row(self.columns))
        details = {role: dataclasses.asdict(mean) for role, mean in means.items()}
        self._event("plateau", plateau=plateau.number, level_bar_abs=step.level_bar_abs, means=details)
        self.person.say(f"  {plateau.sentence()}")
        self.hooks.on_plateau(plateau)

    def _mean(self, role: str, entries: list[dict[str, Reading]], start_ns: int, end_ns: int) -> Mean:
        """Of the typed readings where the role's channel is typed, or comes of one that is; else of the polled ones."""
        if role in entries[0]:
            return entry.mean_of_entries([one[role] for one in entries])
        window = self.acquisition.between(role, start_ns, end_ns)
        return mean_of(window.time_s, window.value, window.censored, window.quality)

    def _heading(self, step: Step) -> str:
        gauge = step.level_bar_abs - self._ambient_bar
        side = "from below" if step.direction == UP else "from above"
        way = "" if step.by_way_of_bar_abs is None else f" (go up to {step.by_way_of_bar_abs:.2f} first)"
        wait = f"wait {self.table.dwell_s:g} s"
        if self.table.agreeing_readings:
            wait = f"read until {self.table.agreeing_readings} readings agree"
        count = f"[{len(self.plateaus) + 1}/{len(self.plateaus) + 1 + len(self.steps)}]"
        dial = on_the_dial(self.bench, step.level_bar_abs, self._ambient_bar)
        shown = f"{gauge:.3f} bar gauge" + (f" = {dial} on the dial" if dial else "")
        return f"{count} set {step.level_bar_abs:.3f} bar abs = {shown}, {side}{way}, then {wait}"

    # Commands that leave a level.

    def _jump(self, step: Step, command: Command, wanted: Step) -> None:
        """Obey a command at a step, which is the wanted one, or one that the guard has put in before it."""
        self._event("command", command=command.word, level_bar_abs=step.level_bar_abs)
        if command.word == "skip":
            if step is not wanted:
                self.steps.popleft()  # the wanted one, which would be put behind the same step again
            self.left_out.append(wanted)
            self.person.say(f"  {wanted.level_bar_abs:g} bar abs is left out")
            return
        self.steps.appendleft(step)
        if command.word == "undo":
            self._undo()
        elif self.plateaus and self._untouched():
            last = self.plateaus[-1].step
            self.steps.appendleft(dataclasses.replace(last, repeat=last.repeat + 1))

    def _untouched(self) -> bool:
        """Whether nothing was typed for the level since its heading, so that a repeat means the one before."""
        last = self.acquisition.last(f"{self.prompter.device}.{next(iter(self.prompter.typed))}")
        return last is None or last.time_ns <= self.plateaus[-1].end_ns

    def _undo(self) -> None:
        if not self.plateaus:
            self._event(ZERO_TAKEN_BACK, which="start")
            self._zero("start")
            return
        last = self.plateaus.pop()
        self.sink.plateau(last.row(self.columns) | {"used": False})
        self._event("plateau taken back", plateau=last.number)
        self.steps.appendleft(last.step)
        self.person.say(f"  plateau {last.number} at {last.step.level_bar_abs:g} bar abs is taken back")

    def _refuse(self, step: Step, text: str) -> None:
        gone = [step, *(other for other in self.steps if other.level_bar_abs >= step.level_bar_abs)]
        self.steps = deque(other for other in self.steps if other.level_bar_abs < step.level_bar_abs)
        self.left_out += gone
        levels = [[one.level_bar_abs, one.direction, one.repeat] for one in gone]
        self._event("level refused", level_bar_abs=step.level_bar_abs, text=text, left_out=levels)
        self.person.say(f"  ! {step.level_bar_abs:g} bar abs and above are left out: {text}")

    # Begin and end.

    def _zero(self, which: str) -> None:
        self.person.say(f"Zero at the {which}: valve closed, line vented, rotor at rest. (skip leaves it out)")
        start_ns = self.clock.now_ns()
        while True:
            try:
                found = self.prompter.entry(doubt=partial(self._doubt, self._ambient_bar, at_rest=True))
                break
            except JumpedError as jump:
                if jump.command.word == "skip":
                    self._event("note", text=f"no zero at the {which}")
                    return
                self.person.say("  there is nothing before it to go back to")
        end_ns = max(self.clock.now_ns(), *(reading.time_ns for reading in found.values()))
        channels = {
            f"{self.prompter.device}.{name}": {
                "mean": found[name].value,
                "se": None,
                "n": 1,
                "censored": found[name].censored,
            }
            for name in self.prompter.typed
        }
        self._event(ZERO, which=which, start_s=start_ns / NS, end_s=end_ns / NS, vented=True, channels=channels)

    def _close_valve(self, may_undo: bool) -> bool | None:
        """Say it, and wait until the person says that it is done; None when the last plateau is taken back instead.

        Until then the bench counts as unvented.
        """
        self._event("unvented", text="the valve is open until the person says otherwise")
        self.person.say("CLOSE THE VALVE.")
        more = "; undo: the last plateau again" if may_undo else ""
        while True:
            try:
                answer = self.person.ask(f"  {CLOSED_QUESTION} (Enter for yes{more}) ")
            except (EndedError, StoppedError):
                self._event("unvented", text="nobody has said that the valve is closed")
                return False
            if answer.text.lower() in ("", "y", "yes", "closed"):
                self._event("vented", text="said by the person")
                return True
            if may_undo and answer.text.lower() == "undo":
                return None

    def _differ(self) -> str:
        return f"no {self.table.agreeing_readings} readings agreed"

    def _shown_bar(self) -> float | None:
        """The pressure as read last [bar abs]."""
        reading = self.acquisition.last("pressure")
        if reading is None or not reading.usable or reading.value is None:
            return None
        return reading.value + (self._ambient_bar if self.is_gauge else 0.0)

    def _event(self, kind: str, **details: Any) -> None:
        self.acquisition.event(kind, None, **details)
