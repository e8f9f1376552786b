"""The machine of a sweep, walked through every state and every way out, against a bench of two first-order lags."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from rig.bench.bench import SweepTable
from rig.plateaus.plan import Step, plan
from rig.readings import NS, Quality, Reading
from rig.sweep import judge, orders
from rig.sweep.capturing import CaptureTask
from rig.sweep.course import Course
from rig.sweep.machine import SweepMachine
from tests.sweep_lab import AMBIENT, Lab

LEVELS = [1.3, 1.6, 1.9]
TABLE = SweepTable(levels_bar_abs=LEVELS, settle_timeout_s=20.0, dwell_s=4.0, zero_s=2.0)
ALLOWED = SimpleNamespace(allowed=True, text="")


class Walk:
    """Drives a machine on a lab and keeps every order; things happen when a state is entered."""

    def __init__(
        self, steps=None, captures=(), lab=None, predict=None, trip=None, by_hand=False, zeros=("start", "end"), **more
    ):
        self.lab = lab or Lab()
        steps = plan(LEVELS, "up-down") if steps is None else steps
        roles, channels = ("pressure", "flow", "speed"), ("gauge.pressure_bar_abs", "tach.speed_rpm")
        course = Course(steps, captures, TABLE, AMBIENT, roles, channels, by_hand, zeros)
        self.machine = SweepMachine(
            course,
            predict or (lambda level, plateaus: ALLOWED),
            trip or (lambda view, now_ns, pressurised: None),
            **more,
        )
        self.orders = []
        self.when = {}  # state to a function of the lab, called once

    def go(self, most_s=600.0):
        while not self.machine.ended and self.lab.now_ns < most_s * NS:
            self.lab.step()
            for order in self.machine.advance(self.lab.now_ns, self.lab):
                self.take(order)
        assert self.machine.ended, f"still in {self.machine.state} after {most_s} s"
        return self

    def take(self, order):
        self.orders.append(order)
        if isinstance(order, orders.SetPressure):
            self.lab.set_bar = max(order.bar_abs, AMBIENT)
        if isinstance(order, orders.Entered) and order.state in self.when:
            self.when.pop(order.state)(self.lab)

    def of(self, kind):
        return [order for order in self.orders if isinstance(order, kind)]

    @property
    def states(self):
        return [order.state for order in self.of(orders.Entered)]

    @property
    def finish(self):
        (finish,) = self.of(orders.Finish)
        return finish

    def assert_vented_last(self):
        assert self.of(orders.SetPressure)[-1].bar_abs == orders.VENTED
        assert self.orders[-1] is self.finish
        assert self.machine.advance(self.lab.now_ns, self.lab) == []


@pytest.fixture(scope="module")
def whole():
    return Walk().go()


class Slow(Lab):
    """A bench on which the flow meter's readings come in late, or from a moment on no more."""

    def __init__(self, late_s=0.0, until_s=float("inf")):
        super().__init__()
        self.late_s, self.until_s, self.waiting = late_s, until_s, []

    def read(self, role, name, value, scatter):
        super().read(role, name, value, scatter)
        if role == "flow":
            self.waiting.append(self.readings[role].pop())
            ready_ns = min(self.now_ns - self.late_s * NS, self.until_s * NS)
            while self.waiting and self.waiting[0].time_ns <= ready_ns:
                self.readings[role].append(self.waiting.pop(0))


def test_a_mean_waits_for_the_last_readings_of_its_span():
    walk = Walk(steps=[Step(1.3, "up", 1)], lab=Slow(late_s=0.4), zeros=()).go()
    (plateau,) = walk.machine.plateaus
    assert plateau.end_ns - plateau.start_ns == TABLE.dwell_s * NS
    assert plateau.means["flow"].n == plateau.means["speed"].n >= 40


def test_a_mean_does_not_wait_for_an_instrument_that_has_fallen_silent():
    walk = Walk(steps=[Step(1.3, "up", 1)], lab=Slow(until_s=0.5), zeros=()).go()
    (plateau,) = walk.machine.plateaus
    assert plateau.end_ns - plateau.start_ns == TABLE.dwell_s * NS
    assert plateau.means["flow"].n == 0
    assert plateau.means["speed"].n >= 40


@pytest.mark.parametrize("kind", ["coast-down", "spin-up"])
@pytest.mark.parametrize("role", ["pressure", "speed"])
def test_a_run_whose_capture_has_no_reading_fails_with_what_is_missing(kind, role):
    walk = Walk(steps=[], captures=[CaptureTask(kind, 1.6, 0.2)])
    take = walk.take

    def falls_silent(order):
        take(order)
        walk.lab.dead |= {role} if isinstance(order, orders.CaptureStart) else set()

    walk.take = falls_silent
    walk.go()
    (end,) = walk.of(orders.CaptureEnd)
    assert end.left_out.startswith(f"there is no reading of the {role}")
    assert walk.finish.outcome == "failed"
    assert walk.finish.reason.startswith(f"the {kind} cannot be used: there is no reading of the {role} (")
    assert "its last reading: timeout). What was read is kept; `spinbench doctor` examines" in walk.finish.reason
    walk.assert_vented_last()


@pytest.mark.parametrize("kind", ["coast-down", "spin-up"])
@pytest.mark.parametrize("shown_rpm", [0.0, 0.4])
def test_a_capture_in_which_the_tachometer_sees_no_rotor_turning_is_no_finished_run(kind, shown_rpm):
    """Its readings are usable, each by itself."""

    class Blind(Lab):
        def read(self, role, name, value, scatter):
            super().read(role, name, shown_rpm if role == "speed" else value, scatter if role != "speed" else 0.0)

    walk = Walk(steps=[], captures=[CaptureTask(kind, 1.6, 0.2)], lab=Blind()).go()
    assert len(walk.of(orders.CaptureEnd)) == 2  # it is taken once more
    said = f"the {kind} cannot be used: the speed (tach.speed_rpm) shows no turning rotor; look whether it turns"
    assert walk.finish.outcome == "failed" and walk.finish.reason.startswith(said)
    walk.assert_vented_last()


class Dying(Lab):
    """A bench whose tachometer shows a rotor at rest from some time on; its readings are usable, each by itself."""

    def __init__(self, after_s):
        super().__init__()
        self.after_s = after_s

    def read(self, role, name, value, scatter):
        super().read(role, name, 0.0 if role == "speed" and self.now_ns > self.after_s * NS else value, scatter)


def test_a_sweep_whose_latest_speeds_cannot_be_so_fails_there_and_keeps_what_it_has():
    def doubt(plateaus):
        return "the rotor stands" if plateaus[-1].means["speed"].mean == 0.0 else ""

    walk = Walk(lab=Dying(24.0), doubt=doubt).go()
    speeds = [plateau.means["speed"].mean for plateau in walk.machine.plateaus]
    assert len(speeds) < 6 and speeds[-1] == 0.0 and min(speeds[:-1]) > 10.0
    assert (walk.finish.outcome, walk.finish.reason) == ("failed", "the rotor stands")
    walk.assert_vented_last()


def test_the_last_plateau_is_doubted_too():
    walk = Walk(steps=[Step(1.3, "up", 1)], doubt=lambda plateaus: "the rotor stands").go()
    assert (walk.finish.outcome, walk.finish.reason) == ("failed", "the rotor stands")


def test_a_sweep_in_which_no_rotor_was_seen_turning_says_so_at_its_end():
    walk = Walk(steps=[Step(1.3, "up", 1)], lab=Dying(0.0)).go()
    assert walk.finish.outcome == "finished"
    assert walk.finish.reason.startswith("no plateau shows the rotor turning; look whether it turns")


def test_a_tachometer_that_shows_a_turning_rotor_when_the_line_is_vented_has_failed_the_run():
    class Hangs(Lab):
        def read(self, role, name, value, scatter):
            hangs = role == "speed" and self.readings[role] and self.now_ns > 10 * NS
            super().read(role, name, self.readings[role][-1].value if hangs else value, 0.0 if hangs else scatter)

    walk = Walk(steps=[Step(1.3, "up", 1)], lab=Hangs()).go()
    assert walk.machine.plateaus[0].means["speed"].mean > 10.0
    assert walk.finish.outcome == "failed"
    assert "rpm all the time, though the line is vented; its display hangs" in walk.finish.reason
    walk.assert_vented_last()


def test_a_sweep_whose_tachometer_dies_before_its_capture_has_failed():
    walk = Walk(steps=[Step(1.3, "up", 1)], captures=[CaptureTask("coast-down", 1.6, 0.2)])
    walk.lab = Dying(float("inf"))
    walk.when["capture"] = lambda lab: setattr(lab, "after_s", 0.0)
    walk.go()
    assert walk.finish.outcome == "failed"
    assert "the coast-down cannot be used: the speed (tach.speed_rpm) shows no turning rotor" in walk.finish.reason


def test_a_coast_down_whose_tachometer_falls_still_as_the_valve_is_shut_is_taken_once_more():
    class Slips(Lab):
        slips = False

        def read(self, role, name, value, scatter):
            super().read(role, name, 0.0 if role == "speed" and self.slips else value, scatter)

    walk = Walk(steps=[], captures=[CaptureTask("coast-down", 1.6, 0.2)], lab=Slips())
    take = walk.take

    def slips_once(order):
        if isinstance(order, orders.SetPressure) and len(walk.of(orders.CaptureStart)) == 1:
            walk.lab.slips = not walk.of(orders.CaptureEnd)
        take(order)

    walk.take = slips_once
    walk.go()
    first, second = walk.of(orders.CaptureEnd)
    assert "shows no turning rotor" in first.left_out and second.left_out == ""
    assert walk.finish.outcome == "finished"


def test_a_zero_alone_without_a_reading_of_the_gauge_fails():
    class Dies(Lab):
        def read(self, role, name, value, scatter):
            self.dead = {"pressure"} if self.now_ns > NS // 10 else set()
            super().read(role, name, value, scatter)
            made = self.readings[role][-1]
            self.readings[role][-1] = dataclasses.replace(made, time_ns=made.time_ns - NS // 100)

    walk = Walk(steps=[], lab=Dies(), zeros=("start",)).go()
    assert walk.finish.outcome == "failed"
    assert walk.finish.reason.startswith("the zero cannot be used: there is no reading of the pressure")


def test_a_spin_up_that_is_left_out_since_the_rotor_turns_is_no_finished_run():
    class Turns(Lab):
        turns = False

        def read(self, role, name, value, scatter):
            super().read(role, name, 30.0 if role == "speed" and self.turns else value, scatter)

    walk = Walk(steps=[], captures=[CaptureTask("spin-up", 1.6, 0.2)], lab=Turns())
    walk.when["capture"] = lambda lab: setattr(lab, "turns", True)
    walk.go()
    assert walk.finish.outcome == "failed"
    assert "the spin-up cannot be used: the rotor still turns" in walk.finish.reason


def test_a_sweep_goes_through_its_states_in_order(whole):
    one = ["ramp", "settle", "dwell", "next"]
    assert whole.states == ["zero", "next", *one * 6, "vent", "zero", "done"]


def test_a_whole_sweep_finishes_with_a_plateau_for_every_step(whole):
    assert whole.finish.outcome == "finished"
    assert [record.plateau.step for record in whole.of(orders.Record)] == plan(LEVELS, "up-down")
    assert all(record.plateau.settled for record in whole.of(orders.Record))
    whole.assert_vented_last()


def test_a_plateau_holds_what_the_bench_settled_at(whole):
    for record in whole.of(orders.Record):
        means, level = record.plateau.means, record.plateau.step.level_bar_abs
        assert means["pressure"].mean == pytest.approx(level, abs=0.002)
        assert means["speed"].mean == pytest.approx(412.0 * (level - 1.04), abs=1.0)
        assert means["speed"].n == pytest.approx(TABLE.dwell_s * 10.0, abs=2)
        assert 0.03 < means["speed"].se < 0.4


def test_the_pressure_is_ramped_no_faster_than_the_bench_file_says(whole):
    ramp = [order.bar_abs for order in whole.of(orders.SetPressure) if order.bar_abs != orders.VENTED]
    steps = np.abs(np.diff([AMBIENT, *ramp]))
    assert steps.max() <= TABLE.ramp_bar_s * 0.26
    assert max(ramp) == max(LEVELS)


def test_a_program_that_was_held_up_does_not_make_up_for_it_in_one_step():
    walk = Walk(steps=[Step(1.9, "up", 1)])
    walk.when["ramp"] = lambda lab: setattr(lab, "now_ns", lab.now_ns + 5 * NS)
    walk.go()
    ramp = [order.bar_abs for order in walk.of(orders.SetPressure) if order.bar_abs != orders.VENTED]
    assert ramp[0] <= AMBIENT + 0.5 * TABLE.ramp_bar_s + 1e-9


def test_the_zero_of_every_channel_is_taken_at_the_start_and_at_the_end(whole):
    start, end = whole.of(orders.Zero)
    assert (start.which, end.which) == ("start", "end")
    for zero in (start, end):
        assert zero.vented
        assert zero.means["gauge.pressure_bar_abs"].mean == pytest.approx(AMBIENT, abs=0.02)
        assert zero.means["tach.speed_rpm"].mean < 0.1
        assert zero.means["tach.speed_rpm"].censored == -1
        assert (zero.end_ns - zero.start_ns) / NS == pytest.approx(TABLE.zero_s, abs=0.1)


def test_the_start_zero_waits_until_the_line_has_vented():
    lab = Lab()
    lab.pressure, lab.speed = 1.6, 230.0
    walk = Walk(steps=[Step(1.3, "up", 1)], lab=lab).go()
    assert walk.of(orders.Zero)[0].start_ns > 0.5 * NS
    assert walk.finish.outcome == "finished"


def test_a_line_that_does_not_vent_fails_the_run_before_it_begins():
    lab = Lab()
    lab.offset_bar = 0.6
    walk = Walk(lab=lab).go()
    assert walk.finish.outcome == "failed"
    assert "does not vent" in walk.finish.reason
    assert not walk.finish.vented
    walk.assert_vented_last()


def test_a_dead_gauge_fails_the_run_before_it_begins():
    lab = Lab()
    lab.dead.add("pressure")
    walk = Walk(lab=lab).go()
    assert walk.finish.outcome == "failed"
    assert "gauge.pressure_bar_abs" in walk.finish.reason
    assert "timeout" in walk.finish.reason
    walk.assert_vented_last()


def test_a_speed_that_never_settles_is_recorded_as_such_after_the_time_out():
    lab = Lab()
    lab.drift_rpm_s = 5.0
    walk = Walk(steps=[Step(1.6, "up", 1)], lab=lab).go()
    (record,) = walk.of(orders.Record)
    assert not record.plateau.settled
    assert "not settled after 20 s: speed: changes by" in record.plateau.note
    assert any(say.warning and "not settled" in say.text for say in walk.of(orders.Say))
    lost = "1 of 1 plateaus cannot be used: it had not settled, or pressure or speed was not read"
    assert walk.finish.outcome == "finished"
    assert walk.finish.reason.startswith(lost)
    assert orders.Say(lost, warning=True) in walk.of(orders.Say)


def test_a_gauge_that_is_off_the_level_is_noted_on_the_plateau():
    walk = Walk(steps=[Step(1.6, "up", 1)])
    walk.when["ramp"] = lambda lab: setattr(lab, "offset_bar", -0.1)
    assert "where 1.6 was asked for" in walk.go().of(orders.Record)[0].plateau.note


def test_a_level_at_which_the_rotor_stands_is_a_plateau_too():
    walk = Walk(steps=[Step(1.03, "up", 1)]).go()
    (record,) = walk.of(orders.Record)
    assert record.plateau.settled
    assert record.plateau.means["speed"].cell == 0.0
    assert record.plateau.means["speed"].censored == -1


def test_a_level_of_a_falling_leg_is_approached_from_above():
    walk = Walk(steps=[Step(1.3, "down", 1, by_way_of_bar_abs=1.9)]).go()
    ramp = [order.bar_abs for order in walk.of(orders.SetPressure) if order.bar_abs != orders.VENTED]
    assert max(ramp) == 1.9
    assert ramp[-1] == 1.3
    assert len(walk.of(orders.Record)) == 1


# The guard.


def test_the_guard_is_asked_before_each_step_with_the_plateaus_so_far():
    asked = []
    Walk(predict=lambda level, plateaus: asked.append((level, len(plateaus))) or ALLOWED).go()
    assert asked == [(1.3, 0), (1.6, 1), (1.9, 2), (1.9, 3), (1.6, 4), (1.3, 5)]


def test_the_guard_is_asked_with_the_plateaus_of_the_run_that_is_continued():
    walk = Walk(steps=plan([1.3, 1.6], "up"))
    earlier = Walk(steps=plan([1.4], "up")).go().of(orders.Record)[0].plateau
    asked = []
    course = dataclasses.replace(walk.machine.course, known=(earlier,))
    walk.machine = SweepMachine(
        course, lambda level, p: asked.append((level, p[0], len(p))) or ALLOWED, lambda *_: None
    )
    walk.go()
    assert asked == [(1.3, earlier, 1), (1.6, earlier, 2)]
    assert [record.plateau.number for record in walk.of(orders.Record)] == [1, 2]


def test_a_level_that_the_guard_refuses_is_left_out_with_all_above_it():
    def predict(level, plateaus):
        return SimpleNamespace(allowed=level < 1.5, text="99 % below 700 rpm", highest_pa_abs=1.3e5)

    walk = Walk(predict=predict, captures=[CaptureTask("coast-down", 1.9, 0.2)]).go()
    (refused,) = walk.of(orders.Refused)
    assert (refused.level_bar_abs, refused.text) == (1.6, "99 % below 700 rpm")
    assert [step.level_bar_abs for step in refused.left_out] == [1.6, 1.9, 1.9, 1.6]
    assert [r.plateau.step.level_bar_abs for r in walk.of(orders.Record)] == [1.3, 1.3]
    assert max(order.bar_abs for order in walk.of(orders.SetPressure)) == 1.3
    assert not walk.of(orders.CaptureStart)
    assert walk.finish.outcome == "finished"


def test_a_detour_above_a_level_is_not_made_when_the_guard_refuses_it():
    def predict(level, plateaus):
        return SimpleNamespace(allowed=level < 1.5, text="too fast", highest_pa_abs=1.3e5)

    walk = Walk(steps=[Step(1.3, "down", 1, by_way_of_bar_abs=1.9)], predict=predict).go()
    assert max(order.bar_abs for order in walk.of(orders.SetPressure)) == 1.3


def test_a_run_of_which_everything_was_refused_has_failed():
    """Plateaus on the way to a level do not make a run of what was asked for."""
    refusing = SimpleNamespace(allowed=False, text="the rotor stands at 1.5 bar abs", highest_pa_abs=1.5e5)
    walk = Walk(
        [], [CaptureTask("coast-down", 1.9, 0.2)], predict=lambda level, _: ALLOWED if level < 1.55 else refusing
    ).go()
    assert walk.machine.plateaus
    assert (walk.finish.outcome, walk.finish.reason) == ("failed", refusing.text)
    walk.assert_vented_last()


def test_a_capture_refused_for_want_of_readings_names_the_instrument_that_fell_silent():
    refusing = SimpleNamespace(allowed=False, text="a plateau there narrows the prediction", highest_pa_abs=1.5e5)
    walk = Walk(
        [], [CaptureTask("coast-down", 1.9, 0.2)], predict=lambda level, _: ALLOWED if level < 1.55 else refusing
    )
    walk.when["settle"] = lambda lab: lab.dead.add("pressure")
    walk.go()
    assert [plateau.step.level_bar_abs for plateau in walk.machine.plateaus] == [1.5]
    assert walk.finish.outcome == "failed"
    silent = "gauge.pressure_bar_abs; its last reading: timeout"
    assert walk.finish.reason == f"no plateau can be used: there is no reading of the pressure ({silent})"


def test_a_gauge_that_was_only_not_read_in_time_is_not_told_by_the_quality_of_another_reading():
    lab = Lab()
    for _ in range(20):
        lab.step()
    told = judge.not_read(lab, lab.now_ns + 1, lab.now_ns + round(0.7 * NS))
    span = "(gauge.pressure_bar_abs) in these 0.7 s, though it is read at other times"
    assert told == f"there is no reading of the pressure {span}"


def test_a_plateau_below_a_refused_level_comes_first_where_it_lets_the_guard_see_farther():
    def predict(level, plateaus):
        highest = 1.5 if len(plateaus) == 1 else 2.0  # the first plateau does not tell enough
        return SimpleNamespace(allowed=level <= highest, text="99 % below 700 rpm", highest_pa_abs=highest * 1e5)

    walk = Walk(steps=plan([1.3, 1.6], "up"), predict=predict).go()
    taken = [record.plateau for record in walk.of(orders.Record)]
    assert [plateau.step.level_bar_abs for plateau in taken] == [1.3, 1.5, 1.6]
    assert "guard" in taken[1].note
    assert not walk.of(orders.Refused)


def test_the_guard_is_not_followed_in_steps_that_teach_it_nothing():
    def predict(level, plateaus):
        return SimpleNamespace(allowed=level <= 1.5, text="99 % below 700 rpm", highest_pa_abs=1.5e5)

    walk = Walk(steps=plan([1.3, 1.6], "up"), predict=predict).go()
    assert [record.plateau.step.level_bar_abs for record in walk.of(orders.Record)] == [1.3, 1.5]
    assert len(walk.of(orders.Refused)) == 1


# Ways out.

STATES = ["zero", "next", "ramp", "settle", "dwell", "capture"]
CAPTURES = [CaptureTask("coast-down", 1.6, 0.2)]


@pytest.mark.parametrize("state", STATES)
def test_the_operator_s_stop_vents_first_from_every_state(state):
    walk = Walk(steps=[Step(1.6, "up", 1)], captures=CAPTURES)
    walk.when[state] = lambda lab: setattr(lab, "stops", 1)
    walk.go()
    assert (walk.finish.outcome, walk.finish.reason) == ("aborted", "stopped by the operator")
    assert walk.finish.stopped_by == "operator"
    assert walk.finish.vented
    after = walk.states.index("vent")
    assert walk.states[after:] == ["vent", "aborted"]
    walk.assert_vented_last()


@pytest.mark.parametrize("state", STATES)
def test_a_trip_vents_first_from_every_state_and_its_reason_is_kept(state):
    lab = Lab()
    tripped = []
    walk = Walk(
        steps=[Step(1.6, "up", 1)],
        captures=CAPTURES,
        lab=lab,
        trip=lambda view, now_ns, pressurised: "speed signal lost" if tripped else None,
    )
    walk.when[state] = lambda lab: tripped.append(True)
    walk.go()
    assert (walk.finish.outcome, walk.finish.reason) == ("aborted", "speed signal lost")
    assert walk.finish.stopped_by == "interlock"
    vent = walk.states.index("vent")
    assert walk.states[vent - 1] in (state, "settle")
    walk.assert_vented_last()


@pytest.mark.parametrize("state", STATES)
def test_a_regulator_that_does_not_take_a_set_point_fails_the_run(state):
    walk = Walk(steps=[Step(1.6, "up", 1)], captures=CAPTURES)
    failed = []
    walk.when[state] = lambda lab: failed.extend(walk.machine.fail(lab.now_ns, "dac: no answer"))
    walk.go()
    assert isinstance(failed[0], orders.SetPressure)
    assert failed[0].bar_abs == orders.VENTED
    assert (walk.finish.outcome, walk.finish.reason) == ("failed", "dac: no answer")
    walk.assert_vented_last()


def test_the_order_to_vent_is_repeated_until_the_gauge_says_so_or_time_is_up():
    walk = Walk(steps=[Step(1.6, "up", 1)])
    walk.when["dwell"] = lambda lab: (setattr(lab, "stops", 1), setattr(lab, "tau_pressure_s", 1e9))
    walk.go()
    since = next(i for i, o in enumerate(walk.orders) if isinstance(o, orders.Entered) and o.state == "vent")
    repeated = [o for o in walk.orders[since:] if isinstance(o, orders.SetPressure)]
    assert len(repeated) >= 10
    assert not walk.finish.vented
    assert any("close the supply" in say.text for say in walk.of(orders.Say))
    walk.assert_vented_last()


def test_a_second_stop_ends_at_once_even_where_the_line_does_not_vent():
    walk = Walk(steps=[Step(1.6, "up", 1)])
    walk.when["dwell"] = lambda lab: (setattr(lab, "stops", 1), setattr(lab, "tau_pressure_s", 1e9))
    walk.when["vent"] = lambda lab: setattr(lab, "stops", 2)
    walk.go()
    assert walk.finish.outcome == "aborted"
    assert not walk.finish.vented
    walk.assert_vented_last()


def test_the_first_reason_to_end_is_the_one_that_is_kept():
    walk = Walk(steps=[Step(1.6, "up", 1)])
    walk.when["dwell"] = lambda lab: setattr(lab, "stops", 1)
    walk.when["vent"] = lambda lab: walk.machine.fail(lab.now_ns, "dac: no answer")
    assert walk.go().finish.outcome == "aborted"


def test_the_limits_are_told_whether_there_may_be_pressure():
    seen = {}

    def trip(view, now_ns, pressurised):
        seen.setdefault(walk.machine.state.value, set()).add(pressurised)

    walk = Walk(steps=[Step(1.6, "up", 1)], trip=trip)
    walk.go()
    assert seen["settle"] == seen["dwell"] == {True}
    assert seen["zero"] == seen["vent"] == {False}


# Captures.


def test_a_coast_down_is_settled_first_then_vented_while_it_is_recorded():
    walk = Walk(steps=[], captures=CAPTURES).go()
    assert walk.states == ["zero", "next", "ramp", "settle", "capture", "next", "vent", "zero", "done"]
    start = next(i for i, o in enumerate(walk.orders) if isinstance(o, orders.CaptureStart))
    during = walk.orders[start + 1 :]
    assert isinstance(during[0], orders.SetPressure)
    assert during[0].bar_abs == orders.VENTED
    assert isinstance(during[1], orders.CaptureEnd)
    assert during[1].event_ns - during[1].start_ns == pytest.approx(0.5 * NS, abs=0.1 * NS)
    assert during[1].end_ns - during[1].event_ns == pytest.approx(2.0 * NS, abs=0.1 * NS)


def test_a_spin_up_starts_from_rest_and_sets_the_pressure_in_one_step():
    walk = Walk(steps=[Step(1.9, "up", 1)], captures=[CaptureTask("spin-up", 1.6, 0.2)]).go()
    start = next(i for i, o in enumerate(walk.orders) if isinstance(o, orders.CaptureStart))
    during = [o for o in walk.orders[start:] if isinstance(o, orders.SetPressure | orders.CaptureEnd)]
    assert during[0].bar_abs == 1.6
    assert during[1].bar_abs == orders.VENTED
    before = [r.value for r in walk.lab.readings["speed"] if 0 <= during[2].event_ns - r.time_ns <= 0.2 * NS]
    assert before == [0.0] * len(before) != []
    assert walk.finish.outcome == "finished"


def test_a_capture_that_is_stopped_is_closed_in_the_log():
    walk = Walk(steps=[], captures=CAPTURES)
    while not walk.of(orders.CaptureStart):
        walk.lab.step()
        for order in walk.machine.advance(walk.lab.now_ns, walk.lab):
            walk.take(order)
    walk.lab.stops = 1
    walk.go()
    assert len(walk.of(orders.CaptureEnd)) == 1
    walk.assert_vented_last()


def test_a_zero_capture_is_a_zero_and_nothing_else():
    walk = Walk(steps=[], zeros=("start",)).go()
    assert walk.states == ["zero", "done"]
    assert [zero.which for zero in walk.of(orders.Zero)] == ["start"]


# A person at the valve.


class Hand(Walk):
    """A walk whose person does what is asked after a second and then answers."""

    def __init__(self, **more):
        super().__init__(by_hand=True, **more)
        self.lab.tau_pressure_s = 0.2
        self.answer_ns = None

    def take(self, order):
        if isinstance(order, orders.SetPressure):
            self.orders.append(order)
            return
        super().take(order)
        if isinstance(order, orders.Ask):
            self.lab.answer = None
            self.answer_ns = self.lab.now_ns + NS
            self.asked = order.text

    def go(self, most_s=600.0):
        while not self.machine.ended and self.lab.now_ns < most_s * NS:
            self.lab.step()
            if self.answer_ns is not None and self.lab.now_ns > self.answer_ns:
                self.answer_ns = None
                self.lab.answer = ""
                closing = "lose the valve" in self.asked or "Shut" in self.asked
                self.lab.set_bar = AMBIENT if closing else float(self.asked.split()[1])
            for order in self.machine.advance(self.lab.now_ns, self.lab):
                self.take(order)
        assert self.machine.ended
        return self


def test_a_person_at_the_valve_is_asked_for_each_level_and_from_which_side():
    walk = Hand().go()
    asked = [ask.text for ask in walk.of(orders.Ask)]
    assert asked[1] == "Set 1.300 bar absolute (0.287 bar gauge), from below, then press Enter"
    assert "1.600 bar absolute (0.587 bar gauge), from above" in asked[-3]
    assert "Close the valve" in asked[0]
    assert "Close the valve" in asked[-1]
    assert len(walk.of(orders.Record)) == 6
    assert walk.finish.outcome == "finished"


def test_a_hand_valve_counts_as_open_until_the_person_says_that_it_is_closed():
    walk = Hand(steps=[Step(1.6, "up", 1)])
    walk.when["dwell"] = lambda lab: setattr(lab, "stops", 1)
    walk.go()
    vented_after = next(r.time_ns for r in walk.lab.readings["pressure"] if r.time_ns > 0)
    assert walk.finish.outcome == "aborted"
    assert walk.finish.vented
    assert vented_after < walk.lab.now_ns
    assert "Close the valve" in walk.of(orders.Ask)[-1].text


def test_a_second_stop_ends_a_hand_run_that_nobody_answers_as_unvented():
    walk = Hand(steps=[Step(1.6, "up", 1)])
    walk.when["dwell"] = lambda lab: setattr(lab, "stops", 1)
    walk.when["vent"] = lambda lab: setattr(lab, "stops", 2)
    walk.go()
    assert not walk.finish.vented


@pytest.mark.parametrize(("rpm", "censored", "rests"), [(10.0, -1, True), (-500.0, -1, False)])
def test_a_typed_speed_below_the_scale_is_rest_where_the_scale_begins_above_zero(rpm, censored, rests):
    typed = {
        "pressure": Reading("dial", "pressure_bar_abs", 1.0, "bar", Quality.MANUAL, 0, 0, 0),
        "speed": Reading("tach", "speed_rpm", rpm, "rpm", Quality.MANUAL, 0, 0, 0, censored=censored),
    }
    told = judge.not_at_rest(SimpleNamespace(last=typed.get), 1.0)
    assert told == ("" if rests else "the rotor still turns, at -500 rpm")
