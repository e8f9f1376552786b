"""Replay: the logged bytes through the same drivers, bit for bit; killed, mended and broken runs."""

import re
import shutil
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from configs import find
from model.motor import read_motor
from model.operation.performance import OperatingPointError
from model.operation.replayed import drive
from model.solvers.steady import steady
from rig.bench.bench import FOLDER
from rig.readings import Event
from rig.replay.player import Player, ReplayPort
from rig.replay.replaying import bench_of_run, mended_bench, replay
from rig.replay.saving import retake_plateaus, writer_for
from rig.run.running import Wanted, take
from rig.runlog import RunError, RunWriter, read_run, verify
from rig.sweep.ambient import Given
from rig.sweep.planning import sweep_course
from spinbench.cli.replay import _against_model
from tests.synthetic_runs import poll, start_of

MOTOR = read_motor("ptm3600")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A short sweep on the virtual bench."""
    folder = tmp_path_factory.mktemp("replay")
    text = (FOLDER / "virtual.toml").read_text()
    text = re.sub(r"levels_bar_abs = .*", "levels_bar_abs = [1.4]\nzero_s = 2.0", text)
    text = text.replace("window_s = 3.0", "window_s = 2.0").replace("dwell_s = 5.0", "dwell_s = 2.0")
    path = folder / "virtual.toml"
    path.write_text(re.sub(r"captures = .*", 'captures = ["coast-down"]', text))
    made, outcome = take(path, Given(minutes_running=0.0), sweep_course, Wanted("sweep", folder / "logs", rate=10.0))
    assert outcome.outcome == "finished"
    return made


@pytest.fixture
def copied(run_folder, tmp_path):
    """A copy of it that a test may spoil."""
    return shutil.copytree(run_folder, tmp_path / run_folder.name)


def test_a_replay_gives_the_same_samples_bit_for_bit(run_folder):
    found = replay(read_run(run_folder))
    assert found.same
    assert found.samples == found.logged > 500


def test_a_replay_does_not_depend_on_todays_instrument_files(run_folder):
    assert bench_of_run(read_run(run_folder)).instruments["flowmeter"].channels["flow_sl_min"].scale == 0.001


def test_one_changed_byte_on_the_wire_changes_a_sample(copied):
    lines = (copied / "wire.jsonl").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if '"device":"flowmeter"' in line and '"action":"poll"' in line)
    damaged = re.sub(r'(\["rx",\d+,"[0-9a-f]{20})(..)', lambda m: m[1] + f"{int(m[2], 16) ^ 1:02x}", lines[at], count=1)
    assert damaged != lines[at]
    (copied / "wire.jsonl").write_text("\n".join([*lines[:at], damaged, *lines[at + 1 :]]) + "\n")
    found = replay(read_run(copied))
    assert not found.same
    assert found.different >= 1
    assert "flowmeter" in found.differences[0]


def test_a_killed_run_replays_and_its_torn_row_is_the_only_one_missing(copied):
    (copied / "end.json").unlink()
    samples = (copied / "samples.csv").read_bytes()
    (copied / "samples.csv").write_bytes(samples[:-7])
    found = replay(read_run(copied))
    assert found.same
    assert found.tail == 1


def test_a_mended_instrument_file_of_the_project_decodes_the_old_bytes_anew(run_folder, tmp_path, monkeypatch):
    instruments = tmp_path / "project" / "instruments"
    instruments.mkdir(parents=True)
    (tmp_path / "project" / "spinbench.toml").write_text('format = "project/1"\n')
    monkeypatch.chdir(tmp_path / "project")
    text = (FOLDER.parent / "instruments" / "siargo_mf5700.toml").read_text()
    (instruments / "siargo_mf5700.toml").write_text(
        text.replace("scale = 0.001 ", "scale = 0.002 ").replace("scale = 0.001\n", "scale = 0.002\n")
    )
    run = read_run(run_folder)
    bench = mended_bench(run, ["siargo_mf5700"], partial(find, "instruments"))
    with writer_for(run, bench, tmp_path / "logs") as writer:
        found = replay(run, bench, writer)
        retake_plateaus(run, writer)
        writer.end("finished")
    assert found.different > 0
    new = read_run(writer.folder)
    assert (new.start.kind, new.start.parent) == ("replay", run.name)
    assert verify(writer.folder) == []
    values = [one.samples[one.samples["channel"] == "flow_sl_min"]["value"].to_numpy() for one in (run, new)]
    np.testing.assert_allclose(values[1], 2.0 * values[0], atol=1e-9)
    for old, taken in zip(run.plateaus, new.plateaus, strict=True):
        assert taken.means["speed_rpm"].mean == pytest.approx(old.means["speed_rpm"].mean, rel=1e-6)
        assert taken.means["flow_l_min"].mean == pytest.approx(2.0 * old.means["flow_l_min"].mean, rel=1e-6)


def test_an_instrument_that_the_run_has_not_is_told(run_folder):
    with pytest.raises(RunError, match="no device of this run is a 'lutron_tachometer'"):
        mended_bench(read_run(run_folder), ["lutron_tachometer"], partial(find, "instruments"))
    with pytest.raises(RunError, match=r"siargo_mf5700\.toml: no such file in the project's instruments"):
        mended_bench(read_run(run_folder), ["siargo_mf5700"], lambda name: None)


def test_mended_samples_are_compared_with_the_model_once_they_are_a_run(run_folder, tmp_path, spinbench_here):
    done = spinbench_here("replay", run_folder, "--mended", "siargo_mf5700", "--with-model", cwd=tmp_path)
    assert (done.returncode, "by --save, then replay those" in " ".join(done.stderr.split())) == (2, True)


def test_a_flywheel_is_in_the_model_that_a_run_is_compared_with(tmp_path, monkeypatch):
    class DrivenError(Exception):
        pass

    def drive(motor, *_):
        raise DrivenError(motor["inertia"].value)

    nothing = SimpleNamespace(pressure_time_s=None, pressure_pa=None)
    monkeypatch.setattr("rig.replay.channels.channels_of", lambda run: nothing)
    monkeypatch.setattr("model.operation.replayed.drive", drive)
    with RunWriter.create(tmp_path, start_of(added_inertia_kg_m2=0.02)) as writer:
        writer.end("finished")
    with pytest.raises(DrivenError) as found:
        _against_model(read_run(writer.folder), None)
    assert found.value.args[0] == pytest.approx(read_motor("ptm3600")["inertia"].value + 0.02)


@pytest.mark.parametrize(
    ("pressure", "speeds_from_s", "words"),
    [(9.0, 0.0, "was 9 bar at 0.100 s, and the model goes up to 8 bar"), (2.0, 50.0, "there is nothing to compare")],
)
def test_a_run_that_the_model_cannot_be_held_against_is_told(tmp_path, pressure, speeds_from_s, words):
    with RunWriter.create(tmp_path, start_of()) as writer:
        for step in range(1, 11):
            writer.exchange(poll("gauge", {"pressure_bar_abs": pressure}, step * 100_000_000))
        for step in range(1, 11):
            writer.exchange(poll("tach", {"speed_rpm": 300.0}, round((speeds_from_s + 0.1 * step) * 1e9)))
        writer.end("finished")
    with pytest.raises(RunError, match=words) as told:
        _against_model(read_run(writer.folder), tmp_path / "out")
    assert str(writer.folder) in str(told.value)
    assert not (tmp_path / "out").exists()


def test_a_record_that_the_model_cannot_be_integrated_through_is_told(monkeypatch):
    def fails(*_):
        raise ArithmeticError("status 3")

    monkeypatch.setattr("model.operation.replayed.simulate", fails)
    with pytest.raises(OperatingPointError, match="cannot be driven with this record"):
        drive(MOTOR, np.arange(3.0), np.full(3, 2e5), 0.5)


def test_a_run_without_its_bytes_is_not_replayed(copied):
    (copied / "wire.jsonl").unlink()
    with pytest.raises(RunError, match="nothing to replay"):
        replay(read_run(copied))


def test_a_driver_that_asks_something_else_is_told(run_folder):
    run = read_run(run_folder)
    player = Player(bench_of_run(run), True, run.start.ambient.model_dump())
    exchange = next(one for _, one in run.exchanges() if one.device == "gauge" and one.action == "poll")
    other = exchange.events[0].data[:-1] + b"\x00"
    player.play(type(exchange)(exchange.line, "gauge", "poll", None, (Event("tx", 1, other), *exchange.events[1:])))
    assert "where" in player.differences[0]


def test_the_port_gives_silence_when_the_driver_waits_for_more_than_came():
    port = ReplayPort()
    port.load((Event("tx", 5, b"?"), Event("rx", 9, b"ab"), Event("tx", 20, b"!")))
    assert port.write(b"?") == 5
    assert port.read(100) == (9, b"ab")
    assert port.read(100) == (100, b"")
    assert port.write(b"!") == 20
    assert port.differences == []


def test_the_model_driven_with_a_constant_pressure_comes_to_the_steady_state():
    time = np.arange(0.0, 3.0, 0.1)
    found = drive(MOTOR, time, np.full(time.size, 2e5), 0.5)
    point = steady(MOTOR, [2e5])
    assert found.speed_rad_s[-1] == pytest.approx(point.speed_rad_s[0, 0], rel=2e-3)
    assert found.flow_m3_s[-1] == pytest.approx(point.flow_m3_s[0, 0], rel=1e-2)
