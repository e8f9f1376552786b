"""What is started from the console: captures, the test that a diagnosis recommends, and runs one after the other."""

import json
import subprocess
import time
from types import SimpleNamespace

import pytest

from rig.bench.bench import bench_path, read_bench
from rig.runlog import RunWriter, read_run
from rig.runlog.schema import ClockRecord
from spinbench.console import sweeps
from spinbench.console.access import RefusedError
from spinbench.console.desk import Desk
from spinbench.console.planned import Planned, of_command, of_table, planned_of
from tests.console_lab import consoles, events_of, has, short_bench, start_from
from tests.synthetic_runs import start_of, write_sweep
from tests.waiting import wait_for

COMMAND = "spinbench capture BENCH --kind plateaus --level-bar-abs 1.24"
TESTS = [
    {"test": "reversed sweep", "separates": ["leakage"], "information_nats": 3.0, "needs": "", "command": ""},
    {"test": "ten plateaus at 1.24 bar", "separates": ["leakage"], "information_nats": 0.71, "command": COMMAND},
    {"test": "flow beside a reference", "needs": "a reference flow meter", "command": ""},
    {"test": "a hostile one", "command": "spinbench capture BENCH --kind zero --rate 9"},
    {"test": "another", "command": "rm -rf /"},
]


def put_diagnosis(logs, run, tests=TESTS):
    folder = logs / "reports" / run.name / "diagnosis"
    folder.mkdir(parents=True)
    (folder / "diagnosis.json").write_text(json.dumps({"format": "diagnosis/1", "next_tests": tests}))
    (folder / "report.html").write_text("<h1>a diagnosis</h1>")


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return read_bench(short_bench(tmp_path_factory.mktemp("bench")))


@pytest.fixture
def desk(tmp_path):
    path = short_bench(tmp_path)
    return Desk(path, read_bench(path), tmp_path / "logs")


@pytest.fixture
def processes(monkeypatch, desk):
    """Programs that do nothing in place of runs; gives their commands, and a function that ends the newest.

    It leaves a run that ended so, and then the exit code; with None it goes on, as one that makes its page does.
    """
    commands, made, begin = [], [], subprocess.Popen

    def popen(command, **options):
        commands.append(command[3:])
        made.append(begin(["sh", "-c", "read code; exit $code"], **options | {"stdin": subprocess.PIPE}))
        return made[-1]

    def end(code=0, outcome="finished", reason="", vented=True):
        now = ClockRecord(utc_start_ns=time.time_ns())
        with RunWriter.create(desk.logs, start_of("zero", minutes_running=7.0, clock=now)) as writer:
            writer.end(outcome, reason, vented=vented)
        if code is not None:
            made[-1].communicate(f"{code}\n".encode())

    monkeypatch.setattr(sweeps.subprocess, "Popen", popen)
    yield SimpleNamespace(commands=commands, end=end)
    for process in made:
        process.kill()
        process.communicate()


def queued(desk, *kinds, **more):
    for kind in kinds:
        desk.queue.change("add", {"planned": {"kind": kind, **more}})
    return [one["n"] for one in desk.queue.told()["waiting"]]


def test_a_capture_is_started_with_what_was_asked_for_and_nothing_else(desk, processes):
    asked = {"kind": "coast-down", "level_bar_abs": "2.0", "added_inertia_kg_m2": 0.015, "after": "a_run", "note": "x"}
    desk.sweeps.start(planned_of(asked, desk.bench), {"operator": "Novák"})
    name, path, logs, *options = processes.commands[0]
    assert (name, path, logs) == ("capture", str(desk.sweeps.path), f"--logs={desk.logs}")
    assert sorted(options) == [
        "--added-inertia-kg-m2=0.015",
        "--after=a_run",
        "--kind=coast-down",
        "--level-bar-abs=2.0",
        "--note=x",
        "--operator=Novák",
    ]


def test_the_next_run_does_not_wait_for_the_page_of_the_one_before(desk, processes):
    desk.sweeps.start(Planned("zero"), {})
    assert desk.sweeps.running
    processes.end(None)
    assert not desk.sweeps.running
    desk.sweeps.start(Planned("zero"), {})
    assert desk.sweeps.starting
    assert len(processes.commands) == 2


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"kind": "spin"}, "kind 'spin': expected sweep, coast-down"),
        ({"kind": "sweep", "level_bar_abs": 2}, "a sweep takes what the bench file says"),
        ({"kind": "zero", "plateaus": 3}, "a zero has none"),
        ({"kind": "spin-up", "level_bar_abs": 9}, "level_bar_abs '9': expected 1.01325 to 3"),
        ({"kind": "spin-up", "level_bar_abs": "nan"}, "level_bar_abs 'nan'"),
        ({"kind": "plateaus", "plateaus": "2.5"}, "plateaus '2.5': expected 1 to 1000"),
        ({"kind": "zero", "logs": "/"}, "logs: no such entry"),
        ({"kind": "zero", "after": "../x"}, "after '../x': expected the name of a run"),
    ],
)
def test_what_cannot_be_taken_is_refused_with_the_reason(bench, asked, words):
    with pytest.raises(RefusedError, match=r"expected|no such|none|bench file") as refused:
        planned_of(asked, bench)
    assert words in str(refused.value)


def test_the_valve_of_a_person_takes_no_runs_in_time():
    with pytest.raises(RefusedError, match="expected sweep, plateaus, zero"):
        planned_of({"kind": "coast-down"}, read_bench(bench_path("manual")))


def test_a_command_of_a_diagnosis_is_read_and_never_run(bench):
    assert of_command(COMMAND, "a_run", bench) == Planned("plateaus", 1.24, after="a_run")
    elsewhere = of_command(f"{COMMAND} --after another --logs /", "a_run", bench)
    assert elsewhere == of_command(COMMAND, "a_run", bench)  # the console's own folder, and the diagnosis' own run
    for command in ("rm -rf /", f"{COMMAND}; rm", f"{COMMAND} --rate 9", "spinbench sweep BENCH", 'spinbench "'):
        with pytest.raises(RefusedError):
            of_command(command, "a_run", bench)


def test_a_table_is_taken_whole_or_not_at_all(bench):
    table = "kind,level_bar_abs,plateaus\r\nsweep,,\r\nplateaus,1.3,4\r\n"
    assert of_table(table, bench) == [Planned("sweep"), Planned("plateaus", 1.3, 4)]
    with pytest.raises(RefusedError) as refused:
        of_table(table + "sweep,1.3,\nspin,,\nzero,,,\n", bench)
    assert str(refused.value).startswith("nothing was added. row 3: ")
    assert "row 4: " in str(refused.value)
    assert "row 5: more cells" in str(refused.value)


def test_each_run_of_the_queue_begins_when_the_one_before_has_ended_well(desk, processes):
    numbers = queued(desk, "zero", "spin-up", "sweep")
    desk.queue.start({"minutes_running": "5"}, numbers)
    desk.follow()
    assert [command[0] for command in processes.commands] == ["capture"]
    processes.end()
    desk.follow()
    desk.follow()
    assert [command[0] for command in processes.commands] == ["capture", "capture"]
    assert "--kind=spin-up" in processes.commands[1]
    assert any(word.startswith("--minutes-running=7.") for word in processes.commands[1])  # the motor has run meanwhile
    processes.end()
    desk.follow()
    assert processes.commands[2][0] == "sweep"
    processes.end()
    desk.follow()
    assert desk.queue.told() == {"waiting": [], "going": False, "said": "The queue is done."}


@pytest.mark.parametrize(
    ("end", "words"),
    [
        ({"code": 4, "outcome": "aborted", "reason": "speed 700 rpm"}, "did not finish: speed 700 rpm"),
        ({"code": 2}, "did not begin, or failed"),
        ({"vented": False}, "NOT known to be without pressure"),
    ],
)
def test_the_queue_is_held_where_a_run_has_not_ended_well(desk, processes, end, words):
    desk.queue.start({}, queued(desk, "zero", "zero"))
    processes.end(**end)
    desk.follow()
    told = desk.queue.told()
    assert (len(processes.commands), told["going"], len(told["waiting"])) == (1, False, 1)
    assert words in told["said"]


def test_stop_and_another_flywheel_hold_the_queue(desk, processes):
    desk.queue.start({}, queued(desk, "zero", "zero"))
    desk.stop("a test")
    assert "STOP was pressed by a test" in desk.queue.told()["said"]
    processes.end()
    desk.follow()
    assert len(processes.commands) == 1
    desk.queue.start({}, queued(desk, "spin-up", added_inertia_kg_m2=0.01))
    processes.end()
    desk.follow()
    assert "another flywheel" in desk.queue.told()["said"]


@pytest.mark.parametrize(
    ("bench", "word", "text"),
    [
        ("virtual", "DELIVERED", "regulator has not been raised"),
        ("manual", "NOT DELIVERED", "Close the supply by hand"),
    ],
)
def test_stop_before_the_run_is_there_says_who_has_the_valve(desk, processes, bench, word, text):
    desk.sweeps.start(Planned("sweep"), {})
    desk.bench = read_bench(bench_path(bench))
    told = desk.stop("a test")
    assert (told["word"], text in told["text"]) == (word, True)


def test_the_queue_is_edited_and_kept_and_never_goes_on_by_itself_after_a_restart(desk):
    first, second = queued(desk, "zero", "sweep")
    desk.queue.change("clone", {"n": first})
    desk.queue.change("up", {"n": second})
    desk.queue.change("remove", {"n": first})
    with pytest.raises(RefusedError, match="no longer in the queue"):
        desk.queue.change("down", {"n": first})
    again = Desk(desk.sweeps.path, desk.bench, desk.logs)
    told = again.queue.told()
    assert ([one["kind"] for one in told["waiting"]], told["going"]) == (["sweep", "zero"], False)
    desk.kept.acknowledge("a_run", 1)
    again.queue.change("add", {"planned": {"kind": "zero"}})
    desk.kept.acknowledge("a_run", 2)  # two consoles of one folder: neither undoes what the other keeps
    kept = Desk(desk.sweeps.path, desk.bench, desk.logs)
    assert (len(kept.queue.told()["waiting"]), kept.kept.acknowledged) == (3, {"a_run": [1, 2]})
    with pytest.raises(RefusedError, match="has changed since it was shown"):
        again.queue.start({}, [7])


@pytest.mark.slow
def test_over_http_the_one_in_control_alone_starts_and_plans_and_refusals_say_why(tmp_path):
    logs = tmp_path / "logs"
    put_diagnosis(logs, write_sweep(logs))
    with consoles() as start:
        console = start(short_bench(tmp_path), logs)

        def ask(what, **body):
            status, text, _ = console.ask(f"/api/{what}", {"window": "w", **body}, x_spinbench_token=console.token)
            return status, json.loads(text).get("error", "")

        zero = {"planned": {"kind": "zero"}}
        assert console.ask("/api/queue", {"window": "w", "do": "add", **zero})[0] == 403
        assert ask("queue", do="add", **zero)[0] == ask("start", **zero)[0] == 409  # nobody controls
        assert ask("control") == (200, "")
        assert ask("start", planned={"kind": "spin"})[0] == 400
        assert ask("start", planned=["zero"])[0] == 400
        assert ask("queue", do="add", **zero) == (200, "")
        assert "row 1: kind 'x'" in ask("queue", do="load", text="kind\nx\n")[1]
        assert ask("queue", do="dance")[0] == 409
        assert [one["words"] for one in console.parts()["console"]["queue"]["waiting"]] == ["zero"]
        (row,) = json.loads(console.ask("/api/runs")[1])
        told = {test["test"]: (test["planned"] and test["planned"]["words"], test["why_not"]) for test in row["tests"]}
    assert told["ten plateaus at 1.24 bar"] == (f"plateaus at 1.24 bar abs 10 times after {row['name']}", "")
    assert told["reversed sweep"] == (None, "the bench cannot take it by itself")
    assert told["flow beside a reference"] == (None, "it needs a reference flow meter")
    assert told["a hostile one"][0] is told["another"][0] is None


def take_control(page):
    page.keyboard.press("t")
    has(page, "#control-told", "This window controls")


@pytest.mark.long
def test_the_recommended_test_is_started_from_its_report_and_stopped_like_a_sweep(tmp_path, start_console, window):
    logs = tmp_path / "logs"
    parent = write_sweep(logs, start_of())
    put_diagnosis(logs, parent)
    page = window(start_console(short_bench(tmp_path, dwell_s=600.0), logs).address)
    take_control(page)
    page.click("text=diagnosis/report.html")
    has(page, "#report-tests", "reversed sweep: the bench cannot take it by itself")
    page.click("#report-tests >> text=Next test: ten plateaus")
    assert "ten plateaus at 1.24 bar" in page.inner_text("#planned")
    page.click("#start-now")
    has(page, "#word", "dwell")
    has(page, "#run-name", "_plateaus")
    has(page, "#steps", "1.24 bar")
    page.keyboard.press("s")
    has(page, "#stop-told", "STOP DELIVERED")
    has(page, "#word", "stopped")
    run = read_run(next(logs.glob("*_plateaus")))
    assert (run.start.parent, run.end.stopped_by, run.end.vented) == (parent.name, "operator", True)


@pytest.mark.long
def test_a_queue_is_planned_shown_and_gone_through_and_stop_holds_it(tmp_path, start_console, window):
    logs = tmp_path / "logs"
    page = window(start_console(short_bench(tmp_path, dwell_s=600.0), logs).address)
    take_control(page)
    table = {"name": "plan.csv", "mimeType": "text/csv", "buffer": b"kind,note\nzero,first\nsweep,\nzero,last\n"}
    page.set_input_files("#queue-file", table)
    page.wait_for_selector("#queue li:nth-child(3)")
    page.click("#queue li:nth-child(2) >> text=Clone")
    page.wait_for_selector("#queue li:nth-child(4)")
    page.click("#queue-start")
    assert "first" in page.inner_text("#planned")
    page.click("#start-now")
    has(page, "#queue-said", "goes on by itself, 3 to come")
    has(page, "#run-name", "_sweep")
    has(page, "#word", "dwell")
    zero = read_run(next(logs.glob("*_zero")))
    assert (zero.end.outcome, zero.start.note) == ("finished", "first")
    page.keyboard.press("s")
    has(page, "#queue-said", "2 to come. The queue is held. STOP was pressed by")
    has(page, "#word", "stopped")
    sweep = next(logs.glob("*_sweep"))
    wait_for((sweep / "end.json").exists, "the sweep sealed")
    assert [event["event"] for event in events_of(sweep)].count("plateau") == 0
    assert len(list(logs.glob("*/start.json"))) == 2
    page.wait_for_function("() => !document.querySelector('#start').disabled")
    start_from(page)  # a run that is no part of the queue
    has(page, "#word", "dwell")
    assert page.locator("#queue li").count() == 2
    page.keyboard.press("s")
    has(page, "#word", "stopped")
