"""What is shown of a run: its state in a word and what it waits for, figures with marks, alarms with what to do."""

import time

import pytest

from rig.readings import Quality
from rig.runlog import RunWriter
from rig.runlog.tail import Tail
from spinbench.console.facts import facts
from spinbench.console.stopping import Stopping, ask_to_stop, being_written
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of, write_sweep

S = 1_000_000_000
SWEEP = {"dwell_s": 5.0, "settle_timeout_s": 60.0, "ramp_bar_s": 0.5}


def shown(folder, now_s=None, **options):
    tail = Tail(folder)
    while tail.advance():
        pass
    return facts(tail, tail.now_s if now_s is None else now_s, 0.0, **options)


@pytest.fixture
def writer(tmp_path):
    with RunWriter.create(tmp_path, start_of(sweep=SWEEP, safety={"highest_speed_rpm": 600.0})) as made:
        yield made


def test_a_dwell_says_how_long_still_and_a_settling_at_most(writer):
    writer.event("state", 10 * S, state="settle")
    state = shown(writer.folder, 15.0)["state"]
    assert (state["word"], state["still_s"], state["at_most"]) == ("settle", 55.0, True)
    writer.event("state", 20 * S, state="dwell", settled=True)
    state = shown(writer.folder, 22.0)["state"]
    assert (state["word"], state["still_s"], state["of_s"], state["at_most"]) == ("dwell", 3.0, 5.0, False)
    assert state["waits_for"]


@pytest.mark.parametrize(
    ("ended", "word"),
    [
        (("finished", "", {"vented": True}), "finished"),
        (("aborted", "stopped by the operator", {"vented": True, "stopped_by": "operator"}), "stopped"),
        (("aborted", "speed 700 rpm", {"vented": True, "stopped_by": "interlock"}), "tripped"),
        (("failed", "no reading", {"vented": False}), "failed"),
        (("aborted", "as it was before this key", {}), "stopped"),
        (None, "killed"),
    ],
)
def test_every_end_has_a_word_of_its_own_and_what_to_do(tmp_path, ended, word):
    with RunWriter.create(tmp_path, start_of()) as writer:
        if ended is not None:
            writer.end(ended[0], ended[1], **ended[2])
    found = shown(writer.folder)
    assert found["state"]["word"] == word
    if word == "finished":
        assert found["alarms"] == []
    else:
        assert found["alarms"][0]["guidance"]
    if word == "tripped":
        assert (
            f"spinbench runs show --logs {writer.folder.parent} {writer.folder.name}" in found["alarms"][0]["guidance"]
        )
    if word in ("failed", "killed"):
        assert "Close the supply by hand" in found["alarms"][0]["guidance"]


def test_one_stop_makes_one_alarm_with_a_command_that_can_be_typed(writer):
    writer.event("warning", 1 * S, text="aborted: stopped by the operator")  # as the sweep says when it vents
    (before,) = shown(writer.folder)["alarms"]
    writer.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    (alarm,) = shown(writer.folder, acknowledged=[before["n"]])["alarms"]
    assert alarm["text"] == "stopped by the operator"
    assert alarm["acknowledged"]
    command = f"spinbench sweep BENCH --continue {writer.folder.name} --logs {writer.folder.parent}"
    assert alarm["guidance"].endswith(command)


def test_a_stop_that_did_not_vent_is_an_alarm_though_its_warning_was_seen(writer):
    writer.event("warning", 1 * S, text="aborted: stopped by the operator")
    (before,) = shown(writer.folder)["alarms"]
    writer.end("aborted", "stopped by the operator", vented=False, stopped_by="operator")
    (alarm,) = shown(writer.folder, acknowledged=[before["n"]])["alarms"]
    assert not alarm["acknowledged"]
    assert "NOT known to be without pressure" in alarm["text"]


def test_figures_are_marked_when_they_are_old_or_none(writer):
    writer.exchange(poll("gauge", {PRESSURE: 1.5}, 1 * S))
    writer.exchange(poll("tach", {SPEED: 100.0}, 9 * S))
    pressure, flow, speed, _ = shown(writer.folder, 9.5)["figures"]
    assert (pressure["text"], pressure["unit"], pressure["mark"]) == ("1.500", "bar abs", "old")
    assert (flow["text"], flow["mark"]) == ("–", "none")
    assert (speed["text"], speed["unit"], speed["mark"]) == ("100.0", "rpm", "good")
    assert shown(writer.folder, 9.5, silent_s=3.0)["figures"][2]["quality"] == "old: 3 s"


def test_a_past_runs_figures_say_so(writer):
    writer.exchange(poll("gauge", {PRESSURE: 1.5}, 1 * S))
    assert shown(writer.folder)["figures"][0]["mark"] == "good"
    writer.end("finished", vented=True)
    pressure, flow, *_ = shown(writer.folder)["figures"]
    assert (pressure["text"], pressure["mark"]) == ("1.500", "past")
    assert pressure["quality"].startswith("last reading of a run that ended 20")
    assert flow["quality"] == "no reading yet"


def test_an_import_went_through_no_course(tmp_path):
    with RunWriter.create(tmp_path, start_of("import", imported={"title": "a table"})) as made:
        made.exchange(poll("gauge", {PRESSURE: 1.5}, 1 * S))
        made.end("finished")
    found = shown(made.folder)
    assert found["state"]["word"] == "imported"
    assert "course" not in found["state"]["explanation"]
    assert found["figures"][0]["quality"] == "last reading of an imported file"
    assert found["alarms"] == []


def test_the_running_step_is_marked_and_one_left_out_too(writer):
    writer.event("course", 0, steps=[[1.3, "up", 1], [1.5, "up", 1], [2.4, "up", 1]], captures=[])
    writer.plateau({"n": 1, "level_bar_abs": 1.3, "direction": "up", "start_s": 1.0, "end_s": 5.0})
    writer.event("level refused", 6 * S, level_bar_abs=2.4, text="too fast", left_out=[[2.4, "up", 1]])
    found = shown(writer.folder)
    assert [step["status"] for step in found["steps"]["steps"]] == ["done", "running", "left out"]
    assert [alarm["text"] for alarm in found["alarms"]] == ["too fast"]


def test_a_level_that_is_measured_on_the_way_has_a_chip_of_its_own(writer):
    def statuses():
        return [(s["level"], s["status"], s["added"]) for s in shown(writer.folder)["steps"]["steps"]]

    writer.event("course", 0, steps=[[1.5, "up", 1], [1.7, "up", 1]], captures=[])
    writer.event("state", 1 * S, state="ramp", target_bar_abs=1.2, added=True)
    writer.event("state", 2 * S, state="settle")
    assert statuses() == [(1.2, "running", True), (1.5, "to come", False), (1.7, "to come", False)]
    writer.plateau({"n": 1, "level_bar_abs": 1.2, "direction": "up", "repeat": 1, "start_s": 3.0, "end_s": 5.0})
    writer.event("state", 5 * S, state="ramp", target_bar_abs=1.5)
    assert statuses() == [(1.2, "done", True), (1.5, "running", False), (1.7, "to come", False)]
    writer.plateau({"n": 2, "level_bar_abs": 1.5, "direction": "up", "repeat": 1, "start_s": 6.0, "end_s": 8.0})
    writer.plateau({"n": 3, "level_bar_abs": 1.6, "direction": "up", "repeat": 1, "start_s": 9.0, "end_s": 10.0})
    assert statuses() == [(1.2, "done", True), (1.5, "done", False), (1.6, "done", True), (1.7, "running", False)]


def test_f_overall_is_shown_once_a_plateau_with_a_turning_rotor_has_told_of_it(writer):
    told = {"f_overall": {"mean": 0.06, "sd": 0.01}, "band": []}
    writer.event("expected", 1 * S, plateaus=1, turning=0, **told)
    assert shown(writer.folder)["picture"]["f_overall"] is None
    writer.event("expected", 2 * S, plateaus=2, turning=1, **told)
    assert shown(writer.folder)["picture"]["f_overall"] == told["f_overall"]


def test_one_word_is_used_for_a_run_that_was_stopped(writer):
    writer.event("state", 1 * S, state="aborted")
    found = shown(writer.folder)
    assert (found["state"]["word"], found["events"][-1]["text"]) == ("stopping", "stopping")
    assert "aborted" not in str(found)


def test_a_typed_reading_is_not_old_and_one_that_was_left_out_is_no_fault(writer):
    writer.exchange(poll("gauge", {PRESSURE: 1.5}, 1 * S, quality=Quality.MANUAL))
    writer.exchange(poll("tach", {SPEED: None}, 1 * S, quality=Quality.MANUAL))
    pressure, _, speed, _ = shown(writer.folder, 31.0)["figures"]
    assert (pressure["mark"], pressure["quality"]) == ("good", "typed 30 s ago")
    assert (speed["mark"], speed["quality"]) == ("none", "not read")


def test_the_lamp_says_what_the_check_beside_the_sweep_found(writer):
    assert shown(writer.folder)["check"]["lamp"] == "waits"
    writer.event("model check", 1 * S, p_value=0.4, differs=False, text="the model explains 6 plateaus")
    assert shown(writer.folder)["check"]["lamp"] == "fits"
    writer.event("model check", 2 * S, p_value=1e-9, differs=True, text="it does not")
    assert shown(writer.folder)["check"] == {"lamp": "differs", "text": "it does not"}


@pytest.mark.parametrize("kind", ["plateaus", "coast-down", "import"])
def test_the_lamp_waits_for_nothing_in_a_run_that_is_not_checked(tmp_path, kind):
    with RunWriter.create(tmp_path, start_of(kind)) as made:
        check = shown(made.folder)["check"]
    assert (check["lamp"], "sixth" in check["text"]) == ("none", False)


def test_the_lamp_of_a_sweep_that_has_ended_waits_for_nothing(writer):
    writer.end("finished", vented=True)
    assert shown(writer.folder)["check"]["lamp"] == "none"


def test_an_alarm_that_was_seen_says_so_and_none_tells_of_a_run_that_goes_on_when_it_has_ended(writer):
    writer.event("warning", 1 * S, text="the gauge drifts")
    (alarm,) = shown(writer.folder)["alarms"]
    assert (alarm["acknowledged"], "goes on" in alarm["guidance"]) == (False, True)
    (alarm,) = shown(writer.folder, acknowledged=[alarm["n"]])["alarms"]
    assert alarm["acknowledged"]
    writer.end("finished", vented=True)
    (alarm,) = shown(writer.folder)["alarms"]
    assert "has ended" in alarm["guidance"]


def test_the_speed_in_time_has_the_band_that_is_expected_at_each_pressure(writer):
    writer.event(
        "expected", 1 * S, plateaus=2, turning=2, f_overall=None, band=[[1.2, 90, 100, 110], [1.6, 180, 200, 220]]
    )
    for second, bar in ((2, 1.1), (3, 1.2), (4, 1.4), (5, 1.8)):
        writer.exchange(poll("gauge", {PRESSURE: bar}, second * S))
        writer.exchange(poll("tach", {SPEED: 100.0}, second * S))
    series = shown(writer.folder, 6.0)["charts"]["series"]
    assert [band[1:] for band in series["speed"]["band"]] == [[90.0, 110.0], [135.0, 165.0]]  # beyond it, none is known
    assert "band" not in series["pressure"]


def test_charts_of_a_long_run_have_a_bounded_number_of_bins(tmp_path):
    charts = shown(write_sweep(tmp_path))["charts"]["series"]
    assert set(charts) == {"pressure", "flow", "speed"}
    assert all(10 < len(one["bins"]) <= 420 for one in charts.values())


def test_stop_is_delivered_once_the_log_has_the_order_and_not_before(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr("spinbench.console.stopping.os.kill", lambda pid, number: told.append(pid))
    with RunWriter.create(tmp_path, start_of(roles=start_of().roles | {"regulator": "dac"})) as writer:
        writer.event("set-point", 1 * S, device="dac", value=0.0, bar_abs=None)
        assert being_written(tmp_path) == [writer.folder]
        stop = Stopping.of(writer.folder, "a test")
        assert len(told) == 1
        tail = Tail(writer.folder)
        tail.advance()
        stop.look(tail)
        assert stop.told()["word"] == "asked"
        monkeypatch.setattr(time, "time", lambda now=time.time: now() - 3600.0)  # the clock is set back
        stop.pressed_s -= 60.0
        assert stop.told()["word"] == "NOT DELIVERED"
        assert "Close the supply by hand" in stop.told()["text"]
        writer.event("state", 2 * S, state="capture")
        writer.event("set-point", 2 * S, device="dac", value=0.0, bar_abs=None)  # of the capture: the run goes on
        tail.advance()
        stop.look(tail)
        assert stop.told()["word"] == "NOT DELIVERED"
        writer.event("set-point", 3 * S, device="dac", value=0.0, bar_abs=None)
        writer.event("state", 3 * S, state="vent", reason="stopped by the operator")
        tail.advance()
        stop.look(tail)
        assert stop.told()["word"] == "DELIVERED"


def test_a_process_that_has_ended_cannot_be_told():
    assert "has ended" in ask_to_stop(2**22 + 12345)
    assert "not known" in ask_to_stop(None)
