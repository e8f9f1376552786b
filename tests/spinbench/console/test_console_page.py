"""The console as a person uses it: a browser without a window, a virtual bench, sweeps as processes of their own."""

import os
import re
import signal
import subprocess
import time

import pytest

from rig.runlog import RunWriter
from rig.runlog.folder import writer_of
from tests.console_lab import (
    ENOUGH_S,
    PATIENT_MS,
    PROGRAM,
    Link,
    ends,
    events_of,
    has,
    only_run,
    short_bench,
    start_from,
    wait_for,
)
from tests.synthetic_runs import PRESSURE, poll, start_of, write_sweep

pytestmark = pytest.mark.long


def wall_s(run, event):
    """When an event was, by the clock on the wall, since 1970 [s]."""
    return run.start.clock.utc_start_ns / 1e9 + event.time_s / run.start.clock.rate


def watch_a_sweep(page, bench, logs, sealed):
    """A sweep of another program, watched to its end; whether the check beside it came to an answer."""
    with subprocess.Popen([*PROGRAM, "sweep", bench, "--logs", logs, *sealed], stdin=subprocess.DEVNULL) as sweep:
        for word in ("settle", "dwell"):  # short states may pass between two looks
            has(page, "#word", word)
        page.wait_for_selector("#steps li[aria-current=step]")
        page.wait_for_selector(".figure .quality.good")
        assert "waits for" in page.inner_text("#waits").lower()
        assert "too early" in page.inner_text("#lamp")
        seen = "() => document.querySelector('#lamp').className === 'differs'"
        over = "document.querySelector('#word').textContent === 'finished'"
        page.wait_for_function(f"{seen} || {over}", timeout=5.0 * PATIENT_MS)
        page.wait_for_function(f"() => {over}", timeout=5.0 * PATIENT_MS)
        assert sweep.wait(ENOUGH_S) == 0
    return "MISMATCH" in page.inner_text("#lamp")


def test_a_concealed_drag_is_seen_while_its_sweep_is_watched_to_the_end(tmp_path, start_console, window):
    # The check has the lowest priority: on a machine that is busy it needs a longer sweep.
    for dwell_s in (6.0, 30.0, 120.0):
        folder = tmp_path / f"{dwell_s:g}"
        folder.mkdir()
        logs, bench = folder / "logs", short_bench(folder, "[1.30, 1.45, 1.60, 1.75, 1.90, 2.05, 2.20]", dwell_s)
        sealed = ["--conceal", folder / "seal", "--key", folder / "key", "--conceal-seed", "5", "--only", "windage"]
        console = start_console(bench, logs)
        page = window(console.address)
        has(page, "#word", "idle")
        if watch_a_sweep(page, bench, logs, sealed):
            break
        kinds = [event["event"] for event in events_of(only_run(logs))]
        assert "model check failed" in kinds or kinds.count("model check") < 2  # it was late, and not wrong
    has(page, "#lamp", "MISMATCH")
    has(page, "#friction", "f_overall so far")
    taken = len(ends(logs).plateaus)
    assert f"{taken} plateaus" in page.get_attribute("#picture", "aria-label")
    assert page.locator("#steps li.done").count() >= 7
    assert page.is_enabled("#stop")
    page.wait_for_selector("#runs tr")
    page.click("text=Lay beside")
    has(page, "#picture-key", "laid beside")
    page.click("text=Replay ×10")
    has(page, "#run-name", "REPLAY")
    page.wait_for_function("() => document.querySelector('#word').textContent === 'finished'", timeout=PATIENT_MS)
    page.click("#back")
    page.wait_for_selector("#back", state="hidden")


def test_stop_in_mid_sweep_vents_and_says_delivered_after_the_console_was_killed_and_restarted(
    tmp_path, start_console, window
):
    logs, bench = tmp_path / "logs", short_bench(tmp_path, "[1.25, 1.35]", dwell_s=600.0)
    console = start_console(bench, logs)
    page = window(console.address)
    start_from(page)
    has(page, "#word", "dwell")
    folder = only_run(logs)
    sweep = writer_of(folder)
    console.kill()
    has(page, "#word", "link lost")
    assert page.evaluate("document.querySelector('#main').inert")
    assert page.is_visible("#lost")
    page.keyboard.press("s")
    has(page, "#stop-told", "NOT DELIVERED")
    has(page, "#stop-told", "Close the supply by hand")
    rows = (folder / "samples.csv").stat().st_size
    wait_for(lambda: (folder / "samples.csv").stat().st_size > rows, "the sweep goes on without its console")
    assert writer_of(folder) == sweep
    again = start_console(bench, logs, console.port)
    assert again.address == console.address
    has(page, "#word", "dwell")
    assert page.is_hidden("#lost")
    page.focus("#stop")
    pressed_s = time.time()
    page.keyboard.press("s")
    has(page, "#stop-told", "STOP DELIVERED")
    run = ends(logs)
    orders = [event for event in run.events if event.event == "set-point"]
    zero = next(event for event in orders if event.details["bar_abs"] is None and wall_s(run, event) > pressed_s - 0.5)
    assert all(event.details["bar_abs"] is None for event in orders if event.n > zero.n)
    assert wall_s(run, zero) - pressed_s < 30.0
    assert (run.end.outcome, run.end.stopped_by, run.end.vented) == ("aborted", "operator", True)
    has(page, "#word", "stopped")
    has(page, "#alarms", "stopped by the operator")
    assert again.kill(signal.SIGINT) == 0


def test_a_closed_browser_and_a_killed_sweep_each_leave_the_other_alone(tmp_path, start_console, window):
    logs, bench = tmp_path / "logs", short_bench(tmp_path, "[1.25, 1.35]", dwell_s=600.0)
    console = start_console(bench, logs)
    first = window(console.address)
    start_from(first)
    has(first, "#word", "dwell")
    first.context.close()
    folder = only_run(logs)
    rows = len(events_of(folder)), (folder / "samples.csv").stat().st_size
    wait_for(lambda: (folder / "samples.csv").stat().st_size > rows[1], "the sweep goes on without a window")
    os.kill(writer_of(folder), signal.SIGKILL)
    page = window(console.address)
    has(page, "#word", "killed")
    has(page, "#alarms", "Close the supply by hand")
    wait_for((folder / "watchdog.jsonl").exists, "the watchdog at work")


def test_two_windows_watch_and_one_controls_until_the_other_takes_over(tmp_path, start_console, window):
    logs, bench = tmp_path / "logs", short_bench(tmp_path)
    console = start_console(bench, logs)
    left, right = window(console.address), window(console.address)
    for page in (left, right):
        has(page, "#control-told", "2 windows")
        assert page.is_disabled("#start")
        assert page.is_enabled("#stop")
    left.click("#take")
    has(left, "#control-told", "This window controls")
    name = re.search(r"this is (window \w+)", left.inner_text("#control-told"))[1]
    has(right, "#control-told", f"{name} controls; this window watches")
    assert right.is_disabled("#start")
    right.click("#take")
    has(right, "#control-told", "This window controls")
    has(left, "#control-told", "this window watches")
    assert left.is_disabled("#start")
    assert right.is_enabled("#start")
    # A window without the token watches, and its STOP is there all the same.
    stranger = window(console.place)
    stranger.click("#take")
    has(stranger, "#refused", "open the address that the console printed")
    stranger.click("#stop")
    has(stranger, "#stop-told", "No run is being written")
    has(left, "#stop-told", "No run is being written")


def test_a_cut_link_covers_what_would_be_old_and_heals(tmp_path, start_console, window):
    logs, bench = tmp_path / "logs", short_bench(tmp_path, "[1.25, 1.35]", dwell_s=600.0)
    console = start_console(bench, logs)
    link = Link(console.port)
    page = window(console.address.replace(str(console.port), str(link.port), 1))
    start_from(page)
    has(page, "#word", "dwell")
    before_s = float(page.evaluate("held.state.at_s"))
    link.cut.set()
    has(page, "#word", "link lost")
    silent_ms = page.evaluate("performance.now() - heard")
    assert page.is_visible("#lost")
    assert page.evaluate("document.querySelector('#main').inert")
    assert page.is_enabled("#stop")
    page.keyboard.press("F8")
    has(page, "#stop-told", "NOT DELIVERED")
    link.cut.clear()
    page.wait_for_selector("#lost", state="hidden")
    has(page, "#word", "d")
    wait_for(lambda: float(page.evaluate("held.state.at_s")) > before_s, "the run as it is now")
    assert silent_ms < 60_000.0
    has(page, "#stop-told", "STOP DELIVERED")  # it was on its way, and came when the link healed
    assert ends(logs).end.stopped_by == "operator"
    link.close()


def test_a_report_is_read_within_the_page_without_its_scripts_and_the_key_of_stop_still_works(
    tmp_path, start_console, window
):
    logs = tmp_path / "logs"
    report = logs / "reports" / write_sweep(logs).name / "report.html"
    report.parent.mkdir(parents=True)
    report.write_text("<h1>a report</h1><script>parent.document.title = 'scripted'</script>")
    page = window(start_console(short_bench(tmp_path), logs).address)
    page.click("text=report.html")
    frame = page.frame_locator("#report")
    frame.locator("h1").click()
    assert page.evaluate("document.activeElement.id") == "report"
    page.keyboard.press("s")
    has(page, "#stop-told", "No run is being written")
    assert page.title() != "scripted"


def test_a_refused_start_is_told_each_time_and_taken_back_by_a_start_that_runs(tmp_path, start_console, window):
    logs, bench = tmp_path / "logs", short_bench(tmp_path, "[1.25, 1.35]", dwell_s=600.0)
    text = bench.read_text()
    page = window(start_console(bench, logs).address)
    bench.write_text("title = 1\n")  # the console has read it; what it starts will not
    start_from(page)
    has(page, "#refused", "The run did not begin: ")
    assert "Usage" not in page.inner_text("#refused")
    page.click("#refused-seen")
    start_from(page)
    page.wait_for_selector("#refused", state="visible")  # the same words once more
    bench.write_text(text)
    page.wait_for_function("() => !document.querySelector('#start').disabled")
    page.click("#start")
    page.fill("[name=relative_humidity]", "3")
    page.click("#start-now")
    assert page.is_visible("#start-dialog")  # no such humidity
    page.fill("[name=relative_humidity]", "0.4")
    page.click("#start-now")
    has(page, "#word", "dwell")
    assert page.is_hidden("#refused")
    page.keyboard.press("s")
    has(page, "#word", "stopped")
    assert "being started" not in page.inner_text("#explanation")
    assert page.locator("#alarms li").count() == 1
    assert page.locator(".figure.past").count() == 4
    assert "PAST RUN" in page.inner_text("#run-name")


def test_a_console_that_serves_others_is_seen_by_who_has_its_address_and_by_nobody_else(
    tmp_path, start_console, window
):
    write_sweep(tmp_path / "logs")
    everywhere = "0.0.0.0"  # noqa: S104 - what is tested
    console = start_console(short_bench(tmp_path), tmp_path / "logs", 0, "--listen", everywhere)
    place = f"http://127.0.0.1:{console.port}/"
    page = window(f"{place}#token={console.token}")
    page.wait_for_selector("#runs button")
    page.reload()  # without the token in the address
    page.wait_for_selector("#runs button")
    stranger = page.context.browser.new_page()  # with a storage of its own
    stranger.goto(place)
    has(stranger, "#lost-for", "open the address that the console printed")
    assert not stranger.query_selector("#runs button")
    stranger.context.close()


def test_an_import_is_shown_when_it_is_asked_for_and_not_played_again(tmp_path, start_console, window):
    logs = tmp_path / "logs"
    with RunWriter.create(logs, start_of("import")) as writer:
        writer.exchange(poll("gauge", {PRESSURE: 1.5}, 1_000_000_000))
        writer.end("finished")
    page = window(start_console(short_bench(tmp_path), logs).address)
    page.wait_for_selector("#runs tr")
    assert page.inner_text("#word").lower() == "idle"
    assert page.is_hidden("#figures")
    assert page.locator("text=Replay").count() == 0
    page.click("#runs >> text=Show")
    has(page, "#word", "imported")
    assert "imported file" in page.inner_text(".figure.past")


def test_it_fits_a_phone_and_big_figures_are_big(tmp_path, start_console, window):
    logs = tmp_path / "logs"
    write_sweep(logs)
    page = window(start_console(short_bench(tmp_path), logs).address)
    has(page, "#word", "finished")
    small = page.evaluate("document.querySelector('.value').getBoundingClientRect().height")
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.is_visible("#stop")
    page.set_viewport_size({"width": 1200, "height": 1000})
    page.keyboard.press("b")
    assert page.evaluate("document.querySelector('.value').getBoundingClientRect().height") > 2.0 * small
    assert page.is_visible("#stop")
    page.reload()
    page.wait_for_selector("body.big")  # the layout is kept
