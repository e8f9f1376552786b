"""A run as a recording and as a Parquet file."""

import dataclasses
import hashlib
import json
import math
import subprocess
import sys

import numpy as np
import pytest

from rig.exchange.export import export_recording, recording_of
from rig.exchange.samples.export import export_samples
from rig.readings import NS, Exchange, Quality
from rig.recording import RecordingError, SupplyFigures, read_recording
from rig.runlog import RunError, RunWriter, read_run
from rig.runlog.schema import AmbientRecord, ChannelRecord, DeviceRecord, SourceRecord, SupplyRecord
from tests.synthetic_runs import FLOW, PRESSURE, SPEED, SWEEP, Bench, poll, reading, start_of, write_sweep


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return read_run(write_sweep(tmp_path_factory.mktemp("runs")))


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported") / "recording"
    made = export_recording(run, folder)
    return read_recording(folder), made, folder


def file_of(recording, name):
    return next(file for file in recording.files if file.file == name)


def written(root, fill, **changes):
    """A killed run that `fill` wrote through a bench."""
    with RunWriter.create(root, start_of(**changes)) as writer:
        fill(Bench(writer))
    return read_run(writer.folder)


def test_plateaus_become_the_steady_file(exported):
    steady = file_of(exported[0], "sweep.csv")
    assert (steady.kind, steady.rows, steady.noise_scale) == ("steady", 14, 1.0)
    assert list(steady.direction) == ["up"] * 7 + ["down"] * 7
    pressure, flow, speed = (steady.columns[name].values for name in ("pressure_bar_abs", "flow_l_min", "speed_rpm"))
    expected = np.array([*SWEEP, *reversed(SWEEP)])
    np.testing.assert_allclose(pressure, expected[:, 0], atol=0.0015)
    np.testing.assert_allclose(flow, expected[:, 1], atol=0.5)
    np.testing.assert_allclose(speed, expected[:, 2], atol=0.4)
    assert steady.columns["inlet_temperature_c"].values == pytest.approx([20.5] * 14, abs=0.05)


def test_a_run_is_the_same_recording_written_or_not(run, exported):
    direct = recording_of(run).recording
    assert direct.channels == exported[0].channels
    assert direct.ambient == exported[0].ambient
    for ours, theirs in zip(direct.files, exported[0].files, strict=True):
        assert (ours.file, ours.kind, ours.rows, list(ours.columns)) == (
            theirs.file,
            theirs.kind,
            theirs.rows,
            list(theirs.columns),
        )
        for name in ours.columns:
            np.testing.assert_array_equal(ours.columns[name].values, theirs.columns[name].values)
            np.testing.assert_array_equal(ours.columns[name].censor, theirs.columns[name].censor)


def test_runs_with_other_readings_have_other_digests(run, tmp_path):
    other = read_run(write_sweep(tmp_path, captures=False))
    assert recording_of(run).recording.sha256 == recording_of(run).recording.sha256
    assert recording_of(run).recording.sha256 != recording_of(other).recording.sha256


def test_means_are_exported_to_the_bit(run, exported):
    steady = file_of(exported[0], "sweep.csv")
    assert list(steady.columns["speed_rpm"].values) == [plateau.means["speed_rpm"].mean for plateau in run.plateaus]


def test_figures_come_from_the_instruments_and_noise_from_the_plateaus(exported):
    flow = exported[0].channels["flow_l_min"]
    assert (flow.bias_sd, flow.scale_sd, flow.resolution, flow.defaulted) == (0.5, 0.02, 0.5, ())
    assert flow.noise_sd == pytest.approx(0.5 / np.sqrt(30))


def test_what_a_run_does_not_say_of_supply_and_speed_is_left_out(exported):
    speed = exported[0].channels["speed_rpm"]
    assert (speed.pulses_per_rev, speed.pitch_error_sd, speed.window_s, speed.lag_s) == (None, None, None, None)
    assert exported[0].supply == SupplyFigures()


def test_the_supply_and_how_a_speed_is_made_go_with_the_export(tmp_path):
    start = start_of()
    made = {"pulses_per_rev": 60.0, "pitch_error_sd": 0.008, "window_s": 0.5, "lag_s": 0.1}
    speed = start.devices["tach"].channels[SPEED].model_copy(update=made)
    tach = start.devices["tach"].model_copy(
        update={"channels": {SPEED: speed}, "serial_number": "T-7", "calibration": "2026-01-05"}
    )
    supply = SupplyRecord(regulator_time_s=0.3, regulator_time_s_sd=0.1, line_volume_l=0.2)
    run = written(
        tmp_path,
        lambda bench: bench.plateau(1, SWEEP[0], "up"),
        devices=start.devices | {"tach": tach},
        supply=supply,
        lubrication="none",
        motor_serial="A-17",
        note="n" * 5000,
        parent="an_earlier_run",
    )
    export_recording(run, tmp_path / "recording")
    for recording in (read_recording(tmp_path / "recording"), recording_of(run).recording):
        channel = recording.channels["speed_rpm"]
        assert {name: getattr(channel, name) for name in made} == made
        assert (channel.serial, channel.calibrated) == ("T-7", "2026-01-05")
        assert recording.supply == SupplyFigures(regulator_time_s=0.3, regulator_time_s_sd=0.1, line_volume_l=0.2)
        assert (recording.origin["operator"], recording.origin["oil"]) == ("a test", "none")
        assert recording.origin["date"] == start.utc_start
        assert (recording.origin["motor_serial"], recording.origin["parent"]) == ("A-17", "an_earlier_run")
        assert len(recording.origin["note"]) <= 2000
        assert recording.origin["note"].endswith(f"nnn; run {run.name}, bench {start.bench}")


def test_a_replay_has_no_parent_for_it_holds_the_same_readings(tmp_path):
    run = written(tmp_path, lambda bench: bench.plateau(1, SWEEP[0], "up"), kind="replay", parent="what_it_replays")
    assert "parent" not in recording_of(run).recording.origin


def test_zero_phases_become_the_zero_file_a_row_each(exported):
    zero = file_of(exported[0], "zero.csv")
    assert (zero.kind, zero.rows) == ("zero", 2)
    assert zero.columns["pressure_bar_abs"].values == pytest.approx([1.013, 1.013], abs=0.003)
    assert list(zero.columns["speed_rpm"].censor) == [-1, -1]
    assert zero.noise_scale > 1.0  # ten readings and not thirty


def test_captures_become_transients_with_each_channel_at_its_own_times(exported):
    for name, opens in (("coast_down.csv", False), ("spin_up.csv", True)):
        file = file_of(exported[0], name)
        speed, pressure = file.columns["speed_rpm"].values, file.columns["pressure_bar_abs"].values
        assert file.kind == "transient"
        assert np.isnan(pressure[~np.isnan(speed)]).mean() > 0.9  # the gauge is slower and has rows of its own
        assert (~np.isnan(pressure)).sum() >= 15
        assert file.noise_scale == pytest.approx(np.sqrt(30))  # single readings against means of thirty
        supply, time_s = file.columns["supply_open"].values, file.columns["time_s"].values
        assert ((supply == 1.0) == (time_s >= 0.5 if opens else time_s < 0.5)).all()
    assert file_of(exported[0], "spin_up.csv").start_s == 44.5


def test_the_room_is_that_of_start_and_end(exported):
    ambient = exported[0].ambient
    assert ambient.pressure_bar_abs == pytest.approx(1.0132)
    assert (ambient.pressure_sd_bar, ambient.temperature_c) == (0.0015, pytest.approx(20.2))
    assert ambient.temperature_sd_k == pytest.approx(0.2)


def test_nothing_in_the_export_is_unknown_or_left_to_a_default(exported):
    assert exported[0].warnings == ()
    assert "simulated" in (exported[2] / "notes.txt").read_text()


def test_what_a_run_leaves_out_is_told_as_of_the_recording_made_of_it(tmp_path):
    devices = dict(start_of().devices)
    channels = {FLOW: devices["meter"].channels[FLOW].model_copy(update={"bias_sd": None})}
    devices["meter"] = devices["meter"].model_copy(update={"channels": channels})
    run = written(tmp_path, lambda bench: bench.plateau(1, SWEEP[0], "up"), devices=devices, ambient=AmbientRecord())
    export_recording(run, tmp_path / "recording")
    told = recording_of(run).recording.warnings
    assert told == read_recording(tmp_path / "recording").warnings
    assert [words.partition(" (")[0] for words in told] == [
        "[channels.flow_l_min] leaves out bias_sd",
        "[ambient] leaves out pressure_bar_abs",
    ]


def test_an_off_scale_plateau_stays_censored(tmp_path):
    def fill(bench):
        bench.plateau(1, SWEEP[0], "up", flow_l_min="<45", flow_l_min_se=None)
        bench.plateau(2, SWEEP[1], "up", flow_l_min=">50", flow_l_min_se=None)

    export_recording(written(tmp_path, fill), tmp_path / "recording")
    flow = file_of(read_recording(tmp_path / "recording"), "sweep.csv").columns["flow_l_min"]
    assert (list(flow.values), list(flow.censor)) == ([45.0, 50.0], [-1, 1])


def test_plateaus_that_had_not_settled_are_left_out_unless_asked_for(tmp_path):
    def fill(bench):
        bench.plateau(1, SWEEP[0], "up")
        bench.plateau(2, SWEEP[1], "up", settled=False, note="drifting")

    found = written(tmp_path, fill)
    without, with_it = recording_of(found), recording_of(found, unsettled=True)
    assert (without.recording.files[0].rows, with_it.recording.files[0].rows) == (1, 2)
    assert "plateau 2: left out, not settled (drifting)" in without.notes


def test_unusable_and_unverified_readings_are_counted_in_the_notes(tmp_path):
    def fill(bench):
        bench.plateau(1, SWEEP[0], "up")
        for quality in (Quality.TIMEOUT, Quality.OVER_RANGE, Quality.UNVERIFIED):
            value = None if quality is Quality.TIMEOUT else 44.0
            bench.writer.exchange(poll("meter", {FLOW: value}, bench.time_ns, quality=quality))

    notes = recording_of(written(tmp_path, fill)).notes
    assert "flow_l_min (meter.flow_l_min): of 33 readings in the plateaus, 2 unusable and 1 unverified" in notes


def test_unusable_readings_are_not_in_a_transient(tmp_path):
    def fill(bench):
        for step in range(5):
            bad = step == 2
            bench.writer.exchange(poll("gauge", {PRESSURE: 2.0}, step * NS))
            quality = Quality.CRC if bad else Quality.OK
            bench.writer.exchange(poll("tach", {SPEED: None if bad else 100.0}, step * NS, quality=quality))
        bench.writer.event("capture end", 5 * NS, capture="coast-down", start_s=0.0, end_s=5.0)

    (file,) = recording_of(written(tmp_path, fill, kind="coast-down")).recording.files
    assert list(np.isnan(file.columns["speed_rpm"].values)) == [False, False, True, False, False]


@pytest.mark.parametrize("text", ["update_s = 3.0\n", "\ufeffupdate_s = 3.0\r\n"])  # as Windows editors write it
def test_what_a_slow_gauge_only_repeats_is_not_in_a_transient(tmp_path, text):
    held = {"instruments/slow.toml": SourceRecord(sha256=hashlib.sha256(text.encode()).hexdigest(), text=text)}
    gauge = start_of().devices["gauge"].model_copy(update={"instrument": "slow"})

    def fill(bench):
        for step, pressure in enumerate((2.0, 2.0, 2.0, 2.0, 1.5, 1.5)):
            bench.writer.exchange(poll("gauge", {PRESSURE: pressure}, step * NS))
            bench.writer.exchange(poll("tach", {SPEED: 100.0}, step * NS))
        bench.writer.event("capture end", 6 * NS, capture="coast-down", start_s=0.0, end_s=6.0)

    devices = start_of().devices | {"gauge": gauge}
    run = written(tmp_path, fill, kind="coast-down", devices=devices, sources=held)
    (file,) = recording_of(run).recording.files
    assert list(np.isnan(file.columns["pressure_bar_abs"].values)) == [False, True, True, False, False, True]


def test_what_a_slow_gauge_shows_is_of_the_moment_of_its_update(tmp_path):
    """It measures at 1, 4, 7 s and shows the same at the first two; the capture begins at 2 s."""
    text = "update_s = 3.0\n"
    held = {"instruments/slow.toml": SourceRecord(sha256=hashlib.sha256(text.encode()).hexdigest(), text=text)}
    gauge = start_of().devices["gauge"].model_copy(update={"instrument": "slow"})

    def fill(bench):
        for step, pressure in enumerate((1.02, 1.01, 1.01, 1.01, 1.01, 1.01, 1.01, 1.9, 1.9)):
            bench.writer.exchange(poll("gauge", {PRESSURE: pressure}, step * NS))
            bench.writer.exchange(poll("tach", {SPEED: 100.0}, step * NS))
        bench.writer.event("capture end", 9 * NS, capture="spin-up", start_s=2.0, end_s=9.0)

    devices = start_of().devices | {"gauge": gauge}
    (file,) = recording_of(written(tmp_path, fill, kind="spin-up", devices=devices, sources=held)).recording.files
    pressure = file.columns["pressure_bar_abs"].values
    known = np.isfinite(pressure)
    assert (file.start_s + file.columns["time_s"].values[known]).tolist() == pytest.approx([2.0, 4.0, 7.0])
    assert pressure[known].tolist() == [1.01, 1.01, 1.9]


def test_a_pressure_whose_reply_came_late_is_not_in_a_transient(tmp_path):
    """It was measured at any moment since the request, and a line that fills moves on meanwhile."""

    def fill(bench):
        for step in range(6):
            exchange = poll("gauge", {PRESSURE: 1.0 + 0.1 * step}, step * NS)
            (one,) = exchange.readings
            asked_ns = step * NS - (NS if step == 3 else 5_000_000)
            late = dataclasses.replace(one, request_ns=asked_ns, reply_ns=step * NS + 5_000_000)
            bench.writer.exchange(exchange.with_readings((late,)))
            bench.writer.exchange(poll("tach", {SPEED: 100.0 + step}, step * NS))
        bench.writer.event("capture end", 6 * NS, capture="spin-up", start_s=0.0, end_s=6.0)

    made = recording_of(written(tmp_path, fill, kind="spin-up"))
    (file,) = made.recording.files
    assert list(np.isnan(file.columns["pressure_bar_abs"].values)) == [False, False, False, True, False, False]
    assert any("1 readings left out, their replies came late" in note for note in made.notes)


@pytest.mark.parametrize("blow", ["a late reply", "a long pause"])
def test_a_held_value_that_nobody_knows_the_moment_of_is_not_in_a_transient(tmp_path, blow):
    """First shown in a late reply or after a long pause, it is no news when it is shown again."""
    text = "update_s = 3.0\n"
    held = {"instruments/slow.toml": SourceRecord(sha256=hashlib.sha256(text.encode()).hexdigest(), text=text)}
    gauge = start_of().devices["gauge"].model_copy(update={"instrument": "slow"})
    pause = 4 if blow == "a long pause" else 0

    def fill(bench):
        for step, pressure in enumerate((2.0, 2.0, 2.0, 1.5, 1.5, 1.2)):
            at = (step + (pause if step >= 3 else 0)) * NS
            exchange = poll("gauge", {PRESSURE: pressure}, at)
            (one,) = exchange.readings
            asked_ns = at - (NS if step == 3 and not pause else 5_000_000)
            bench.writer.exchange(exchange.with_readings((dataclasses.replace(one, request_ns=asked_ns),)))
            bench.writer.exchange(poll("tach", {SPEED: 100.0}, at))
        bench.writer.event("capture end", 10 * NS, capture="coast-down", start_s=0.0, end_s=10.0)

    devices = start_of().devices | {"gauge": gauge}
    made = recording_of(written(tmp_path, fill, kind="coast-down", devices=devices, sources=held))
    (file,) = made.recording.files
    assert list(np.isnan(file.columns["pressure_bar_abs"].values)) == [False, True, True, True, True, False]
    assert any("1 readings left out" in note for note in made.notes)


def test_after_lost_edges_a_speed_is_the_mean_since_the_reading_before(tmp_path):
    """The counter tells the last tooth's alone; its count of teeth, which it keeps, tells the mean."""
    times, tooth = [0.0, 0.1, 0.19, 0.26], 2.0 * math.pi / 60.0  # each tooth quicker than the one before

    def fill(bench):
        for number, (moment, rpm) in enumerate(zip(times, (9.0, 10.0, 11.1, 14.3), strict=True)):
            if number == 2:
                continue  # lost
            readings = {SPEED: rpm, "angle_rad": tooth * number}
            bench.writer.exchange(poll("gauge", {PRESSURE: 2.0 + 0.01 * number}, round(moment * NS)))
            bench.writer.exchange(poll("tach", readings, round(moment * NS)))
        bench.writer.event("capture end", NS, capture="coast-down", start_s=0.0, end_s=1.0)

    (file,) = recording_of(written(tmp_path, fill, kind="coast-down")).recording.files
    assert list(file.columns["speed_rpm"].values) == pytest.approx([9.0, 10.0, 2.0 / 0.16])


@pytest.mark.parametrize(
    ("which", "changes", "words"),
    [
        ("spin-up", {"gauge_until": 110}, "spin_up.csv: no reading of the pressure from 0.50 to 1.50 s"),
        ("coast-down", {"lowest": 1.2}, "coast_down.csv: ends before the line is vented: the gauge showed 1.200 bar"),
        ("coast-down", {"cut_short": True}, "coast_down.csv: the run ended within this capture"),
    ],
)
def test_what_is_missing_in_a_capture_is_in_the_notes(tmp_path, which, changes, words):
    made = export_recording(written(tmp_path, lambda bench: bench.capture(which, **changes)), tmp_path / "recording")
    assert any(note.startswith(words) for note in made.notes)
    assert [file.kind for file in read_recording(tmp_path / "recording").files] == ["transient"]


@pytest.mark.parametrize(
    ("read_s", "words"),
    [
        ((0.0, 1.4), "no reading of the pressure from 0.00 to 1.40 s"),
        ((0.0, 0.1, 0.2, 0.3, 0.4, 0.85, 1.0, 1.1, 1.2, 1.3, 1.4), "no reading of the pressure from 0.40 to 0.85 s"),
    ],
)
def test_a_gauge_that_was_not_read_while_the_rotor_slowed_is_in_the_notes(tmp_path, read_s, words):
    """However seldom it was read before and after."""
    gauge = start_of().devices["gauge"].model_copy(update={"period_s": 0.1})

    def fill(bench):
        for moment in read_s:
            bench.writer.exchange(poll("gauge", {PRESSURE: 2.0 if moment <= 0.5 else 1.013}, round(moment * NS)))
        bench.capture("coast-down", gauge_until=0)

    run = written(tmp_path, fill, kind="coast-down", devices=start_of().devices | {"gauge": gauge})
    assert any(note.startswith(f"coast_down.csv: {words}") for note in recording_of(run).notes)


def test_a_whole_capture_needs_no_note(exported):
    assert not any(note.startswith(("spin_up", "coast_down")) for note in exported[1].notes)


def test_standard_litres_are_exported_as_the_flow_derived_from_them(tmp_path):
    meter = ChannelRecord(unit="sL/min", noise_sd=0.5, bias_sd=0.6, scale_sd=0.01, resolution=0.1)
    devices = start_of().devices | {"meter": DeviceRecord(channels={"flow_sl_min": meter})}
    roles = start_of().roles | {"flow": "meter.flow_sl_min"}

    def fill(bench):
        for step in range(10):
            bench.writer.exchange(poll("gauge", {PRESSURE: 2.0}, step * NS))
            read = (
                reading("meter", "flow_sl_min", 100.0, step * NS),
                reading("derived", "flow_l_min", 54.0, step * NS),
            )
            bench.writer.exchange(Exchange("net", "meter", "poll", None, (), read))
        row = {"n": 1, "start_s": 0.0, "end_s": 9.0, "pressure_bar_abs": 2.0, "flow_l_min": 54.0}
        bench.writer.plateau(row)

    made = recording_of(written(tmp_path, fill, roles=roles, devices=devices)).recording
    assert list(made.files[0].columns["flow_l_min"].values) == [54.0]
    assert made.channels["flow_l_min"].bias_sd == pytest.approx(0.6 * 0.54)
    assert made.channels["flow_l_min"].scale_sd == pytest.approx(np.hypot(0.01, 2.0 / 293.0))


def test_a_zero_phase_that_was_not_vented_is_left_out(tmp_path):
    def fill(bench):
        bench.plateau(1, SWEEP[0], "up")
        bench.writer.event("zero", bench.time_ns, start_s=0.0, end_s=3.0, vented=False)

    made = recording_of(written(tmp_path, fill))
    assert [file.kind for file in made.recording.files] == ["steady"]
    assert any("not vented" in note for note in made.notes)


def test_a_plateau_whose_rotor_came_to_rest_in_it_is_left_out(tmp_path):
    def fill(bench):
        bench.plateau(1, SWEEP[0], "up")
        bench.writer.plateau({"n": 2, "pressure_bar_abs": 1.25, "speed_rpm": 3e-4, "speed_rpm_se": 3e-4})

    made = recording_of(written(tmp_path, fill))
    assert len(made.recording.files[0].columns["speed_rpm"].values) == 1
    assert any("plateau 2: left out, the rotor stood still" in note for note in made.notes)


def test_a_run_with_nothing_usable_says_what_is_missing(tmp_path):
    def fill(bench):
        bench.writer.plateau({"n": 1, "speed_rpm": 100.0})

    with pytest.raises(RunError, match=r"nothing to export: 1 plateaus written, of which 0 can be used.*no pressure"):
        recording_of(written(tmp_path, fill))


def test_a_run_that_is_being_written_is_not_exported(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        Bench(writer).plateau(1, SWEEP[0], "up")
        found = read_run(writer.folder)
        with pytest.raises(RunError, match="a program writes this run now"):
            export_recording(found, tmp_path / "recording")
        with pytest.raises(RunError, match="is being written"):
            export_samples(found, tmp_path / "run.parquet")


def test_nothing_is_overwritten(run, exported, tmp_path):
    with pytest.raises(RecordingError, match="exists already"):
        export_recording(run, exported[2])
    (tmp_path / "run.parquet").write_text("mine")
    with pytest.raises(RunError, match="exists already"):
        export_samples(run, tmp_path / "run.parquet")
    assert (tmp_path / "run.parquet").read_text() == "mine"


def test_a_parquet_file_holds_the_samples_and_the_records(run, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    export_samples(run, tmp_path / "run.parquet")
    table = pq.read_table(tmp_path / "run.parquet")
    found = table.to_pandas()
    assert list(found.columns) == list(run.samples.columns)
    for name in run.samples:
        assert found[name].tolist() == run.samples[name].tolist() or name == "value"
    np.testing.assert_array_equal(found["value"].to_numpy(), run.samples["value"].to_numpy())
    assert found["time_ns"].dtype == np.int64
    assert json.loads(table.schema.metadata[b"start.json"])["bench"] == "synthetic"
    assert json.loads(table.schema.metadata[b"end.json"])["outcome"] == "finished"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.parquet"]


def test_a_killed_run_becomes_no_parquet_file(tmp_path):
    found = written(tmp_path, lambda bench: bench.plateau(1, SWEEP[0], "up"))
    with pytest.raises(RunError, match=r"only a sealed run becomes a \.parquet file"):
        export_samples(found, tmp_path / "run.parquet")


def test_without_pyarrow_the_error_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(RunError, match="needs the package pyarrow"):
        export_samples(run, tmp_path / "run.parquet")


NAMING = """
import os, sys
from pathlib import Path
from rig.exchange.export import export_recording
from rig.runlog import read_run
run, out = map(Path, sys.argv[1:])
def look(event, what):
    if event == "os.rename" and str(what[1]) == str(out):
        print(*sorted(os.listdir(what[0])))
sys.addaudithook(look)
export_recording(read_run(run), out)
"""


def test_a_recording_gets_its_name_when_all_of_it_is_there_the_notes_too(run, tmp_path):
    out = tmp_path / "recording"
    done = subprocess.run(
        [sys.executable, "-c", NAMING, run.folder, out], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.split() == sorted(path.name for path in out.iterdir())
    assert "notes.txt" in done.stdout
