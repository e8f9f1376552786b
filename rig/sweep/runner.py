"""Runs a course on a bench: shows the machine what the bench shows, and does what the machine wants.

On every way out of here the regulator is told to give no pressure.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from rig.acquisition import Acquisition, Window
from rig.acquisition.actions import FAULTS
from rig.bench.bench import Bench
from rig.bench.instrument import EdgeReader
from rig.plateaus.plan import Step, SweepError
from rig.plateaus.plateau import Plateau
from rig.readings import NS, Event, Reading
from rig.runlog import columns_of
from rig.runlog.schema import CAPTURE, ZERO, ending
from rig.sweep.course import Course, State
from rig.sweep.hooks import Hooks
from rig.sweep.machine import SweepMachine
from rig.sweep.orders import (
    VENTED,
    Ask,
    CaptureEnd,
    CaptureStart,
    Entered,
    Finish,
    Order,
    Record,
    Refused,
    Say,
    SetPressure,
    Zero,
)

PERIOD_REAL_S = 0.05  # between two looks at the bench
CAPTURE_REAL_S = 0.01  # while every tooth is read
COMMAND_REAL_S = 5.0
VENT_TRIES = 3
ANSWER_REAL_S = 0.4  # from an order to its answer, above which it is not known when the pressure began to change
SET_TRIES = 2  # never blindly: the driver has read back that the first order was not taken


class PlateauSink(Protocol):
    """Where plateaus are written: `rig.runlog.RunWriter`."""

    def plateau(self, row: Mapping[str, Any]) -> None:
        """Write a plateau: columns of plateaus.csv."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    `vented`: whether the gauge, or the person, said at the end that the line is without pressure.
    `stopped_by`: ``operator`` or ``interlock`` where it was aborted.
    """

    outcome: str
    reason: str
    vented: bool
    plateaus: list[Plateau]
    left_out: list[Step]
    stopped_by: str | None = None


class BenchView:
    """The bench as the machine sees it."""

    def __init__(self, acquisition: Acquisition) -> None:
        self._acquisition = acquisition
        self.stops = 0
        self.answer: str | None = None
        self.set_ns: int | None = None
        self.set_unsure = ""

    def window(self, channel: str, start_ns: int, end_ns: int) -> Window:
        """The usable readings between two times."""
        return self._acquisition.between(channel, start_ns, end_ns)

    def last(self, channel: str) -> Reading | None:
        """The newest reading of a channel or role; None before the first."""
        return self._acquisition.last(channel)

    def since(self, channel: str, after_ns: int) -> list[Reading]:
        """The readings of a channel or role, failed or not, whose replies came after a time [ns]."""
        return self._acquisition.since(channel, after_ns)


class Runner:
    """Carries out a machine's orders on a bench. `acquisition`: started; it is not stopped here."""

    def __init__(self, acquisition: Acquisition, sink: PlateauSink, bench: Bench, course: Course, hooks: Hooks) -> None:
        self.acquisition, self.sink, self.course, self.hooks = acquisition, sink, course, hooks
        self.clock = acquisition.clock
        self.machine = SweepMachine(course, hooks.predict, hooks.trip, hooks.doubt)
        self.view = BenchView(acquisition)
        self.regulator = bench.file.roles.regulator
        self.to_set_point = set_points(bench, course.ambient_bar)
        self.speed_device = bench.file.roles.speed.partition(".")[0]
        self.reads_teeth = isinstance(bench.build(self.speed_device), EdgeReader)
        self.gauge = bench.file.roles.pressure.partition(".")[0]
        self.columns = columns_of(bench.file.roles.model_dump())
        self.total = len(course.steps) + len(course.captures) or 1  # a zero alone is one
        self.left_out: list[Step] = []
        self.finish: Finish | None = None
        self._capturing = False
        self._dead = ""  # what the regulator's last fault was

    def run(self) -> Outcome:
        """Go through the course.

        It returns also when it failed; what is not the bench's fault is raised once the regulator is at zero. Where it
        is not known to be there, the outcome says so.
        """
        try:
            while self.finish is None:
                self._turn()
        finally:
            released = self._release()
            self.acquisition.relax(self.gauge)
        finish = self.finish
        vented = finish.vented and released
        taken = list(self.machine.plateaus)
        return Outcome(finish.outcome, finish.reason, vented, taken, self.left_out, finish.stopped_by)

    def _turn(self) -> None:
        self.view.stops = self.hooks.stops()
        self.view.answer = self.hooks.person.answer() if self.course.by_hand else None
        self._carry_out(self.machine.advance(self.clock.now_ns(), self.view))
        if self._capturing:
            self._read_teeth()
        if self.finish is None:
            self.clock.sleep(self.clock.rate * (CAPTURE_REAL_S if self._capturing else PERIOD_REAL_S))

    def _carry_out(self, orders: Sequence[Order]) -> None:
        for order in orders:
            if isinstance(order, SetPressure) and not self._set(order.bar_abs):
                failing = self.machine.fail(self.clock.now_ns(), f"{self.regulator}: {self._dead}")
                if failing:  # what was to follow no longer holds
                    self._carry_out(failing)
                    return
            self._do(order)

    def _do(self, order: Order) -> None:
        match order:
            case Ask():
                self._note("asked", text=order.text)
                self.hooks.person.ask(order.text)
            case Say():
                self._note("warning" if order.warning else "note", text=order.text)
                self.hooks.progress.say(order.text, order.warning)
            case Entered():
                self._note("state", state=order.state, **order.details)
                zero_left = not (self.course.steps or self.course.captures) and order.state != State.DONE
                done = self.total - (self.machine.tasks_left or zero_left)
                self.hooks.progress.advance(done, self.total, _words(order))
            case Record():
                self._record(order.plateau)
            case Zero():
                self._note(ZERO, **_zero_details(order))
            case Refused():
                self.left_out += order.left_out
                levels = [[step.level_bar_abs, step.direction, step.repeat] for step in order.left_out]
                self._note("level refused", level_bar_abs=order.level_bar_abs, text=order.text, left_out=levels)
            case CaptureStart():
                self._capturing = self.reads_teeth
                if not (self.reads_teeth and self.gauge == self.speed_device):
                    self.acquisition.hurry(self.gauge)
                self._note("capture start", capture=order.kind, level_bar_abs=order.level_bar_abs)
            case CaptureEnd():
                self._end_capture(order)
            case Finish():
                self.finish = order

    def _set(self, bar_abs: float) -> bool:
        """Write a set-point, and tell whether it was taken; one that reads back as not taken is ordered once more."""
        if self.regulator is None:
            return True
        value = self.to_set_point(bar_abs)
        asked = "the order to vent" if bar_abs == VENTED else f"{bar_abs:g} bar abs"
        for tried in range(SET_TRIES):
            try:
                # An order to raise comes in time or never; one to vent is good at any time.
                done = self.acquisition.command(self.regulator, "write", value, COMMAND_REAL_S, bar_abs != VENTED)
            except FAULTS as error:
                fault = str(error)
                told = f"the regulator does not take {asked}: {fault}"
                self._note("set-point not taken", value=value, error=fault, text=told)
            else:
                self._dead = ""
                self.view.set_ns, self.view.set_unsure = _taken(done.events, tried > 0, self.clock.rate)
                where = bar_abs if bar_abs != VENTED else None
                self._note("set-point", device=self.regulator, value=value, bar_abs=where)
                return True
        if fault != self._dead:
            self._dead = fault
            self.hooks.progress.say(told, True)
        return False

    def _record(self, plateau: Plateau) -> None:
        self.sink.plateau(plateau.row(self.columns))
        means = {role: dataclasses.asdict(mean) for role, mean in plateau.means.items()}
        self._note("plateau", plateau=plateau.number, level_bar_abs=plateau.step.level_bar_abs, means=means)
        self.hooks.progress.say(plateau.sentence())
        self.hooks.on_plateau(plateau)

    def _read_teeth(self) -> None:
        try:
            self.acquisition.command(self.speed_device, "capture", None, COMMAND_REAL_S)
        except FAULTS as error:
            self._note("capture failed", error=str(error))
            self._capturing = False

    def _end_capture(self, order: CaptureEnd) -> None:
        self._capturing = False
        self.acquisition.relax(self.gauge)
        times = {"start_s": order.start_ns / NS, "event_s": order.event_ns / NS, "end_s": order.end_ns / NS}
        counts = {
            role: int(self.acquisition.between(role, order.start_ns, order.end_ns).size)
            for role in ("pressure", "speed")
        }
        seconds = (order.end_ns - order.start_ns) / NS
        rates = {f"{role}_hz": round(count / seconds, 3) for role, count in counts.items() if seconds > 0.0}
        marks: dict[str, Any] = {"cut_short": True} if order.cut_short else {}
        marks |= {"left_out": order.left_out} if order.left_out else {}
        self._note(CAPTURE, capture=order.kind, **times, **rates, **marks)
        if order.left_out:
            return
        self.hooks.progress.say(_captured(order, rates, seconds))

    def _release(self) -> bool:
        """No pressure, whatever happened before; True when the regulator took the order, or a person has the valve."""
        if self.regulator is None:
            return True
        for _ in range(VENT_TRIES):
            try:
                self.acquisition.command(self.regulator, "write", self.to_set_point(VENTED), COMMAND_REAL_S, False)
            except Exception as error:  # whatever it is, there is nothing better to do than to try again and to say so
                self._dead = str(error)
            else:
                return True
        self.hooks.progress.say(f"the regulator is not known to be at zero: close the supply ({self._dead})", True)
        return False

    def _note(self, kind: str, **details: Any) -> None:
        self.acquisition.event(kind, None, **details)


def _taken(events: Sequence[Event], again: bool, rate: float) -> tuple[int | None, str]:
    """When a regulator took its set-point: half way from the order to the answer [ns]; and why that is not known.

    `again`: whether it was told twice. `rate`: of the bench's clock [-].
    """
    orders = [i for i, event in enumerate(events) if event.kind == "tx"]
    if not orders:
        return None, ""
    asked, *others = orders
    answers = [event.time_ns for event in events[asked : others[0] if others else None] if event.kind == "rx"]
    begun_ns, known_ns = events[asked].time_ns, answers[-1] if answers else events[asked].time_ns
    took_s, why = (known_ns - begun_ns) / NS, ""
    if again:
        why = "the regulator took its set-point only when it was told again"
    elif took_s > ANSWER_REAL_S * rate:
        why = f"the regulator answered {took_s:.1f} s after it was told its set-point"
    return (begun_ns + known_ns) // 2, why and f"{why}, so it is not known when the pressure began to change"


def _zero_details(order: Zero) -> dict[str, Any]:
    return {
        "which": order.which,
        "start_s": order.start_ns / NS,
        "end_s": order.end_ns / NS,
        "vented": order.vented,
        "channels": {name: {"mean": mean.mean, "se": mean.se, "n": mean.n} for name, mean in order.means.items()},
    }


def _captured(order: CaptureEnd, rates: dict[str, float], seconds: float) -> str:
    pressure, speed = rates.get("pressure_hz", 0.0), rates.get("speed_hz", 0.0)
    ends = ", cut short" if order.cut_short else ""
    return (
        f"{order.kind}: {seconds:.1f} s recorded{ends}; the pressure was read {pressure:.3g} times a second, the speed "
        f"{speed:.3g} times"
    )


def _words(order: Entered) -> str:
    target = order.details.get("target_bar_abs")
    return f"{order.state} {target:g} bar abs" if isinstance(target, float) else ending(order.state, None)


def set_points(bench: Bench, ambient_bar: float) -> Callable[[float], float]:
    """From an absolute pressure [bar] to the regulator's set-point, as a function.

    Raises SweepError when the regulator's unit is not known here.
    """
    device = bench.file.roles.regulator
    if device is None:
        return lambda bar_abs: bar_abs
    driver = bench.regulator(device)
    zero = {"bar gauge": ambient_bar, "bar abs": 0.0}.get(driver.unit)
    if zero is None:
        raise SweepError(f"{device}: its set-point is in '{driver.unit}'; a sweep needs bar gauge or bar abs")
    none = max(driver.lowest, 0.0)

    def set_point(bar_abs: float) -> float:
        if bar_abs == VENTED:
            return none
        return min(max(bar_abs - zero, none), driver.highest)

    return set_point
