"""A whole sweep over real bytes: the virtual bench at four times real time, the real acquisition, a real run log."""

import os
import re
import signal
import sys
import threading
import time

import numpy as np
import pytest

from model.motor import read_motor
from model.operation.performance import operating_points
from rig.bench.bench import FOLDER
from rig.readings import NS
from rig.run.running import Wanted, take
from rig.runlog import read_run
from rig.sweep.ambient import Given
from rig.sweep.planning import sweep_course
from rig.virtual.launch import launch

MOTOR = read_motor("ptm3600")


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    text = (FOLDER / "virtual.toml").read_text()
    text = re.sub(r"levels_bar_abs = .*", "levels_bar_abs = [1.36, 1.9]\nzero_s = 2.0", text)
    text = text.replace("window_s = 3.0", "window_s = 2.0").replace("dwell_s = 5.0", "dwell_s = 3.0")
    text = re.sub(r"captures = .*", 'captures = ["coast-down"]', text)
    path = folder / "virtual.toml"
    path.write_text(text)
    # Faster, the coast-down is over within a pause of a busy machine.
    made, outcome = take(path, Given(minutes_running=0.0), sweep_course, Wanted("sweep", folder / "logs", rate=4.0))
    return read_run(made), outcome


def test_the_sweep_finishes_vented_with_every_level_on_both_legs(swept):
    _, outcome = swept
    assert (outcome.outcome, outcome.reason, outcome.vented) == ("finished", "", True)
    taken = [(p.step.level_bar_abs, p.step.direction) for p in outcome.plateaus if "guard" not in p.note]
    assert taken == [(1.36, "up"), (1.9, "up"), (1.9, "down"), (1.36, "down")]


def test_the_plateaus_are_what_the_motor_does_within_what_the_gauge_is_off_by(swept):
    run_, _ = swept
    for plateau in run_.plateaus:
        assert plateau.settled, plateau.note
        pressure, speed = plateau.means["pressure_bar_abs"], plateau.means["speed_rpm"]
        if speed.mean == 0.0:  # near its lowest pressure the motor runs on, and does not start from every angle
            assert plateau.direction == "up"
            assert pressure.mean < 1.4
            continue
        low, high = (p.speed_rpm for p in operating_points(MOTOR, [(pressure.mean + d) * 1e5 for d in (-0.02, 0.02)]))
        assert low < speed.mean < high
        assert 0.0 < speed.se < 2.0


def test_the_regulator_is_set_to_zero_last(swept):
    run_, _ = swept
    writes = [exchange.argument for _, exchange in run_.exchanges() if exchange.action == "write"]
    assert max(writes) > 0.9
    assert writes[-1] == 0.0


def test_the_zeros_and_the_states_are_in_the_log(swept):
    run_, _ = swept
    zeros = [event.details for event in run_.events if event.event == "zero"]
    assert [zero["which"] for zero in zeros] == ["start", "end"]
    assert zeros[0]["channels"]["gauge.pressure_bar_abs"]["mean"] == pytest.approx(1.01325, abs=0.05)
    states = [event.details["state"] for event in run_.events if event.event == "state"]
    assert {"zero", "ramp", "settle", "dwell", "capture", "vent", "done"} <= set(states)


def test_the_gauge_is_polled_as_fast_as_its_line_bears_in_the_coast_down_and_not_beside(swept):
    run_, _ = swept
    (event,) = [event.details for event in run_.events if event.event == "capture end"]
    samples = run_.samples
    gauge = samples[(samples["device"] == "gauge") & (samples["channel"] == "pressure_bar_abs")]["time_s"].to_numpy()
    seconds = event["end_s"] - event["start_s"]
    within = gauge[(gauge >= event["start_s"]) & (gauge <= event["end_s"])]
    before = gauge[gauge < event["start_s"]]
    before = before[-max(7, np.count_nonzero(before >= event["start_s"] - seconds)) :]
    assert event["pressure_hz"] == pytest.approx(within.size / seconds, rel=0.2)
    # A busy machine pauses, but not all the time. At 10 Hz seven polls in a row take at least 0.5 s.
    quickest_s, usual_s = (float(np.min(times[6:] - times[:-6])) for times in (within, before))
    assert quickest_s < 0.45 < usual_s
    assert event["speed_hz"] > 0.0
    dac = samples[(samples["device"] == "dac") & samples["value"].notna()]["time_s"]
    assert ((dac > event["start_s"]) & (dac < event["end_s"])).any()


def test_the_coast_down_has_every_tooth(swept):
    run_, _ = swept
    (event,) = [event.details for event in run_.events if event.event == "capture end"]
    samples = run_.samples
    within = (samples["time_ns"] > event["start_s"] * NS) & (samples["time_ns"] < event["end_s"] * NS)
    turning = samples[within & (samples["channel"] == "speed_rpm") & (samples["value"] > 40.0)]
    assert turning["value"].max() > 300.0
    assert turning["value"].iloc[-5:].min() < 100.0
    assert set(turning["raw"].iloc[1:].str.partition(" in ")[0]) == {"1 edge"}
    # On a busy machine the bench may have slowed down before it is told that it was ordered to.
    slowing = turning[turning["value"] < 0.9 * turning["value"].max()]
    assert len(slowing) >= 20


@pytest.mark.long
@pytest.mark.slow
def test_a_bench_that_stands_still_for_seconds_on_a_busy_machine_loses_no_sweep(tmp_path, monkeypatch):
    """Stopped under pressure, so that gauge, regulator and tachometer all go unanswered.

    Faster, the stop and what the drivers wait would take most of the minute that a level has to settle.
    """
    text = (FOLDER / "virtual.toml").read_text()
    text = re.sub(r"levels_bar_abs = .*", "levels_bar_abs = [1.5]\nzero_s = 2.0", text)
    text = text.replace('order = "up-down"', 'order = "up"')
    text = text.replace("dwell_s = 5.0", "dwell_s = 60.0")
    path = tmp_path / "virtual.toml"
    path.write_text(re.sub(r"captures = .*", "captures = []", text))
    paused = threading.Event()
    started = launch

    def launched(*arguments, **options):
        bench = started(*arguments, **options)

        def pause():
            while not bench.control({"do": "state"})["pressure_bar_abs"] > 1.49:
                time.sleep(0.1)
            os.kill(bench.process.pid, signal.SIGSTOP)
            time.sleep(2.5)
            os.kill(bench.process.pid, signal.SIGCONT)
            paused.set()

        threading.Thread(target=pause, daemon=True).start()
        return bench

    monkeypatch.setattr(sys.modules["rig.virtual.launch"], "launch", launched)
    made, outcome = take(path, Given(minutes_running=0.0), sweep_course, Wanted("sweep", tmp_path / "logs", rate=8.0))
    assert (outcome.outcome, outcome.reason, outcome.vented) == ("finished", "", True)
    assert paused.is_set()
    assert (read_run(made).samples["quality"] == "timeout").any()
