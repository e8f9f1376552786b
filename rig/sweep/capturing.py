"""One run in time within a sweep: rest, lead, event, end. Part of the sweep's machine, and as pure."""

from __future__ import annotations

from dataclasses import dataclass

from rig.readings import NS
from rig.recording import captured_s
from rig.sweep import judge
from rig.sweep.orders import VENTED, Ask, CaptureEnd, CaptureStart, Order, Say, SetPressure, View

LEAD_S = 0.5  # recorded before the event
REST_TIMEOUT_S = 30.0
LONGEST_WAIT_S = 30.0  # how long a coast-down waits for the line to be vented and the rotor to stand


@dataclass(frozen=True)
class CaptureTask:
    """A capture to be made.

    `kind`: ``coast-down``: from speed, the line vented; ``spin-up``: from rest, the set-point in one step.
    `level_bar_abs`: absolute pressure before or after [bar].
    """

    kind: str
    level_bar_abs: float
    expected_s: float


class Capturing:
    """Goes through one capture."""

    def __init__(self, task: CaptureTask, ambient_bar: float, now_ns: int, by_hand: bool = False) -> None:
        self.task = task
        self.over, self.lost = False, ""  # lost: why what was recorded cannot be used
        self.unseen = False  # whether that is since the tachometer saw nothing turn
        self._ambient_bar, self._by_hand = ambient_bar, by_hand
        self._since_ns = now_ns
        self._start_ns: int | None = None
        self._event_ns: int | None = None
        self._moved = by_hand  # whether it is known when the valve was moved

    @property
    def duration_s(self) -> float:
        """How long is recorded after the event [s]."""
        return captured_s(self.task.expected_s)

    def advance(self, now_ns: int, view: View) -> list[Order]:
        """Go on."""
        if self._start_ns is None:
            return self._in_rest(now_ns, view)
        if self._event_ns is None:
            if now_ns - self._start_ns < LEAD_S * NS:
                return []
            self._event_ns = now_ns
            return self._event()
        if self._by_hand and view.answer is None:
            self._event_ns = now_ns  # the person has the valve in hand: it is moved within this second
            return []
        if view.set_ns is not None and view.set_ns > self._event_ns and not self._moved:
            if view.set_unsure:
                self.over, self.lost = True, view.set_unsure
                end = CaptureEnd(self.task.kind, self._start_ns, self._event_ns, now_ns, left_out=self.lost)
                return [SetPressure(VENTED), end]
            self._event_ns, self._moved = view.set_ns, True  # the line was busy when the order was given
        passed_s = (now_ns - self._event_ns) / NS
        if passed_s < self.duration_s:
            return []
        # By hand the valve was moved some time before it was said: the rotor may stand by then.
        since_ns = self._start_ns if self._by_hand else self._event_ns
        silent, still = judge.not_read(view, self._event_ns, now_ns), judge.not_turning(view, since_ns, now_ns)
        lost, self.unseen = silent or still, not silent and bool(still)
        end = CaptureEnd(self.task.kind, self._start_ns, self._event_ns, now_ns, left_out=lost)
        if self.task.kind == "spin-up":
            self.over, self.lost = True, lost
            return [SetPressure(VENTED), end]
        unquiet = judge.not_at_rest(view, self._ambient_bar)
        if unquiet and passed_s < max(LONGEST_WAIT_S, self.duration_s):
            return []  # the line is still emptying, or the rotor still runs out: that belongs to the coast-down
        self.over, self.lost = True, lost
        left = [Say(f"the coast-down ends after {passed_s:.0f} s, not at rest: {unquiet}", warning=True)]
        return [*(left if unquiet else []), end]

    def _event(self) -> list[Order]:
        down = self.task.kind == "coast-down"
        if not self._by_hand:
            return [SetPressure(VENTED if down else self.task.level_bar_abs)]
        words = "Shut the valve at once" if down else f"Open the valve at once, to {self.task.level_bar_abs:g} bar abs"
        return [Ask(f"{words}, and press Enter")]

    def cut_short(self, now_ns: int) -> list[Order]:
        """End the recording now."""
        self.over = True
        if self._start_ns is None:
            return []
        return [CaptureEnd(self.task.kind, self._start_ns, self._event_ns or now_ns, now_ns, cut_short=True)]

    def _in_rest(self, now_ns: int, view: View) -> list[Order]:
        if self.task.kind == "spin-up":
            unquiet = judge.not_at_rest(view, self._ambient_bar)
            if unquiet and now_ns - self._since_ns < REST_TIMEOUT_S * NS:
                return []
            if unquiet:
                self.over, self.lost = True, unquiet
                return []
        self._start_ns = now_ns
        return [CaptureStart(self.task.kind, self.task.level_bar_abs)]
