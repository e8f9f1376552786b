"""A run by hand that is answered from the page: checked as the prompt checks it, logged as if it had been typed."""

import json
import os
import re
import select
import time
from types import SimpleNamespace

import pytest

from rig.bench.bench import FOLDER, read_bench
from rig.by_hand.manual import CLOSED_QUESTION
from rig.by_hand.prompter import PRESSURE_NOW
from rig.instruments.manual import example
from rig.runlog import RunWriter, read_run
from spinbench.console import sweeps
from spinbench.console.access import RefusedError
from spinbench.console.desk import Desk
from spinbench.console.entries import SAID, Entries, typed_into
from spinbench.console.planned import Planned
from tests.console_lab import consoles, ends, has, only_run, short_bench
from tests.synthetic_runs import start_of
from tests.waiting import wait_for

READINGS = {"pressure_bar_abs": "1.24", "flow_l_min": "<10", "speed_rpm": "78"}


def hand_bench(folder):
    text = re.sub(r"(?m)^levels_bar_abs = .*$", "levels_bar_abs = [1.24, 1.34]", (FOLDER / "manual.toml").read_text())
    path = folder / "hand.toml"
    path.write_text(text.replace("dwell_s = 10.0", "dwell_s = 0.3").replace('order = "up-down"', 'order = "up"'))
    return path


@pytest.fixture
def run(tmp_path):
    """The ends of a run that a page answers: it says something, and reads what was typed."""
    entries = Entries(read_bench(hand_bench(tmp_path)), tmp_path)
    with typed_into(entries) as handle:

        def says(text):
            with (tmp_path / SAID).open("a") as stream:
                stream.write(text)

        def reads():
            return os.read(handle, 4096).decode() if select.select([handle], [], [], 0.0)[0] else None

        yield SimpleNamespace(entries=entries, says=says, reads=reads, said=tmp_path / SAID)
    assert entries.told() is None  # nobody listens any more
    with pytest.raises(RefusedError, match="no run that was started from a console"):
        entries.enter({"asks": 0, "text": ""})


def test_readings_are_typed_as_a_person_would_and_a_question_is_answered_once(run):
    run.says(f"[1/2] set 1.240 bar abs\n  {example(run.entries.channels)}: ")
    told = run.entries.told()
    assert (told["kind"], told["question"]) == ("readings", "[1/2] set 1.240 bar abs")
    assert [(one["label"], one["unit"]) for one in told["fields"]] == [
        ("pressure", "bar abs"),
        ("flow", "L/min"),
        ("speed", "rpm"),
    ]
    run.entries.enter({"asks": told["asks"], "fields": READINGS})
    assert run.reads() == "1.24 <10 78\n"
    assert run.said.read_text().endswith(": 1.24 <10 78\n")  # as a terminal shows what is typed
    with pytest.raises(RefusedError, match="has changed since it was shown"):
        run.entries.enter({"asks": told["asks"], "fields": READINGS})
    run.says(f"  {PRESSURE_NOW} ")
    told = run.entries.told()
    assert [one["name"] for one in told["fields"]] == ["pressure_bar_abs"]
    run.entries.enter({"asks": told["asks"], "fields": {"pressure_bar_abs": ""}})
    assert run.reads() == "\n"
    assert run.reads() is None


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"pressure_bar_abs": "1,24"}, "has a comma"),
        ({"flow_l_min": "140"}, "above the scale; type >100"),
        ({"speed_rpm": "78 rpm"}, "one number, without its unit"),
        ({"speed_rpm": "7e1"}, "not a number alone"),
        (dict.fromkeys(READINGS, ""), "nothing is entered"),
    ],
)
def test_what_the_prompt_would_refuse_is_refused_in_its_words_and_not_typed(run, changed, words):
    run.says(f"  {example(run.entries.channels)}: ")
    asks = run.entries.told()["asks"]
    with pytest.raises(RefusedError, match=re.escape(words)):
        run.entries.enter({"asks": asks, "fields": READINGS | changed})
    assert run.reads() is None
    run.entries.enter({"asks": asks, "fields": READINGS})


def test_an_answer_to_another_question_is_refused_and_lines_are_single(run):
    run.says(f"  {example(run.entries.channels)}: ")
    before = run.entries.told()["asks"]
    run.says(f"\nCLOSE THE VALVE.\n  {CLOSED_QUESTION} ")  # STOP was pressed meanwhile
    assert run.entries.told()["kind"] == "vented"
    with pytest.raises(RefusedError, match="has changed"):
        run.entries.enter({"asks": before, "text": ""})
    with pytest.raises(RefusedError, match="one line"):
        run.entries.enter({"asks": run.entries.told()["asks"], "text": "y\nstop"})
    assert run.reads() is None


def test_nothing_is_asked_once_the_run_is_sealed_but_the_next_one_asks_before_its_run_is_there(tmp_path):
    path, logs = hand_bench(tmp_path), tmp_path / "logs"
    desk = Desk(path, read_bench(path), logs)
    entries = desk.sweeps.entries
    for _ in range(2):
        with typed_into(entries):
            (logs / SAID).write_text("Relative humidity [%]: ")
            assert desk.console("w")["entries"]["question"] == "Relative humidity [%]:"
            entries.enter({"asks": 0, "text": "50"})
            time.sleep(0.05)  # the file system's clock may be no finer
            with RunWriter.create(logs, start_of("manual")) as writer:
                writer.end("finished", vented=True)
            wait_for(lambda: desk.follow() or desk.showing.tail.folder == writer.folder, "the run")
            wait_for(lambda: desk.follow() or desk.showing.tail.end, "its end")
            assert desk.console("w")["entries"] is None
        time.sleep(0.05)


def test_a_run_begins_while_the_one_before_makes_its_page_and_not_while_that_one_asks(tmp_path, monkeypatch):
    path, logs = hand_bench(tmp_path), tmp_path / "logs"
    desk, begun = Desk(path, read_bench(path), logs), []
    monkeypatch.setattr(sweeps.subprocess, "Popen", lambda command, **_: begun.append(command))
    with typed_into(desk.sweeps.entries):  # its program has it until its page is made
        with pytest.raises(RefusedError, match="waits for its next answer"):
            desk.sweeps.start(Planned("sweep"), {})
        time.sleep(0.05)  # the file system's clock may be no finer
        with RunWriter.create(logs, start_of("manual")) as writer:
            writer.end("finished", vented=True)
        desk.sweeps.start(Planned("sweep"), {})
    assert len(begun) == 1


def test_a_countdown_still_takes_the_readings(run):
    run.says(f"set 1.3\n  {example(run.entries.channels)}: \n  wait: 3 s 2 s")
    told = run.entries.told()
    assert (told["kind"], told["question"], told["said"][-1]) == ("readings", "wait: 3 s 2 s", "set 1.3")


@pytest.mark.slow
def test_over_http_entries_need_control_and_a_bench_that_a_person_reads(tmp_path):
    with consoles() as start:
        console = start(short_bench(tmp_path), tmp_path / "logs")
        asked = {"window": "w", "asks": 0, "text": "1.2"}
        assert console.ask("/api/enter", asked)[0] == 403
        assert console.ask("/api/enter", asked, x_spinbench_token=console.token)[0] == 409
        assert console.ask("/api/control", {"window": "w"}, x_spinbench_token=console.token)[0] == 200
        status, text, _ = console.ask("/api/enter", asked, x_spinbench_token=console.token)
    assert (status, json.loads(text)["error"]) == (409, "no person reads this bench's instruments")


@pytest.mark.long
def test_a_sweep_by_hand_is_gone_through_in_the_page_and_a_killed_console_does_not_touch_it(
    tmp_path, start_console, window
):
    logs, bench = tmp_path / "logs", hand_bench(tmp_path)
    console = start_console(bench, logs)
    page = window(console.address)

    def put(**values):
        for name, value in values.items():
            page.fill(f"#hand-fields [name={name}]", value)
        page.click("#hand-send")

    page.keyboard.press("t")
    has(page, "#control-told", "This window controls")
    page.click("#start")
    room = {"lubrication": "none", "minutes_running": "0", "ambient_pressure_bar_abs": "1.013"}
    for name, value in (room | {"ambient_temperature_c": "20"}).items():
        page.fill(f"#entries [name={name}]", value)
    page.click("#start-now")
    has(page, "#hand-question", "Relative humidity")
    page.fill("#hand-line", "50")
    page.keyboard.press("Enter")
    has(page, "#hand-question", "Zero at the start")
    put(pressure_bar_abs="1.01", flow_l_min="<10", speed_rpm="0")
    has(page, "#hand-question", "set 1.240")
    put(pressure_bar_abs="1,24", flow_l_min="14", speed_rpm="78")
    has(page, "#hand-refused", "has a comma")
    console.kill()
    has(page, "#word", "link lost")
    again = start_console(bench, logs, console.port)
    page.reload()
    page.wait_for_selector("body:not(.is-lost)")
    page.keyboard.press("t")
    has(page, "#hand-question", "set 1.240")
    put(pressure_bar_abs="1.24", flow_l_min="14", speed_rpm="78")
    has(page, "#hand-question", "pressure now")
    put(pressure_bar_abs="1.25")
    has(page, "#hand-question", "set 1.340")
    page.fill("#hand-line", "skip")
    page.keyboard.press("Enter")
    has(page, "#hand-question", "Is it closed")
    page.focus("#hand-enter")
    page.keyboard.press("Enter")
    has(page, "#hand-question", "Zero at the end")
    put(pressure_bar_abs="1.01", flow_l_min="<10", speed_rpm="0")
    has(page, "#hand-question", "Relative humidity")  # it was asked for, so it is asked again
    page.click("#hand-enter")
    has(page, "#word", "finished")
    page.wait_for_selector("#by-hand", state="hidden")
    run = ends(logs)
    assert (run.start.kind, run.end.outcome, run.end.vented) == ("manual", "finished", True)
    assert [row.means["pressure_bar_abs"].mean for row in run.plateaus] == pytest.approx([1.245])
    assert set(run.samples["quality"]) == {"manual"}
    assert "1.24 14 78" in [event.details.get("text") for event in run.events if event.event == "typed"]
    assert again.parts()["console"]["entries"] is None


@pytest.mark.long
def test_stop_in_a_sweep_by_hand_asks_for_the_valve_and_seals_when_that_is_answered(tmp_path, start_console, window):
    logs = tmp_path / "logs"
    page = window(start_console(hand_bench(tmp_path), logs).address)
    page.keyboard.press("t")
    has(page, "#control-told", "This window controls")
    page.click("#start")
    for name, value in {
        "lubrication": "none",
        "minutes_running": "0",
        "ambient_pressure_bar_abs": "1.013",
        "ambient_temperature_c": "20",
        "relative_humidity": "0.5",
    }.items():
        page.fill(f"#entries [name={name}]", value)
    page.click("#start-now")
    has(page, "#hand-question", "Zero at the start")
    page.keyboard.press("F8")
    has(page, "#hand-question", "Is it closed")
    has(page, "#stop-told", "NOT DELIVERED")
    has(page, "#stop-told", "A person has this bench's valve")
    folder = only_run(logs)
    assert not (folder / "end.json").exists()
    page.click("#hand-enter")
    has(page, "#word", "stopped")
    wait_for((folder / "end.json").exists, "the run sealed")
    end = read_run(folder).end
    assert (end.outcome, end.stopped_by, end.vented) == ("aborted", "operator", True)
