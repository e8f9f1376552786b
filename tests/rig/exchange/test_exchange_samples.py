"""A run's samples in the formats of others: each file, read by another maker's reader, holds what the run holds."""

import json
import os
import re
import subprocess
import sys
import warnings

import mdfreader
import numpy as np
import pandas as pd
import pyfive
import pytest
from nptdms import TdmsFile

from rig.exchange.guess.proposal import propose
from rig.exchange.importing import import_recording
from rig.exchange.mapping import read_mapping
from rig.exchange.samples.channels import BESIDE
from rig.exchange.samples.export import FORMATS, export_samples
from rig.readings import NS, USABLE, Quality
from rig.recording import read_recording
from rig.runlog import RunError, RunWriter, read_run
from tests.synthetic_runs import FLOW, PRESSURE, SPEED, SWEEP, UTC_START_NS, Bench, poll, start_of

ENDINGS = (".parquet", ".h5", ".tdms", ".mf4")
TEXT = [name for name, kind in BESIDE.items() if not kind]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A sealed run with what a bench has: readings that failed, that are off the scale, and words of any script."""
    with RunWriter.create(tmp_path_factory.mktemp("runs"), start_of()) as writer:
        bench = Bench(writer)
        bench.zero("start")
        bench.plateau(1, SWEEP[0], "up")
        for quality in Quality:
            bench.time_ns += NS
            failed = quality in (Quality.TIMEOUT, Quality.CRC, Quality.EXCEPTION)
            value = None if failed else 1 / 3
            more = {"quality": quality, "retries": 1, "raw": "0,33 µbar", "detail": f"say '{quality}' ≥ 3 °C"}
            writer.exchange(poll("gauge", {PRESSURE: value}, bench.time_ns, **more))
        writer.exchange(poll("meter", {FLOW: 100.0}, bench.time_ns + 1, quality=Quality.OVER_RANGE, censored=1))
        bench.capture("coast-down")
        writer.end("finished")
    return read_run(writer.folder)


@pytest.fixture(scope="module")
def files(run, tmp_path_factory):
    """The run in each format, by its ending."""
    folder = tmp_path_factory.mktemp("exported")
    for ending in ENDINGS:
        export_samples(run, folder / f"run{ending}")
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(f"run{ending}" for ending in ENDINGS)
    return {ending: folder / f"run{ending}" for ending in ENDINGS}


def read_hdf5(path):
    """By pyfive, which has nothing of the library that wrote it."""
    with pyfive.File(str(path)) as file:
        entry = file["run"]
        records = {name: bytes(entry[name][()]) for name in ("start.json", "end.json")}
        channels = {}
        for name in entry:
            if "value" in (entry[name] if isinstance(entry[name], pyfive.Group) else ()):
                log = entry[name]
                beside = {key: decoded(log[key][:]) if key in TEXT else log[key][:] for key in BESIDE}
                unit = log["value"].attrs["units"]
                assert (log["time"].attrs["units"], log["time"].attrs["start"]) == (
                    b"s",
                    b"2026-05-28T20:26:40.000000Z",
                )
                channels[name] = (np.array(log["value"][:]), unit.decode(), np.array(log["time"][:]), beside)
    return channels, records


def decoded(cells):
    return [cell.rstrip(b"\0").decode() for cell in cells]


def read_tdms(path):
    file = TdmsFile.read(path)
    records = {name: file.properties[name].encode() for name in ("start.json", "end.json")}
    channels = {}
    for group in file.groups():
        beside = {key: group[key][:].tolist() if key in TEXT else group[key][:] for key in BESIDE}
        assert group["time_s"].properties["unit_string"] == "s"
        channels[group.name] = (group["value"][:], group["value"].properties["unit_string"], group["time_s"][:], beside)
    return channels, records


def read_mdf(path):
    """By mdfreader, which has nothing of the library that wrote it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = mdfreader.Mdf(str(path))
    channels = {}
    for name in (name for name in file if f"{name}.quality" in file):
        beside = {key: file.get_channel_data(f"{name}.{key}") for key in BESIDE}
        beside = {
            key: [str(cell).rstrip("\0") for cell in beside[key]] if key in TEXT else beside[key] for key in BESIDE
        }
        time = file[name]["master"]
        assert file.get_channel_unit(time) == "s"
        channels[name] = (
            np.array(file.get_channel_data(name)), file.get_channel_unit(name), file.get_channel_data(time), beside
        )  # fmt: skip
        (invalid,) = (
            file.get_channel_data(key) for key in file if key.startswith("invalid") and file[key]["master"] == time
        )
        assert ((invalid[:, 0] & 1) == np.isnan(channels[name][0])).all()
    return channels, None


@pytest.mark.parametrize(("ending", "read"), [(".h5", read_hdf5), (".tdms", read_tdms), (".mf4", read_mdf)])
def test_another_reader_finds_values_units_qualities_and_times_as_they_were(run, files, ending, read):
    channels, records = read(files[ending])
    rows = 0
    for (device, name), samples in run.samples.groupby(["device", "channel"]):
        value, unit, time, beside = channels.pop(f"{device}.{name}")
        np.testing.assert_array_equal(value, samples["value"].to_numpy())
        np.testing.assert_array_equal(time, samples["time_s"].to_numpy())
        assert {unit} == set(samples["unit"])
        for key in BESIDE:
            assert list(beside[key]) == samples[key].tolist(), key
        rows += len(samples)
    assert (channels, rows) == ({}, len(run.samples))
    if records is not None:
        assert {name: (run.folder / name).read_bytes() for name in records} == records


def test_another_reader_finds_the_table_in_a_parquet_file(run, files):
    found = pd.read_parquet(files[".parquet"])
    for name in run.samples:
        np.testing.assert_array_equal(found[name].to_numpy(), run.samples[name].to_numpy())


def test_an_mdf_file_tells_the_start_and_carries_the_records(run, files):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF
    with MDF(str(files[".mf4"])) as file:
        assert file.start_time.timestamp() == UTC_START_NS / NS
        attached = {
            str(one.file_name): bytes(file.extract_attachment(index)[0]) for index, one in enumerate(file.attachments)
        }
    assert json.loads(attached["start.json"])["bench"] == "synthetic"
    assert json.loads(attached["end.json"])["outcome"] == "finished"


MAPPING = """
format = "import/1"
title = "a run of ours"
source = "here"
licence = "none"
motor = "ptm3600"
kind = "transient"
[table]
reader = "{reader}"
{table}
"""
COLUMN = '[columns.{name}]\ncolumn = "{column}"\nunit = "{unit}"\n'
TAKEN = {PRESSURE: ("gauge", "bar abs"), SPEED: ("tach", "rpm"), FLOW: ("meter", "L/min")}
READERS = {".h5": ("hdf5", 'group = "run"', "/value"), ".mf4": ("mdf", "", ""), ".parquet": ("parquet", "", "")}


@pytest.mark.parametrize("ending", READERS)
def test_what_was_exported_is_imported_with_each_channel_on_its_own_times_and_with_its_marks(
    run, files, tmp_path, ending
):
    reader, table, leaf = READERS[ending]
    text = MAPPING.format(reader=reader, table=table) + COLUMN.format(name="time_s", column="@time", unit="s")
    for name, (device, unit) in TAKEN.items():
        text += COLUMN.format(name=name, column=f"{device}.{name}{leaf}", unit=unit)
    (tmp_path / "map.toml").write_text(text)
    told = []
    made = import_recording([files[ending]], read_mapping(tmp_path / "map.toml"), tmp_path / "recording", told.append)
    (file,) = read_recording(made).files
    for name, (device, _) in TAKEN.items():
        samples = run.samples[(run.samples["device"] == device) & (run.samples["channel"] == name)]
        samples = samples[samples["value"].notna()]
        samples = samples[samples["quality"].isin(USABLE) | (samples["censored"] != 0)]
        column = file.columns[name]
        known = ~np.isnan(column.values)
        np.testing.assert_array_equal(column.values[known], samples["value"])
        off = np.where((name == SPEED) & (samples["value"] == 0.0), -1, samples["censored"])  # a standing rotor
        np.testing.assert_array_equal(column.censor[known], off)
        np.testing.assert_allclose(file.columns["time_s"].values[known], samples["time_s"], atol=1e-9)
    assert file.columns[FLOW].censor.max() == 1
    assert any(f"gauge.{PRESSURE}{leaf}': by the marks of quality beside it" in one for one in told), told
    assert any("1 readings are stale and missing" in one for one in told), told
    assert not any("the file says" in one for one in told), told


def test_a_group_of_an_exported_tdms_file_is_imported_with_its_marks(run, files, tmp_path):
    text = MAPPING.format(reader="tdms", table=f'group = "meter.{FLOW}"')
    for name, column, unit in (("time_s", "time_s", "s"), (FLOW, "value", "L/min")):
        text += COLUMN.format(name=name, column=column, unit=unit)
    (tmp_path / "map.toml").write_text(text + '[columns.pressure_bar_abs]\nconstant = 2.0\nunit = "bar abs"\n')
    made = import_recording([files[".tdms"]], read_mapping(tmp_path / "map.toml"), tmp_path / "recording")
    (file,) = read_recording(made).files
    samples = run.samples[run.samples["channel"] == FLOW]
    np.testing.assert_array_equal(file.columns[FLOW].values, samples["value"])
    np.testing.assert_array_equal(file.columns[FLOW].censor, samples["censored"])


def test_an_exported_tdms_file_says_which_format_can_be_imported_whole(files, tmp_path):
    told = "of a run's export one channel at a time: to import several, export it as .parquet, .h5 or .mf4"
    assert f"# Unsure: one file has one group, {told}; the columns below are of all\n" in propose(files[".tdms"])
    text = MAPPING.format(reader="tdms", table="") + COLUMN.format(name=FLOW, column="value", unit="L/min")
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(RunError, match=re.escape(told)):
        import_recording([files[".tdms"]], read_mapping(tmp_path / "map.toml"), tmp_path / "recording")


def test_a_killed_run_and_a_name_that_is_taken_are_refused(run, tmp_path):
    with RunWriter.create(tmp_path / "runs", start_of()) as writer:
        Bench(writer).zero("start")
    killed = read_run(writer.folder)
    for ending in ENDINGS:
        with pytest.raises(RunError, match="only a sealed run becomes"):
            export_samples(killed, tmp_path / f"killed{ending}")
        (tmp_path / f"mine{ending}").write_text("mine")
        with pytest.raises(RunError, match="exists already"):
            export_samples(run, tmp_path / f"mine{ending}")
        assert (tmp_path / f"mine{ending}").read_text() == "mine"


FULL = """
import resource, signal, sys
from pathlib import Path
from rig.exchange.samples.export import export_samples
from rig.runlog import RunError, read_run
run = read_run(Path(sys.argv[1]))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]),) * 2)
try:
    export_samples(run, Path(sys.argv[2]))
except RunError as error:
    print(error)
    sys.exit(2)
"""


@pytest.mark.parametrize(("ending", "most"), [(".parquet", 1), (".h5", 20_000), (".mf4", 20_000)])
def test_a_full_disk_leaves_nothing_half_written(run, tmp_path, ending, most):
    file = tmp_path / f"run{ending}"
    command = [sys.executable, "-B", "-W", "ignore", "-c", FULL, str(run.folder), str(file), str(most)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, "cannot be written" in done.stdout) == (2, True), done
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_a_format_does_not_take_is_told_as_that(run, tmp_path):
    with pytest.raises(RunError, match="this format takes no name that is not UTF-8; give another"):
        export_samples(run, tmp_path / os.fsdecode(b"caf\xe9.parquet"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", FORMATS)
def test_without_its_package_a_format_says_what_to_install(run, tmp_path, monkeypatch, ending):
    monkeypatch.setitem(sys.modules, FORMATS[ending][1], None)
    with pytest.raises(RunError, match=r"needs the package \w+; install it with `pip install .spinbench\[\w+\].`"):
        export_samples(run, tmp_path / f"run{ending}")
    assert list(tmp_path.iterdir()) == []
