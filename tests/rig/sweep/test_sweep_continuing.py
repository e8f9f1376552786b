"""A sweep that goes on where another was broken off: what that one, and its own parents, have taken."""

import dataclasses

import pytest

from rig.bench.bench import read_bench
from rig.interlock.guard import Guard
from rig.plateaus.plan import SweepError
from rig.runlog import RunError, RunWriter, read_run
from rig.sweep.ambient import Given, at_start
from rig.sweep.capture import motor_of
from rig.sweep.continuing import taken
from rig.sweep.hooks import guarded
from rig.sweep.planning import sweep_course
from tests.synthetic_runs import SWEEP as SYNTHETIC_LEVELS
from tests.synthetic_runs import Bench, start_of, write_sweep

BENCH = read_bench("virtual")
SWEEP = BENCH.file.sweep.model_dump()


def run_of(folder, **changes):
    options = {"bench": "virtual", "sweep": SWEEP} | changes
    return read_run(write_sweep(folder, seal=True, wire=False, captures=False, **options))


def test_what_a_run_has_taken_is_left_out(tmp_path):
    run = run_of(tmp_path)
    have = taken(run, BENCH, tmp_path)
    assert len(have.steps) == len([plateau for plateau in run.plateaus if plateau.settled]) > 0
    assert have.captures == frozenset()


def test_the_parents_of_the_parent_count_too(tmp_path):
    first = run_of(tmp_path)
    second = run_of(tmp_path, parent=first.name)
    assert len(taken(second, BENCH, tmp_path).steps) == 2 * len(taken(first, BENCH, tmp_path).steps)


def test_a_parent_is_found_by_its_whole_name(tmp_path):
    """Others begin with it: those that were begun in the same second, or a copy."""
    first = run_of(tmp_path)
    second = run_of(tmp_path, parent=first.name)
    first.folder.rename(tmp_path / f"{first.name}-copy")
    with pytest.raises(RunError, match=f"{second.name} goes on from '{first.name}', which is not in .*; put it there"):
        taken(second, BENCH, tmp_path)


@pytest.mark.parametrize(("outcome", "fewer"), [("failed", 2), ("aborted", 0)])
def test_plateaus_at_which_a_tachometer_had_died_are_taken_again(tmp_path, outcome, fewer):
    level, dead = SYNTHETIC_LEVELS[0], {"speed_rpm": 0.0, "speed_rpm_se": 0.0}
    with RunWriter.create(tmp_path, start_of(bench="virtual", sweep=SWEEP)) as writer:
        rig = Bench(writer)
        for n, changes in enumerate(({}, dead, dead), start=1):
            rig.plateau(n, level, "up", repeat=n, **changes)
        writer.end(outcome, "the rotor stands", vented=True)
    have = taken(read_run(writer.folder), BENCH, tmp_path)
    assert (len(have.steps), len(have.plateaus)) == (3 - fewer, 3 - fewer)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bench": "lab"}, "is of the bench 'lab', not of 'virtual'"),
        ({"motor": "ptm1800"}, "is of the motor ptm1800, not of the motor ptm3600, which is on the bench now"),
        ({"kind": "zero"}, "only a sweep is continued"),
        ({"sweep": SWEEP | {"levels_bar_abs": [1.5]}}, "another sweep: levels_bar_abs differ"),
    ],
)
def test_a_run_of_something_else_is_not_continued(tmp_path, changes, words):
    with pytest.raises(RunError, match=words):
        taken(run_of(tmp_path, **changes), BENCH, tmp_path)


@pytest.mark.parametrize("which", ["parent", "its parent"])
def test_a_run_of_another_motor_is_not_continued(tmp_path, which):
    first = run_of(tmp_path, motor_serial="A-17")
    run = first if which == "parent" else run_of(tmp_path, parent=first.name)
    assert taken(run, BENCH, tmp_path, "A-17").steps
    with pytest.raises(RunError, match=r"is of the motor ptm3600 no\. A-17, not of the motor ptm3600 no\. B-2, which"):
        taken(run, BENCH, tmp_path, "B-2")


def test_captures_that_are_there_are_not_taken_again():
    ambient = at_start(BENCH, Given(minutes_running=0.0))
    course, _ = sweep_course(BENCH, ambient, (), ("coast-down",))
    assert [task.kind for task in course.captures] == ["spin-up"]


def test_the_guard_knows_what_the_parents_measured(tmp_path):
    """It refused 2.00 bar although the run that was continued had measured 1.95 bar."""
    first = run_of(tmp_path)
    second = run_of(tmp_path, parent=first.name)
    ambient = at_start(BENCH, Given(minutes_running=0.0))
    predict = guarded(Guard(motor_of(BENCH, ambient), 600.0, 580.0), ambient.pressure_bar_abs, False)
    assert not predict(2.0, []).allowed
    for run, times in ((first, 1), (second, 2)):
        have = taken(run, BENCH, tmp_path)
        course, _ = sweep_course(BENCH, ambient, have.steps, have.captures, have.plateaus)
        assert len(course.known) == times * len(run.plateaus)
        assert predict(2.0, course.known).allowed


def test_a_capture_that_was_cut_short_is_taken_again(tmp_path):
    for cut, have in ((True, set()), (False, {"coast-down"})):
        with RunWriter.create(tmp_path, start_of(bench="virtual", sweep=SWEEP)) as writer:
            Bench(writer).capture("coast-down", **({"cut_short": True} if cut else {}))
            writer.end("aborted", vented=True)
        assert taken(read_run(writer.folder), BENCH, tmp_path).captures == have


def test_a_level_beyond_the_regulator_s_span_is_refused_and_not_clipped():
    table = BENCH.file.devices["dac"].model_copy(update={"span": [0.0, 1.0]})
    file = BENCH.file.model_copy(update={"devices": BENCH.file.devices | {"dac": table}})
    ambient = at_start(BENCH, Given(minutes_running=0.0))
    with pytest.raises(
        SweepError, match=r"2\.2 bar abs is beyond the regulator's span, which ends at 2\.01325 bar abs"
    ):
        sweep_course(dataclasses.replace(BENCH, file=file), ambient)


def test_captures_alone_can_be_what_is_left():
    ambient = at_start(BENCH, Given(minutes_running=0.0))
    steps = sweep_course(BENCH, ambient)[0].steps
    course, _ = sweep_course(BENCH, ambient, [dataclasses.replace(step) for step in steps])
    assert course.steps == []
    assert len(course.captures) == 2
    with pytest.raises(SweepError, match="nothing left"):
        sweep_course(BENCH, ambient, steps, ("coast-down", "spin-up"))
