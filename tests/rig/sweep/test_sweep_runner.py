"""The runner: set-points in the regulator's unit, everything into the log, and no pressure on every way out."""

from types import SimpleNamespace

import pytest

from rig.interlock.limits import Limits
from rig.interlock.step import Verdict
from rig.plateaus.plan import Step, SweepError
from rig.plateaus.plateau import Mean, Plateau
from rig.runlog import plateaus as table
from rig.sweep.ambient import at_start
from rig.sweep.hooks import guarded, points_of
from rig.sweep.planning import capture_course, sweep_course
from rig.sweep.runner import Runner, set_points
from tests.sweep_hooks import hooks
from tests.sweep_lab import AMBIENT, LabAcquisition, LabBench


def run(acquisition, **given):
    bench = acquisition.bench
    course, _ = sweep_course(bench, at_start(bench, GIVEN))
    return Runner(acquisition, acquisition, bench, course, hooks(**given)).run()


GIVEN = SimpleNamespace(
    pressure_bar_abs=None, temperature_c=None, relative_humidity=None, lubrication=None, minutes_running=0.0
)


@pytest.fixture(scope="module")
def whole():
    acquisition = LabAcquisition(LabBench())
    heard = []
    outcome = run(acquisition, on_plateau=heard.append)
    return SimpleNamespace(acquisition=acquisition, outcome=outcome, heard=heard)


def test_a_whole_sweep_is_finished_and_vented(whole):
    assert (whole.outcome.outcome, whole.outcome.vented) == ("finished", True)
    assert [plateau.step.level_bar_abs for plateau in whole.outcome.plateaus] == [1.3, 1.6]


def test_set_points_are_written_in_the_regulator_s_unit(whole):
    assert max(whole.acquisition.writes) == pytest.approx(1.6 - AMBIENT)


def test_the_last_set_point_is_zero(whole):
    assert whole.acquisition.writes[-1] == 0.0


def test_each_plateau_goes_to_the_log_as_a_row_that_the_run_s_table_takes(whole):
    assert [row["n"] for row in whole.acquisition.plateaus] == [1, 2]
    for row in whole.acquisition.plateaus:
        assert table.line(row)
        assert row["speed_rpm"] == pytest.approx(412.0 * (row["level_bar_abs"] - 1.04), abs=1.0)
        assert row["flow_l_min_n"] > 30


def test_each_plateau_is_shown_to_who_listens(whole):
    assert whole.heard == whole.outcome.plateaus


def test_the_states_and_the_zeros_are_in_the_log(whole):
    kinds = [kind for kind, _ in whole.acquisition.events]
    states = [details["state"] for kind, details in whole.acquisition.events if kind == "state"]
    assert states[:3] == ["zero", "next", "ramp"]
    assert states[-1] == "done"
    zeros = [details for kind, details in whole.acquisition.events if kind == "zero"]
    assert [zero["which"] for zero in zeros] == ["start", "end"]
    assert set(zeros[0]["channels"]) == {"gauge.pressure_bar_abs", "tach.speed_rpm", "meter.flow_l_min"}
    assert zeros[0]["start_s"] < zeros[0]["end_s"]
    assert kinds.count("plateau") == 2


def test_the_progress_counts_plateaus():
    told = []
    progress = SimpleNamespace(
        say=lambda text, warning=False: None, advance=lambda done, total, text: told.append((done, total))
    )
    run(LabAcquisition(LabBench()), progress=progress)
    assert told[0] == (0, 2)
    assert told[-1] == (2, 2)


def test_the_progress_of_a_zero_counts_the_zero():
    told = []
    progress = SimpleNamespace(
        say=lambda text, warning=False: None, advance=lambda done, total, text: told.append((done, total))
    )
    acquisition = LabAcquisition(LabBench())
    bench = acquisition.bench
    course = capture_course(bench, at_start(bench, GIVEN), "zero")
    Runner(acquisition, acquisition, bench, course, hooks(progress=progress)).run()
    assert told[0] == (0, 1)
    assert told[-1] == (1, 1)


@pytest.mark.parametrize("state", ["zero", "ramp", "settle", "dwell", "next"])
def test_a_regulator_that_dies_fails_the_run_and_is_tried_again_to_the_end(state):
    acquisition = LabAcquisition(LabBench())
    acquisition.before[state] = lambda a: setattr(a, "dead_regulator", True)
    said = []
    progress = SimpleNamespace(
        say=lambda text, warning=False: said.append(text), advance=lambda done, total, text: None
    )
    outcome = run(acquisition, progress=progress)
    assert outcome.outcome == "failed"
    assert "nothing within 0.3 s" in outcome.reason
    assert not outcome.vented
    assert acquisition.writes[-3:] == [0.0] * 3
    assert any("close the supply" in text for text in said)


def test_a_set_point_that_was_not_taken_is_ordered_once_more():
    acquisition = LabAcquisition(LabBench())
    acquisition.before["dwell"] = lambda a: setattr(a, "dead_regulator", True)
    acquisition.before["set-point not taken"] = lambda a: setattr(a, "dead_regulator", False)
    outcome = run(acquisition)
    assert (outcome.outcome, outcome.vented) == ("finished", True)
    assert "set-point not taken" in [kind for kind, _ in acquisition.events]


def test_a_regulator_that_comes_back_is_vented():
    acquisition = LabAcquisition(LabBench())

    def refuse_once_more(a):
        a.before["set-point not taken"] = lambda a: setattr(a, "dead_regulator", False)

    acquisition.before["dwell"] = lambda a: setattr(a, "dead_regulator", True)
    acquisition.before["set-point not taken"] = refuse_once_more
    outcome = run(acquisition)
    assert (outcome.outcome, outcome.vented) == ("failed", True)


def test_a_lost_speed_signal_aborts_with_its_name():
    acquisition = LabAcquisition(LabBench())
    limits = Limits(acquisition.bench.file.safety, acquisition.bench.file.roles, AMBIENT)
    acquisition.before["dwell"] = lambda a: a.lab.dead.add("speed")
    outcome = run(acquisition, trip=limits.trip)
    assert outcome.outcome == "aborted"
    assert "speed signal lost" in outcome.reason
    assert "tach.speed_rpm" in outcome.reason
    assert outcome.vented
    assert acquisition.writes[-1] == 0.0


def test_an_operator_s_stop_aborts_and_keeps_the_plateaus():
    acquisition = LabAcquisition(LabBench())
    stops = []
    outcome = run(acquisition, stops=lambda: len(stops), on_plateau=stops.append)
    assert (outcome.outcome, outcome.reason) == ("aborted", "stopped by the operator")
    assert len(outcome.plateaus) == 1
    assert acquisition.writes[-1] == 0.0


def test_what_is_nobody_s_fault_but_ours_is_raised_with_the_regulator_at_zero():
    acquisition = LabAcquisition(LabBench())

    def broken(plateau):
        raise ZeroDivisionError("a mistake of ours")

    with pytest.raises(ZeroDivisionError):
        run(acquisition, on_plateau=broken)
    assert acquisition.writes[-1] == 0.0


def test_a_keyboard_interrupt_leaves_the_regulator_at_zero():
    acquisition = LabAcquisition(LabBench())

    def interrupted(plateau):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(acquisition, on_plateau=interrupted)
    assert acquisition.writes[-1] == 0.0


def test_a_refused_level_is_in_the_log_with_all_that_are_left_out():
    acquisition = LabAcquisition(LabBench())
    outcome = run(acquisition, predict=lambda level, p: Verdict(level < 1.5, "too fast", 1.3e5))
    assert outcome.left_out == [Step(1.6, "up", 1)]
    (refused,) = [details for kind, details in acquisition.events if kind == "level refused"]
    assert refused == {"level_bar_abs": 1.6, "text": "too fast", "left_out": [[1.6, "up", 1]]}


def test_teeth_are_read_while_a_capture_is_made():
    bench = LabBench(teeth=60, captures=["coast-down"], capture_level_bar_abs=2.0, levels_bar_abs=[1.6])
    acquisition = LabAcquisition(bench)
    outcome = run(acquisition)
    assert outcome.outcome == "finished", outcome.reason
    kinds = [kind for kind, _ in acquisition.events]
    assert kinds.index("capture start") < kinds.index("capture end")
    read = [i for i, command in enumerate(acquisition.commands) if command[1] == "capture"]
    assert len(read) > 20
    assert ("dac", "write", 0.0) in acquisition.commands[read[0] : read[-1]]
    (end,) = [details for kind, details in acquisition.events if kind == "capture end"]
    assert end["start_s"] < end["event_s"] < end["end_s"]


@pytest.mark.parametrize("kind", ["coast-down", "spin-up"])
def test_a_capture_counts_from_when_the_valve_was_told_on_a_busy_line_too(kind):
    bench = LabBench(teeth=60, captures=[kind], capture_level_bar_abs=2.0, levels_bar_abs=[1.6])
    acquisition = LabAcquisition(bench)
    acquisition.before["capture start"] = lambda busy: setattr(busy, "busy_s", 3.0)
    assert run(acquisition).outcome == "finished"
    (end,) = [details for what, details in acquisition.events if what == "capture end"]
    assert end["event_s"] - end["start_s"] == pytest.approx(3.5, abs=0.2)
    assert end["end_s"] - end["event_s"] >= 2.0


@pytest.mark.parametrize("kind", ["coast-down", "spin-up"])
def test_a_capture_whose_valve_may_have_moved_at_either_of_two_orders_is_taken_once_more(kind):
    bench = LabBench(teeth=60, captures=[kind], capture_level_bar_abs=2.0, levels_bar_abs=[1.6])
    acquisition = LabAcquisition(bench)
    acquisition.before["capture start"] = lambda unheard: setattr(unheard, "unheard", 1)
    assert run(acquisition).outcome == "finished"
    first, second = [details for what, details in acquisition.events if what == "capture end"]
    assert "not known when the pressure began to change" in first["left_out"]
    assert "left_out" not in second and second["capture"] == kind
    assert second["event_s"] - second["start_s"] == pytest.approx(0.5, abs=0.2)


def test_a_valve_has_moved_half_way_from_its_order_to_a_late_answer():
    acquisition = capturing()
    acquisition.before["capture start"] = lambda slow: setattr(slow, "answer_s", 0.3)
    assert run(acquisition).outcome == "finished"
    (end,) = [details for what, details in acquisition.events if what == "capture end"]
    ordered = next(t for t, value in acquisition.orders if value == 0.0 and t >= end["start_s"])
    assert end["event_s"] - ordered == pytest.approx(0.15, abs=0.01)


def test_a_capture_whose_valve_answered_too_late_is_taken_once_more():
    acquisition = capturing()
    acquisition.before["capture start"] = lambda slow: setattr(slow, "answer_s", 0.6)
    acquisition.before["capture end"] = lambda quick: setattr(quick, "answer_s", 0.0)
    assert run(acquisition).outcome == "finished"
    first, second = [details for what, details in acquisition.events if what == "capture end"]
    assert first["left_out"].startswith("the regulator answered 0.6 s after it was told its set-point")
    assert "left_out" not in second


def test_a_capture_alone_that_is_lost_twice_is_a_run_that_failed():
    acquisition = capturing("spin-up")
    bench = acquisition.bench

    def unheard(acquisition):
        acquisition.unheard = 1
        acquisition.before["capture end"] = lambda lost: lost.before.update({"capture start": unheard})

    acquisition.before["capture start"] = unheard
    course = capture_course(bench, at_start(bench, GIVEN), "spin-up", 2.0)
    outcome = Runner(acquisition, acquisition, bench, course, hooks()).run()
    assert outcome.outcome == "failed" and "not known when the pressure began to change" in outcome.reason


class Heard:
    def __init__(self):
        self.said = []

    def say(self, text, warning=False):
        self.said.append((text, warning))

    def advance(self, done, total, text):
        pass


def capturing(kind="coast-down", **lab):
    bench = LabBench(teeth=60, captures=[kind], capture_level_bar_abs=2.0, levels_bar_abs=[1.6])
    acquisition = LabAcquisition(bench)
    for name, value in lab.items():
        setattr(acquisition.lab, name, value)
    return acquisition


def test_the_gauge_is_hurried_from_the_start_of_a_capture_to_its_end_and_the_rate_is_told():
    acquisition, heard = capturing(), Heard()
    run(acquisition, progress=heard)
    asked = [command for command in acquisition.commands if command[1] in ("hurry", "relax", "capture")]
    assert asked[0] == ("gauge", "hurry", None)
    last_tooth = max(i for i, command in enumerate(asked) if command[1] == "capture")
    assert ("gauge", "relax", None) in asked[last_tooth:]
    (end,) = [details for kind, details in acquisition.events if kind == "capture end"]
    assert end["pressure_hz"] == pytest.approx(10.0, rel=0.1)
    assert any("the pressure was read" in text and "times a second" in text for text, _ in heard.said)


def test_a_gauge_is_at_its_own_period_again_whatever_ends_the_run():
    acquisition = capturing()
    acquisition.before["capture start"] = lambda a: setattr(a.lab, "stops", 1)
    stops = lambda: acquisition.lab.stops  # noqa: E731
    assert run(acquisition, stops=stops).outcome == "aborted"
    assert [c for c in acquisition.commands if c[1] in ("hurry", "relax")][-1] == ("gauge", "relax", None)
    (end,) = [details for kind, details in acquisition.events if kind == "capture end"]
    assert end["cut_short"] is True


def test_a_coast_down_lasts_until_the_line_is_vented():
    acquisition = capturing(tau_pressure_s=1.5)
    assert run(acquisition).outcome == "finished"
    (end,) = [details for kind, details in acquisition.events if kind == "capture end"]
    assert 1.5 * 2.5 < end["end_s"] - end["event_s"] < 1.5 * 6.0
    pressure = acquisition.between("pressure", round(end["event_s"] * 1e9), round(end["end_s"] * 1e9)).value
    assert pressure[-1] - AMBIENT < 0.06
    assert "cut_short" not in end


def test_a_coast_down_from_a_line_that_does_not_vent_ends_with_a_warning():
    acquisition, heard = capturing(), Heard()
    acquisition.before["capture start"] = lambda a: setattr(a.lab, "offset_bar", 0.3)
    run(acquisition, progress=heard)
    (end,) = [details for kind, details in acquisition.events if kind == "capture end"]
    assert end["end_s"] - end["event_s"] == pytest.approx(30.0, abs=0.5)
    (words,) = [text for text, warning in heard.said if warning and text.startswith("the coast-down ends")]
    assert "the gauge shows 1.3" in words


def test_a_capture_that_the_bench_cannot_resolve_is_left_out_with_the_reason():
    bench = LabBench(captures=["coast-down"], levels_bar_abs=[1.6])
    course, remarks = sweep_course(bench, at_start(bench, GIVEN))
    assert course.captures == []
    assert "samples would fall in it" in remarks[0]


@pytest.mark.parametrize(
    ("unit", "bar_abs", "expected"),
    [("bar gauge", 2.0, 2.0 - AMBIENT), ("bar abs", 2.0, 2.0), ("bar gauge", 0.0, 0.0), ("bar gauge", 9.0, 5.0)],
)
def test_absolute_pressures_become_set_points(unit, bar_abs, expected):
    assert set_points(LabBench(unit=unit), AMBIENT)(bar_abs) == pytest.approx(expected)


def test_a_regulator_in_another_unit_is_refused():
    with pytest.raises(SweepError, match="psi"):
        set_points(LabBench(unit="psi"), AMBIENT)


@pytest.mark.parametrize(("levels", "says"), [([3.5], "highest_pressure_bar_abs"), ([0.6], "not gauge")])
def test_levels_beyond_the_bench_are_refused(levels, says):
    bench = LabBench(levels_bar_abs=levels)
    with pytest.raises(SweepError, match=says):
        sweep_course(bench, at_start(bench, GIVEN))


def test_a_parent_that_took_everything_leaves_nothing_to_continue():
    bench = LabBench()
    with pytest.raises(SweepError, match="nothing left"):
        sweep_course(bench, at_start(bench, GIVEN), [Step(1.3, "up", 1), Step(1.6, "up", 1)])


# What the guard is told.


def plateau_of(pressure, speed):
    return Plateau(1, Step(1.6, "up", 1), 0, 1, True, {"pressure": pressure, "speed": speed})


def test_the_guard_gets_absolute_pressures_and_the_errors_of_the_means():
    plateau = plateau_of(Mean(0.6, 0.001, 30), Mean(230.0, 0.3, 30))
    (point,) = points_of([plateau], AMBIENT)
    assert point.pressure_pa == pytest.approx((0.6 + AMBIENT) * 1e5)
    assert point.speed_rad_s == pytest.approx(24.0855, abs=1e-3)
    assert point.pressure_sd == pytest.approx(100.0, abs=1.0)


def test_a_rotor_at_rest_tells_the_guard_something_and_a_speed_off_the_scale_nothing():
    rest = plateau_of(Mean(1.1, 0.001, 30), Mean(0.0, None, 30, censored=-1))
    off = plateau_of(Mean(1.6, 0.001, 30), Mean(500.0, None, 30, censored=1))
    assert [point.speed_rad_s for point in points_of([rest, off], 0.0)] == [0.0]


def test_the_guard_is_asked_in_pascals():
    asked = []
    guard = SimpleNamespace(verdict=lambda level, points: asked.append((level, len(points))))
    guarded(guard, AMBIENT, is_gauge=True)(1.6, [])
    assert asked == [(pytest.approx(1.6e5), 0)]


@pytest.mark.parametrize(("levels", "is_told"), [([1, 25, 1, 40], True), ([1.0, 1.4], False), ([2, 9], True)])
def test_levels_that_a_decimal_comma_may_have_parted_are_refused_with_that(levels, is_told):
    bench = LabBench(levels_bar_abs=levels)
    with pytest.raises(SweepError) as told:
        sweep_course(bench, at_start(bench, GIVEN))
    assert ("written with a comma? A comma parts two levels: write a point" in str(told.value)) == is_told
