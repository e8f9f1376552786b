"""One run on a bench, from its start record to its end record: everything of the rig put together.

The order is that of safety: the instruments are identified before there is a run, the failsafes are set and the
watchdog watches before the regulator is first raised, and whatever happens then, the regulator is sent to zero before
the run is sealed.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from configs.units import BAR
from rig.acquisition import Acquisition, RecorderError
from rig.bench.bench import Bench, bench_path, read_bench
from rig.by_hand.by_hand import is_manual
from rig.by_hand.conversation import Conversation, StoppedError, ValveHand
from rig.by_hand.manual import ManualSweep
from rig.by_hand.sheet_check import checked_sheet
from rig.by_hand.sheet_entry import enter_sheet
from rig.clock import Clock
from rig.interlock import SafetyError
from rig.interlock.failsafe import set_and_check
from rig.interlock.guard import Guard
from rig.interlock.limits import Limits
from rig.interlock.stop import Stop
from rig.interlock.watchdog import Plan as WatchdogPlan
from rig.interlock.watchdog import Watchdog
from rig.lines import LineError
from rig.lines.keyboard import KeyboardPort
from rig.plateaus.plateau import Plateau
from rig.readings import NS
from rig.run.place import Place, Waiting, no_words, place_of
from rig.run.terminal import why_failed
from rig.runlog import Circumstances, RunError, RunWriter, StartRecord, start_record
from rig.runlog.folder import END, WATCHDOG
from rig.runlog.schema import COURSE, EXPECTED
from rig.sweep.ambient import Ambient, AmbientError, Ask, Given, at_end, at_start
from rig.sweep.continuing import refuse_another_seal
from rig.sweep.course import Course
from rig.sweep.hooks import Hooks, Progress, Silent, doubting, expecting, guard_of, guarded, points_of
from rig.sweep.orders import View
from rig.sweep.runner import Outcome, Runner

ATTENDED_S = 30.0  # real time without a look at the limits after which the watchdog takes the sweep for hung
BAND_LEVELS = 20
UNVENTED = "the line is NOT known to be without pressure: close the supply"


# What goes on beside a run: called with the run's folder and a function that writes an event (its kind, then details by
# name), it gives a context, whose value is called with each plateau. Whatever fails in it is its own to catch.
Beside = Callable[[Path, Callable[..., None]], AbstractContextManager[Callable[[Plateau], None]]]


def alone(folder: Path, note: Callable[..., None]) -> AbstractContextManager[Callable[[Plateau], None]]:
    """What goes on beside a run when nothing does."""
    return contextlib.nullcontext(lambda plateau: None)


@dataclass(frozen=True)
class Wanted:
    """What a run is to be.

    `kind`: ``sweep`` or a capture's; a sweep of a manual bench is logged as ``manual``.
    `motor_serial`: the bench file's when left out.
    `rate`: seconds of a virtual bench in one of the wall [-]; the file's when left out.
    `server`: module and options of the process that serves a virtual bench, see `rig.virtual.launch`; its own when left
        out.
    `added_inertia_kg_m2`: of a flywheel on the shaft; the file's when left out.
    `waiting`: shows what is being done before the run begins.
    `ask`: puts a prompt about the room to the person; None when nobody is there.
    `seal_before`: that of the run before, as its start record has it; None where it does not say.
    `beside`: gives the context in which the course is gone through, see `Beside`; it ends before the run is sealed.
    """

    kind: str
    root: Path
    operator: str = ""
    motor_serial: str | None = None
    note: str = ""
    parent: str | None = None
    seal_before: str | None = None
    wire: bool = True
    rate: float | None = None
    server: tuple[str, ...] | None = None
    added_inertia_kg_m2: float | None = None
    progress: Progress = field(default_factory=Silent)
    waiting: Waiting = no_words
    ask: Ask | None = None
    beside: Beside = alone


T = TypeVar("T")
Plan = Callable[[Bench, Ambient], tuple[Course, list[str]]]


def take(path: Path, given: Given, plan: Plan, wanted: Wanted) -> tuple[Path, Outcome]:
    """A run, from the bench file to the sealed folder.

    `path`: the bench file, or the name of one in configs/benches.
    `plan`: from the bench and the room to the course, and remarks on it.
    Returns `folder`: the run; `outcome`: how it ended. Raises ConfigError, AmbientError, SweepError when the bench
    file, the room or the course make no sense; there is no run then; LineError, IdentityError, VirtualBenchError when
    the bench is not as its file says; there is no run then; SafetyError when a failsafe or the watchdog is missing; the
    run is sealed as failed; RecorderError when the run log cannot be written; the regulator is at zero.
    """
    path = bench_path(path)
    bench = read_bench(path).with_flywheel(wanted.added_inertia_kg_m2)
    by_hand = bench.file.roles.regulator is None
    # Before the operator's stop is listened to: at a question, Ctrl-C ends the program, and there is no run yet.
    ambient = None if by_hand else at_start(bench, given, wanted.ask)
    with (
        Stop(_tell_stop) as stop,
        place_of(bench, path, wanted.rate, wanted.server, wanted.added_inertia_kg_m2, wanted.waiting) as place,
    ):
        refuse_another_seal(wanted.parent, wanted.seal_before, place.seal)
        conversation = None
        if by_hand:
            conversation = Conversation(KeyboardPort(place.clock), place.clock, lambda: stop.asked)
            wanted = replace(wanted, ask=conversation.ask_text)
            try:
                ambient = at_start(bench, given, wanted.ask)
            except StoppedError:
                raise AmbientError("stopped at a question about the room; there is no run") from None
        if ambient is None:
            raise AmbientError(f"{bench.name}: nothing is known of the room")
        if conversation is not None:
            conversation.room = ambient
        course, remarks = plan(bench, ambient)
        for words in remarks:
            wanted.progress.say(words, True)
        return _Run(bench, path, place, ambient, wanted, stop, conversation).go(course)


def _tell_stop(who: str) -> None:
    """Called inside a signal handler: it takes no lock that the interrupted thread might hold, as a bar does."""
    with contextlib.suppress(OSError):
        os.write(2, f"\nspinbench: {who}: venting the line and sealing the run\n".encode())


class _Run:
    """What every step of one run needs."""

    def __init__(
        self,
        bench: Bench,
        path: Path,
        place: Place,
        ambient: Ambient,
        wanted: Wanted,
        stop: Stop,
        conversation: Conversation | None,
    ) -> None:
        self.bench, self.path, self.place = bench, path, place
        self._ambient = ambient
        self._guarding: tuple[Ambient, Guard] | None = None
        self.wanted, self.stop, self.conversation = wanted, stop, conversation
        self.acquisition = Acquisition(
            bench,
            place.clock,
            ports=place.ports if conversation is None else conversation.ports,
            simulated=place.virtual is not None,
            ambient_bar=ambient.pressure_bar_abs,
            ambient_c=ambient.temperature_c,
        )

    @property
    def ambient(self) -> Ambient:
        """The room, as the person has put it right meanwhile."""
        room = None if self.conversation is None else self.conversation.room
        return self._ambient if room is None else room

    def _guard(self) -> Guard:
        """Of the motor in that room."""
        if self._guarding is None or self._guarding[0] is not self.ambient:
            self._guarding = (self.ambient, guard_of(self.bench, self.ambient))
        return self._guarding[1]

    def go(self, course: Course) -> tuple[Path, Outcome]:
        """Identify, make the run, go through the course, seal."""
        # Before anything is under way: right after an installation the solvers are compiled here. A watchdog that was
        # there by then would take a long compilation for a sweep that hangs.
        with self.wanted.waiting("computing what the motor can do"):
            self._guard()
        with self.wanted.waiting("looking for the instruments"):
            self.acquisition.connect()
        writer = RunWriter.create(self.wanted.root, self._start(), self.wanted.wire)
        begin_ns = self.place.clock.now_ns()
        outcome = Outcome("failed", "the program ended", False, [], [])
        watchdog = None
        try:
            self.acquisition.begin(writer)
            watchdog = self._watchdog(writer)
            with self.wanted.beside(writer.folder, self._note) as tell:
                outcome = self._course(writer, course, self._hooks(watchdog, course, tell))
        except BaseException as error:
            outcome = Outcome("failed", why_failed(error), False, [], [])
            error.add_note(self._seal(writer, outcome, begin_ns, watchdog))
            raise
        self._seal(writer, outcome, begin_ns, watchdog)
        return writer.folder, outcome

    def _note(self, kind: str, **details: Any) -> None:
        self.acquisition.event(kind, None, **details)

    def _start(self) -> StartRecord:
        room, wanted = self.ambient, self.wanted
        kind: Any = "manual" if wanted.kind == "sweep" and is_manual(self.bench) else wanted.kind
        circumstances = Circumstances(
            wanted.operator,
            room.record(),
            room.lubrication,
            room.minutes_running,
            wanted.parent,
            wanted.motor_serial,
            wanted.note,
        )
        place, identities = self.place, self.acquisition.identities()
        simulated, more = place.virtual is not None, {"seal": place.seal}
        return start_record(self.bench, kind, place.clock, identities, circumstances, simulated, more)

    def _course(self, writer: RunWriter, course: Course, hooks: Hooks) -> Outcome:
        steps = [[step.level_bar_abs, step.direction, step.repeat] for step in course.steps]
        captures = [[capture.kind, capture.level_bar_abs] for capture in course.captures]
        self._note(COURSE, steps=steps, captures=captures)
        if self.conversation is not None and is_manual(self.bench):
            return ManualSweep(self.acquisition, writer, self.bench, course, self.conversation, hooks).run()
        return Runner(self.acquisition, writer, self.bench, course, hooks).run()

    def _watchdog(self, writer: RunWriter) -> Watchdog | None:
        """The failsafes set, and a watchdog that watches; neither where a person has the valve."""
        if self.bench.file.roles.regulator is None:
            return None
        for line in set_and_check(self.acquisition, self.bench):
            self.acquisition.event("failsafe", None, text=line)
        virtual = self.place.virtual
        line_name = self.bench.file.devices[self.bench.file.roles.regulator].line
        where = None if virtual is None else virtual.get(line_name)
        log, seal = writer.folder / WATCHDOG, writer.folder / END
        plan = WatchdogPlan.of(self.bench, self.path, self.place.clock, log, where, seal)
        watchdog = Watchdog.start(plan, ATTENDED_S)
        self.acquisition.event("watchdog", None, pid=watchdog.pid)
        return watchdog

    def _limits(self) -> Limits:
        """What a reading may not pass."""
        file = self.bench.file
        return Limits(file.safety, file.roles, self.ambient.pressure_bar_abs, self.place.clock.rate)

    def _expected(self, course: Course, is_gauge: bool) -> Callable[[Sequence[Plateau]], None]:
        """Notes what the guard holds for possible, for whoever watches: speeds over the levels, and f_overall."""
        first = self.ambient.pressure_bar_abs
        wanted = [step.level_bar_abs for step in course.steps] + [one.level_bar_abs for one in course.captures]
        top = max(wanted, default=first)
        levels = [first + (top - first) * share / BAND_LEVELS for share in range(1, BAND_LEVELS + 1)]

        def note(plateaus: Sequence[Plateau]) -> None:
            guard, points = self._guard(), points_of(plateaus, self.ambient.pressure_bar_abs if is_gauge else 0.0)
            try:
                band = [guard.predict(level * BAR, points) for level in levels]
                mean, sd = guard.friction(points)
            except SafetyError:  # no pressure that the model reaches: there is no band then
                return
            speeds = [
                [round(level, 4), round(one.lower99_rpm, 1), round(one.mean_rpm, 1), round(one.upper99_rpm, 1)]
                for level, one in zip(levels, band, strict=True)
            ]
            turning = sum(point.speed_rad_s > 0.0 for point in points)
            friction = {"mean": mean, "sd": sd}
            self._note(EXPECTED, plateaus=len(points), turning=turning, f_overall=friction, band=speeds)

        return note

    def _hooks(self, watchdog: Watchdog | None, course: Course, tell: Callable[[Plateau], None]) -> Hooks:
        """What the course asks and tells on its way."""
        limits = self._limits()

        def trip(view: View, now_ns: int, pressurised: bool) -> str | None:
            limits.ambient_bar_abs = self.ambient.pressure_bar_abs
            fault = watchdog.fault() if watchdog is not None else None
            return fault or limits.trip(view, now_ns, pressurised)

        measured, is_gauge = list(course.known), self.bench.file.roles.pressure.endswith("_gauge")
        expected = self._expected(course, is_gauge)
        expected(measured)

        def taken(plateau: Plateau) -> None:
            tell(plateau)
            measured.append(plateau)
            expected(measured)

        def of_guard(hook: Callable[[Guard, float, bool], Callable[..., T]]) -> Callable[..., T]:
            """A hook of the guard, in the room as it is told to be when it is asked."""
            return lambda *asked: hook(self._guard(), self.ambient.pressure_bar_abs, is_gauge)(*asked)

        return Hooks(
            of_guard(guarded),
            trip,
            lambda: self.stop.asked,
            self.wanted.progress,
            Silent() if self.conversation is None else ValveHand(self.conversation),
            taken,
            of_guard(expecting),
            of_guard(doubting),
        )

    def _seal(self, writer: RunWriter, outcome: Outcome, begin_ns: int, watchdog: Watchdog | None) -> str:
        """Statistics, last readings, end record; a failure of the run log is told once the run is closed.

        A line that is not known to be vented is left to the watchdog, which tries on by itself. What is known of the
        line is returned in words, and goes with every error.
        """
        minutes = (self.place.clock.now_ns() - begin_ns) / NS / 60.0
        statistics = self.acquisition.statistics()
        self.acquisition.event("statistics", None, **statistics)
        failure: RecorderError | None = None
        try:
            self.acquisition.stop()
        except RecorderError as error:
            failure = error
            outcome = replace(outcome, outcome="failed", reason=str(error))
        line = "the line is without pressure" if outcome.vented else UNVENTED
        if watchdog is not None and outcome.vented:
            watchdog.release()
        elif watchdog is not None and watchdog.hand_over():
            line = f"{UNVENTED}; the regulator reads back zero"
        room: Any = self._room_at_end(minutes, outcome.outcome == "finished").record()
        kind: Any = outcome.outcome
        by: Any = outcome.stopped_by
        try:
            writer.end(kind, outcome.reason, room, statistics, outcome.vented, by)
        except RunError as error:
            failure = RecorderError(f"{failure or error}; the run counts as killed")
        if failure is not None:
            failure.add_note(line)
            raise failure
        return line

    def _room_at_end(self, minutes: float, ask: bool) -> Ambient:
        """The room once more; as at the start where nobody says, for no answer may keep a run from being sealed."""
        if not ask or self.wanted.ask is None:
            return at_end(self.ambient, minutes)
        try:
            with self.stop.interrupting():
                if self.conversation is not None:
                    self.conversation.resume()  # its port was closed with the other lines
                return at_end(self.ambient, minutes, self.wanted.ask)
        except (AmbientError, LineError, StoppedError, KeyboardInterrupt):
            self.wanted.progress.say("the room's figures at the end were not told; those of the start stand", True)
            return at_end(self.ambient, minutes)


def enter(
    bench: Bench,
    text: str,
    ambient: Ambient,
    root: Path,
    operator: str = "",
    motor_serial: str | None = None,
    note: str = "",
    date: str = "",
    as_read: bool = False,
) -> Path:
    """A run from a sheet that was filled in. Raises SheetError: every mistake of the sheet; there is no run then.

    `as_read`: improbable readings are entered, with a note.
    """
    rows = checked_sheet(text, bench, ambient, as_read)
    room = (ambient.record(), ambient.lubrication, ambient.minutes_running)
    circumstances = Circumstances(operator, *room, None, motor_serial, note)
    more = {"imported": {"source": "a sheet that was filled in", "date": date}}
    writer = RunWriter.create(root, start_record(bench, "manual", Clock(), {}, circumstances, more=more))
    with writer:
        outcome = enter_sheet(bench, rows, writer, ambient)
        kind: Any = outcome.outcome
        writer.end(kind, outcome.reason, ambient.record(), None, outcome.vented)
    return writer.folder
