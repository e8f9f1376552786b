"""A run followed while it is written: the same as what is read of it at the end, in bounded memory."""

import os

import numpy as np
import pytest

from rig.acquisition.derived import CHANNEL as DERIVED_CHANNEL
from rig.acquisition.derived import DEVICE as DERIVED_DEVICE
from rig.readings import Quality
from rig.runlog import RunError, RunWriter, read_run
from rig.runlog.folder import writer_of
from rig.runlog.tail import BINS, KEPT_EVENTS, SCALES, Bins, Tail
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of, write_sweep


def test_a_run_followed_to_its_end_has_the_readings_plateaus_and_events_of_the_run(tmp_path):
    folder = write_sweep(tmp_path)
    tail, run = Tail(folder), read_run(folder)
    while tail.advance(blocks=1):
        pass
    assert (tail.samples, tail.last_event, tail.state) == (len(run.samples), len(run.events), "finished")
    assert tail.plateaus == run.plateaus
    assert list(tail.events) == [event for event in run.events if event.event != "set-point"]
    speeds = run.samples[(run.samples["channel"] == SPEED) & run.samples["value"].notna()]
    assert tail.newest["speed"].value == speeds["value"].iloc[-1]
    shown = tail.bins["speed"].last(0.0, tail.now_s, 50)
    assert 10 < len(shown) <= 60
    assert (min(low for _, low, _ in shown), max(high for _, _, high in shown)) == (
        speeds["value"].min(),
        speeds["value"].max(),
    )


def test_a_growing_run_gives_what_is_new_and_a_torn_line_waits_for_its_rest(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        tail = Tail(writer.folder)
        tail.advance()
        assert (tail.samples, tail.state) == (0, "being written")
        writer.exchange(poll("gauge", {PRESSURE: 1.5}, 1_000_000_000))
        tail.advance()
        assert (tail.newest["pressure"].value, tail.newest["pressure"].time_s) == (1.5, 1.0)
        writer.exchange(poll("gauge", {PRESSURE: 1.6}, 2_000_000_000))
        whole = (writer.folder / "samples.csv").read_bytes()
        (writer.folder / "samples.csv").write_bytes(whole[:-20])
        tail.advance()
        assert tail.newest["pressure"].value == 1.5
        (writer.folder / "samples.csv").write_bytes(whole)
        tail.advance()
        assert (tail.newest["pressure"].value, tail.samples) == (1.6, 2)
    tail.advance()
    assert tail.state == "killed"


def test_a_replay_sees_nothing_of_what_comes_later(tmp_path):
    folder = write_sweep(tmp_path)
    tail, run = Tail(folder), read_run(folder)
    middle_s = run.plateaus[4].end_s + 0.01
    while tail.advance(middle_s):
        pass
    assert tail.state == "being written"
    assert tail.plateaus == run.plateaus[:5]
    assert tail.samples == int((run.samples["time_s"] <= middle_s).sum())
    assert tail.now_s <= middle_s
    tail.advance(1e9)
    assert (tail.state, len(tail.plateaus)) == ("finished", len(run.plateaus))


def test_bins_of_nothing_are_none_and_those_of_years_end_at_the_coarsest():
    assert Bins().last(0.0, 1.0) == []
    bins, day_s = Bins(), 86_400.0
    for day in range(3 * SCALES):
        bins.add(day * day_s, float(day))
    assert [low for _, low, _ in bins.last(0.0, 1000 * day_s)] == [float(day) for day in range(3 * SCALES)]


def test_a_bench_without_a_flow_meter_and_readings_without_a_role_or_a_value_are_followed(tmp_path):
    with RunWriter.create(tmp_path, start_of(roles={"speed": "tach.speed_rpm"})) as writer:
        writer.exchange(poll("tach", {SPEED: 300.0, "angle_rad": 1.0}, 1_000_000_000))
        writer.exchange(poll("tach", {SPEED: None}, 2_000_000_000, quality=Quality.TIMEOUT))
        writer.event("warning", 2_000_000_000, text="hot")
        writer.event("set-point", 2_000_000_000, pressure_bar_abs=2.0)
        tail = Tail(writer.folder)
        tail.advance()
    assert (tail.samples, set(tail.newest)) == (3, {"speed"})
    assert (tail.newest["speed"].value, tail.newest["speed"].usable) == (None, False)
    assert [low for _, low, _ in tail.bins["speed"].last(0.0, 2.0)] == [300.0]
    assert [event.event for event in tail.alarms] == [event.event for event in tail.events] == ["warning"]
    assert tail.details("course") == {}


@pytest.mark.parametrize("flow", [f"{DERIVED_DEVICE}.{DERIVED_CHANNEL}", "meter.flow_sl_min"])
def test_the_flow_is_that_at_the_inlet_and_no_standard_litres(tmp_path, flow):
    with RunWriter.create(tmp_path, start_of(roles={"flow": flow})) as writer:
        writer.exchange(poll(DERIVED_DEVICE, {DERIVED_CHANNEL: 72.0}, 1_000_000_000))
        writer.exchange(poll("meter", {"flow_sl_min": 110.0}, 2_000_000_000))
        tail = Tail(writer.folder)
        tail.advance()
    assert tail.newest["flow"].value == 72.0


def test_bins_hold_the_lowest_and_highest_of_every_stretch_in_bounded_memory():
    bins, rng = Bins(), np.random.default_rng(1)
    values = rng.normal(size=200_000)
    for i, value in enumerate(values):
        bins.add(i * 0.005, value)
    for from_s in (0.0, 900.0, 990.0):
        found = bins.last(from_s, 1000.0, 100)
        within = values[int(from_s / 0.005) :]
        assert 40 <= len(found) <= 120
        assert min(low for _, low, _ in found) == within.min() or from_s > 0.0
        assert max(high for _, _, high in found) >= within.max()
    assert sum(len(scale) for scale in bins._closed) <= BINS * len(bins._closed)


def test_a_thousand_events_are_counted_and_the_last_are_kept(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        for i in range(1000):
            writer.event("note", i, text=str(i))
        tail = Tail(writer.folder)
        tail.advance()
    assert (tail.last_event, len(tail.events)) == (1000, KEPT_EVENTS)


def _with_cell(data: bytes, cell: int, value: bytes) -> bytes:
    """The samples with another cell in the third row."""
    lines = data.split(b"\n")
    cells = lines[3].split(b",")
    lines[3] = b",".join([*cells[:cell], value, *cells[cell + 1 :]])
    return b"\n".join(lines)


@pytest.mark.parametrize(
    "damaged",
    [
        lambda data: data + b"no,row\n",
        lambda data: _with_cell(data, 4, b"1_000"),
        lambda data: _with_cell(data, 4, b"nan"),
        lambda data: _with_cell(data, 6, b"great"),
        lambda data: _with_cell(data, 8, b"1e3"),
        lambda data: _with_cell(data, 12, b"many"),
        lambda data: _with_cell(data, 0, b"4"),
        lambda data: _with_cell(data, 3, b"\xff"),
        lambda data: _with_cell(data, 13, b"\0"),
        lambda data: b"m" + data[1:],
    ],
)
def test_whatever_is_refused_of_a_run_is_refused_of_a_run_that_is_followed(tmp_path, damaged):
    folder = write_sweep(tmp_path)
    samples = folder / "samples.csv"
    samples.write_bytes(damaged(samples.read_bytes()))
    with pytest.raises(RunError) as of_run:
        read_run(folder)
    tail = Tail(folder)
    for _ in range(2):
        with pytest.raises(RunError) as followed:
            while tail.advance():
                pass
        assert str(followed.value) == str(of_run.value)


def test_an_event_that_is_not_in_order_is_refused_of_a_run_that_is_followed(tmp_path):
    folder = write_sweep(tmp_path)
    events = folder / "events.jsonl"
    lines = events.read_bytes().splitlines(keepends=True)
    events.write_bytes(b"".join([lines[0], *lines[2:]]))
    tail = Tail(folder)
    for _ in range(2):
        with pytest.raises(RunError, match=r"events\.jsonl, line 2: its number is 3"):
            tail.advance()


def test_the_lock_names_the_program_that_writes(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        assert writer_of(writer.folder) == os.getpid()
    assert writer_of(writer.folder) is None
