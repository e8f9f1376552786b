"""The sweep as an explicit state machine. It reads no clock, opens nothing and waits for nothing.

    zero -> next -> ramp -> settle -> dwell -> next ... -> capture -> next ... -> vent -> zero -> done
    any state -> vent -> aborted | failed

`SweepMachine.advance` is given the time and a view of the bench, and returns what is to be done. Whatever happens, the
last pressure that it orders is none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from configs.units import BAR
from rig.interlock.step import Verdict
from rig.plateaus.plan import SAME_BAR, UP, Step, stepping_stone
from rig.plateaus.plateau import Plateau
from rig.readings import NS
from rig.runlog.schema import ADDED, ended
from rig.sweep import judge
from rig.sweep.capturing import CaptureTask, Capturing
from rig.sweep.course import ENDED, Course, State
from rig.sweep.orders import (
    ABORTED,
    FAILED,
    FINISHED,
    INTERLOCK,
    OPERATOR,
    VENTED,
    Ask,
    Doubt,
    Entered,
    Finish,
    Order,
    Predict,
    Record,
    Refused,
    Say,
    SetPressure,
    Trip,
    View,
    Zero,
)

WRITE_EVERY_S = 0.2  # set-points of a ramp: a bus has other things to do
LONGEST_STEP_S = 0.5  # whatever held the program up, no step of a ramp makes up for it
JUDGE_EVERY_S = 0.25
READINGS_TIMEOUT_S = 3.0  # for the last readings of a span to come in: slower than the slowest instrument
VENT_TIMEOUT_S = 15.0
VENT_AGAIN_S = 1.0  # the order to vent is repeated until the gauge says so


class SweepMachine:
    """Goes through a course.

    `trip`: asked at every advance: a reason to vent now, or None.
    `doubt`: asked before every level and at the end: why the speeds measured last cannot be so, or nothing.
    """

    def __init__(self, course: Course, predict: Predict, trip: Trip, doubt: Doubt = lambda plateaus: "") -> None:
        self.course, self.table = course, course.table
        self.state = State.ZERO
        self.plateaus: list[Plateau] = []
        self._predict, self._trip, self._doubt = predict, trip, doubt
        self._tasks: deque[Step | CaptureTask] = deque([*course.steps, *course.captures])
        self._task: Step | CaptureTask | None = None
        self._targets: deque[float] = deque()
        self._set_bar = course.ambient_bar  # the set-point as ordered last
        self._entered_ns = 0
        self._looked_ns = 0
        self._quiet_ns: int | None = None  # since when the line is vented and the rotor at rest
        self._settled, self._notes = True, list[str]()
        self._made = False  # whether anything of the course was taken, what led to it apart
        self._lacking = ""  # why what was taken last cannot be used
        self._remarks: list[str] = []  # what whoever reads how the run ended should know
        self._capturing: Capturing | None = None
        self._lost: list[CaptureTask] = []
        self._zero = "start"
        # Outcome, reason and who stopped it, once it is known that it ends early.
        self._ending: tuple[str, str, str | None] | None = None
        self._begun = False
        self._work: dict[State, Callable[[int, View], list[Order]]] = {
            State.ZERO: self._in_zero,
            State.NEXT: self._in_next,
            State.RAMP: self._in_ramp,
            State.SETTLE: self._in_settle,
            State.DWELL: self._in_dwell,
            State.CAPTURE: self._in_capture,
            State.VENT: self._in_vent,
        }

    @property
    def ended(self) -> bool:
        """Whether it is over."""
        return self.state in ENDED

    @property
    def pressurised(self) -> bool:
        """Whether more than the room's pressure is ordered."""
        return self._set_bar > self.course.ambient_bar + SAME_BAR

    @property
    def tasks_left(self) -> int:
        """Plateaus and captures not done yet [-]."""
        return len(self._tasks) + (self._task is not None)

    def advance(self, now_ns: int, view: View) -> list[Order]:
        """Go on. Its orders are to be carried out in order; none once it has ended."""
        if self.ended:
            return []
        if not self._begun:
            self._begun = True
            return [*self._enter(State.ZERO, now_ns, which="start"), *self._release()]
        if view.stops > 1 and self._ending is not None:
            return self._finish(now_ns, view)
        if self._ending is None:
            if view.stops:
                return self.abort(now_ns, "stopped by the operator", OPERATOR)
            reason = self._trip(view, now_ns, self.pressurised)
            if reason is not None:
                return self.abort(now_ns, reason, INTERLOCK)
        return self._work[self.state](now_ns, view)

    def abort(self, now_ns: int, reason: str, by: str) -> list[Order]:
        """Vent, and end the run as aborted by the operator or an interlock."""
        return self._leave(now_ns, ABORTED, reason, by)

    def fail(self, now_ns: int, reason: str) -> list[Order]:
        """Vent, and end the run as failed: something of the bench or of this program does not work."""
        return self._leave(now_ns, FAILED, reason)

    # What ends it.

    def _leave(self, now_ns: int, outcome: str, reason: str, by: str | None = None) -> list[Order]:
        if self.ended or self._ending is not None:
            return []
        self._ending = (outcome, reason, by)
        orders: list[Order] = self._release()  # before anything else
        if self._capturing is not None:
            orders += self._capturing.cut_short(now_ns)
            self._capturing = None
        return [
            *orders,
            Say(ended(outcome, by, reason), warning=True),
            *self._enter(State.VENT, now_ns, reason=reason),
        ]

    def _finish(self, now_ns: int, view: View) -> list[Order]:
        outcome, reason, by = self._ending or (FINISHED, "; ".join(self._remarks), None)
        ended = {FINISHED: State.DONE, ABORTED: State.ABORTED, FAILED: State.FAILED}[outcome]
        vented = judge.is_vented(view, self.course.ambient_bar)
        return [SetPressure(VENTED), *self._enter(ended, now_ns), Finish(outcome, reason, vented, by)]

    # The states, each with what it does at an advance.

    def _in_zero(self, now_ns: int, view: View) -> list[Order]:
        waited_s = (now_ns - self._entered_ns) / NS
        if self._quiet_ns is None:
            unquiet = judge.not_at_rest(view, self.course.ambient_bar)
            if self.course.by_hand and self._zero == "start" and view.answer is None:
                return []
            if unquiet and waited_s < self.table.settle_timeout_s:
                return []
            missing = judge.not_reading(view)
            if missing and self._zero == "start":
                return self.fail(now_ns, missing)
            if unquiet and self._zero == "start" and not judge.is_near_ambient(view, self.course.ambient_bar):
                return self.fail(now_ns, f"the line does not vent: {unquiet}")
            if self._zero == "end" and not missing and judge.is_vented(view, self.course.ambient_bar):
                if unquiet and (hangs := judge.hanging(view, self._entered_ns, now_ns)):
                    return self.fail(now_ns, hangs)
                self._remarks += [unquiet] if unquiet else []
            self._quiet_ns = now_ns
            return [Say(f"zero taken although {unquiet}", warning=True)] if unquiet else []
        end_ns = self._quiet_ns + round(self.table.zero_s * NS)
        if not self._is_over(end_ns, now_ns, view, self.course.zero_channels):
            return []
        means = {name: judge.mean(view, name, self._quiet_ns, end_ns) for name in self.course.zero_channels}
        vented = judge.is_vented(view, self.course.ambient_bar)
        orders: list[Order] = [Zero(self._zero, self._quiet_ns, end_ns, means, vented)]
        alone = not (self._tasks or "end" in self.course.zeros)
        lacking = judge.not_read(view, self._quiet_ns, end_ns) if alone else ""
        if lacking:
            return [*orders, *self.fail(now_ns, f"the zero cannot be used: {lacking}")]
        if self._zero == "end" or alone:
            return [*orders, *self._finish(now_ns, view)]
        return [*orders, *self._enter(State.NEXT, now_ns)]

    def _in_next(self, now_ns: int, view: View) -> list[Order]:
        self._task = None
        doubt = self._doubt(self._known) if self.plateaus else ""
        if doubt:
            return self.fail(now_ns, doubt)
        if not self._tasks and self._lacking and (not self._made or judge.not_reading(view)):
            return self.fail(now_ns, self._lacking)
        if not self._tasks:
            said = [one for one in (judge.lost(self.plateaus), judge.none_turns(self.plateaus)) if one]
            self._remarks += said
            warned = [Say(text, warning=True) for text in said]
            return [*warned, *self._release(), *self._enter(State.VENT, now_ns)]
        task = self._tasks.popleft()
        verdict = self._verdict(task.level_bar_abs)
        self._task, self._notes, self._settled = task, [], True
        if not verdict.allowed:
            return self._before(task, verdict, now_ns) or self._refuse(task, verdict.text, now_ns)
        if isinstance(task, CaptureTask) and task.kind == "spin-up":
            self._capturing = self._capture(task, now_ns)
            return [*self._release(), *self._enter(State.CAPTURE, now_ns, capture=task.kind)]
        self._targets = deque([task.level_bar_abs])
        way = task.by_way_of_bar_abs if isinstance(task, Step) else None
        if way is not None and self._verdict(way).allowed:
            self._targets.appendleft(way)
        return self._start_ramp(now_ns)

    @property
    def _known(self) -> list[Plateau]:
        """What was measured here, and in the runs that this one continues."""
        return [*self.course.known, *self.plateaus]

    def _verdict(self, level_bar_abs: float) -> Verdict:
        return self._predict(level_bar_abs, self._known)

    def _before(self, task: Step | CaptureTask, verdict: Verdict, now_ns: int) -> list[Order]:
        """A plateau on the way to a refused level, where that lets the guard see farther; nothing where not."""
        taken = [self.course.ambient_bar, *(plateau.step.level_bar_abs for plateau in self._known)]
        stone = stepping_stone(task.level_bar_abs, verdict.highest_pa_abs / BAR, taken)
        if stone is None or not self._verdict(stone).allowed:
            return []
        self._tasks.appendleft(task)
        self._task = Step(stone, UP, 1)
        self._notes.append(f"{ADDED} on the guard's account")
        self._targets = deque([stone])
        return [Say(f"measuring {stone:g} bar abs first: {verdict.text}"), *self._start_ramp(now_ns)]

    def _refuse(self, task: Step | CaptureTask, text: str, now_ns: int) -> list[Order]:
        self._task = None
        ceiling = task.level_bar_abs - SAME_BAR
        gone = [task, *(other for other in self._tasks if other.level_bar_abs >= ceiling)]
        self._tasks = deque(other for other in self._tasks if other.level_bar_abs < ceiling)
        words = f"{task.level_bar_abs:g} bar abs and above are left out: {text}"
        steps = tuple(step for step in gone if isinstance(step, Step))
        refused = Refused(task.level_bar_abs, text, steps)
        if not (self._tasks or self._made):
            return [refused, *self.fail(now_ns, self._lacking or text)]
        return [refused, Say(words, warning=True)]

    def _start_ramp(self, now_ns: int) -> list[Order]:
        target = self._targets[0]
        is_added = isinstance(self._task, Step) and self._task not in self.course.steps
        orders = self._enter(State.RAMP, now_ns, target_bar_abs=target, **({ADDED: True} if is_added else {}))
        if self.course.by_hand:
            side = "from below" if target >= self._set_bar else "from above"
            gauge = target - self.course.ambient_bar
            orders.append(Ask(f"Set {target:.3f} bar absolute ({gauge:.3f} bar gauge), {side}, then press Enter"))
            self._set_bar = target  # the valve is in motion from now on
        self._looked_ns = now_ns
        return orders

    def _in_ramp(self, now_ns: int, view: View) -> list[Order]:
        target = self._targets[0]
        if self.course.by_hand:
            return [] if view.answer is None else self._enter(State.SETTLE, now_ns)
        passed_s = (now_ns - self._looked_ns) / NS
        way = target - self._set_bar
        reach = self.table.ramp_bar_s * min(passed_s, LONGEST_STEP_S)
        if abs(way) > reach and passed_s < WRITE_EVERY_S:
            return []
        self._looked_ns = now_ns
        self._set_bar = target if abs(way) <= reach else self._set_bar + (reach if way > 0.0 else -reach)
        orders: list[Order] = [SetPressure(self._set_bar)]
        return [*orders, *self._enter(State.SETTLE, now_ns)] if self._set_bar == target else orders

    def _in_settle(self, now_ns: int, view: View) -> list[Order]:
        if (now_ns - self._looked_ns) / NS < JUDGE_EVERY_S:
            return []
        self._looked_ns = now_ns
        waited_s = (now_ns - self._entered_ns) / NS
        if len(self._targets) > 1:  # only passing by, for the sake of the side
            if waited_s < self.table.window_s:
                return []
            self._targets.popleft()
            return self._start_ramp(now_ns)
        why = judge.not_settled(view, self.table, self._entered_ns, now_ns)
        if why and waited_s < self.table.settle_timeout_s:
            return []
        orders: list[Order] = []
        if why:
            self._settled = False
            self._notes.append(f"not settled after {waited_s:.0f} s: {why}")
            orders.append(Say(f"{self._targets[0]:g} bar abs: {self._notes[-1]}", warning=True))
        if isinstance(self._task, CaptureTask):
            self._capturing = self._capture(self._task, now_ns)
            return [*orders, *self._enter(State.CAPTURE, now_ns, capture=self._task.kind)]
        return [*orders, *self._enter(State.DWELL, now_ns, settled=self._settled)]

    def _in_dwell(self, now_ns: int, view: View) -> list[Order]:
        end_ns = self._entered_ns + round(self.table.dwell_s * NS)
        if not (isinstance(self._task, Step) and self._is_over(end_ns, now_ns, view, self.course.roles)):
            return []
        means = {role: judge.mean(view, role, self._entered_ns, end_ns) for role in self.course.roles}
        notes = [*self._notes, *judge.remarks(means, self._task.level_bar_abs, view, self.course.ambient_bar)]
        number = len(self.plateaus) + 1
        taken = Plateau(number, self._task, self._entered_ns, end_ns, self._settled, means, "; ".join(notes))
        self.plateaus.append(taken)
        lacking = judge.not_read(view, self._entered_ns, end_ns)
        self._lacking = f"no plateau can be used: {lacking}" if lacking else ""
        self._made |= self._task in self.course.steps and not lacking
        return [Record(taken), *self._enter(State.NEXT, now_ns)]

    def _is_over(self, end_ns: int, now_ns: int, view: View, channels: Iterable[str]) -> bool:
        """Whether a span has passed and its readings are in, as far as they come."""
        late_s = (now_ns - end_ns) / NS
        return late_s >= 0.0 and (late_s > READINGS_TIMEOUT_S or judge.all_in(view, channels, end_ns))

    def _in_capture(self, now_ns: int, view: View) -> list[Order]:
        if self._capturing is None:
            return self._enter(State.NEXT, now_ns)
        orders = self._capturing.advance(now_ns, view)
        for order in orders:
            if isinstance(order, SetPressure):
                self._set_bar = max(order.bar_abs, self.course.ambient_bar)
        if not self._capturing.over:
            return orders
        over, self._capturing = self._capturing, None
        self._made |= not over.lost
        return [*orders, *(self._lose(over, now_ns, view) if over.lost else self._enter(State.NEXT, now_ns))]

    def _lose(self, over: Capturing, now_ns: int, view: View) -> list[Order]:
        """Take a capture that cannot be used once more; the second time, or with nothing read, go on without it."""
        task, what = over.task, f"the {over.task.kind} cannot be used: {over.lost}"
        is_first = task not in self._lost and not judge.not_reading(view)
        if is_first:
            self._lost.append(task)
            self._tasks.appendleft(task)
        elif over.unseen or not (self._tasks or self._made):
            return self.fail(now_ns, f"{what}. What was read is kept; `spinbench doctor` examines the instruments")
        else:
            self._remarks.append(what)
        more = "; it is taken once more" if is_first else ""
        return [Say(what + more, warning=True), *self._enter(State.NEXT, now_ns)]

    def _capture(self, task: CaptureTask, now_ns: int) -> Capturing:
        return Capturing(task, self.course.ambient_bar, now_ns, self.course.by_hand)

    def _in_vent(self, now_ns: int, view: View) -> list[Order]:
        waited_s = (now_ns - self._entered_ns) / NS
        if self.course.by_hand and view.answer is None:  # the line counts as unvented until the person says so
            return []
        quiet = judge.is_vented(view, self.course.ambient_bar)
        if quiet or waited_s > VENT_TIMEOUT_S:
            orders: list[Order] = []
            if not quiet:
                orders.append(Say("the gauge does not say that the line is vented: close the supply", warning=True))
            if self._ending is not None or "end" not in self.course.zeros:
                return [*orders, *self._finish(now_ns, view)]
            self._zero, self._quiet_ns = "end", None
            return [*orders, *self._enter(State.ZERO, now_ns, which="end")]
        if not self.course.by_hand and (now_ns - self._looked_ns) / NS >= VENT_AGAIN_S:
            self._looked_ns = now_ns
            return [SetPressure(VENTED)]
        return []

    def _release(self) -> list[Order]:
        self._set_bar = self.course.ambient_bar
        orders: list[Order] = [SetPressure(VENTED)]
        if self.course.by_hand:
            orders.append(Ask("Close the valve and let the line vent, then press Enter"))
        return orders

    def _enter(self, state: State, now_ns: int, **details: object) -> list[Order]:
        self.state, self._entered_ns, self._looked_ns = state, now_ns, now_ns
        return [Entered(state.value, details)]
