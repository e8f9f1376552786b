"""HDF5, NeXus, netCDF and MDF files: what is in them is what is imported, and a clock is never taken for another."""

import sys
import warnings

import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from rig.exchange.importing import import_recording, import_table
from rig.exchange.mapping import read_mapping
from rig.recording import read_recording
from rig.runlog import RunError, read_run

HEAD = """
format = "import/1"
title = "a bench elsewhere"
source = "a colleague, by mail"
licence = "none: for this test only"
motor = "ptm3600"
kind = "{kind}"
[ambient]
pressure_bar_abs = 1.0
temperature_c = 20.0
[table]
reader = "{reader}"
{table}
"""
COLUMN = '[columns.{name}]\ncolumn = "{column}"\nunit = "{unit}"\n'
UNITS = {"time_s": "s", "pressure_bar_abs": "bar abs", "speed_rpm": "rpm", "flow_l_min": "L/min"}


def mapping_text(reader, kind="transient", table="", more="", **columns):
    text = HEAD.format(kind=kind, reader=reader, table=table)
    return text + "".join(COLUMN.format(name=n, column=c, unit=UNITS[n]) for n, c in columns.items()) + more


@pytest.fixture
def imported(tmp_path):
    """Imports a file with a mapping; returned are the columns of the recording's one file."""

    def columns_of(path, text):
        (tmp_path / "map.toml").write_text(text)
        number = len(list(tmp_path.glob("out*")))
        made = import_recording([path], read_mapping(tmp_path / "map.toml"), tmp_path / f"out{number}")
        (file,) = read_recording(made).files
        return {name: column.values for name, column in file.columns.items()}

    return columns_of


@pytest.fixture
def hdf5(tmp_path):
    """Writes an HDF5 file with a function of it; returned is its path."""

    def write(fill):
        with h5py.File(tmp_path / "data.h5", "w") as file:
            fill(file)
        return tmp_path / "data.h5"

    return write


def log(group, name, values, time, units="s", start=""):
    """An NXlog."""
    made = group.create_group(name)
    made.attrs["NX_class"] = "NXlog"
    made["value"], made["time"] = np.asarray(values, float), np.asarray(time, float)
    made["time"].attrs.update({"units": units} if units else {})
    made["time"].attrs.update({"start": start} if start else {})


PLAIN = {"time_s": "t", "pressure_bar_abs": "P", "speed_rpm": "n"}
LOGS = {"time_s": "@time", "pressure_bar_abs": "P/value", "speed_rpm": "n/value"}


def test_datasets_of_a_group_are_columns(hdf5, imported):
    def fill(file):
        bench = file.create_group("entry/bench")
        bench["t"], bench["P"], bench["n"] = [0.0, 0.5, 1.0], np.float32([2.0, 1.5, 1.25]), [[300], [200], [150]]
        file["entry/other"] = np.arange(7.0)

    found = imported(hdf5(fill), mapping_text("hdf5", table='group = "entry/bench"', **PLAIN))
    assert found["time_s"].tolist() == [0.0, 0.5, 1.0]
    assert found["pressure_bar_abs"].tolist() == [2.0, 1.5, 1.25]
    assert found["speed_rpm"].tolist() == [300.0, 200.0, 150.0]


def test_fields_of_a_table_are_columns_and_a_packed_one_is_unpacked(hdf5, imported):
    def fill(file):
        rows = [(0.0, 2.0), (0.5, 1.5), (1.0, 1.25)]
        file["table"] = np.array(rows, dtype=[("t", "f8"), ("P", "f8")])
        file["n"] = np.int16([3000, -1, 1500])
        file["n"].attrs.update({"scale_factor": 0.1, "add_offset": 5.0, "_FillValue": np.int16(-1)})

    columns = {"time_s": "table/t", "pressure_bar_abs": "table/P", "speed_rpm": "n"}
    found = imported(hdf5(fill), mapping_text("hdf5", **columns))
    assert found["pressure_bar_abs"].tolist() == [2.0, 1.5, 1.25]
    np.testing.assert_allclose(found["speed_rpm"], [305.0, np.nan, 155.0])


def test_a_dimension_s_scale_is_the_clock_of_a_netcdf_variable(hdf5, imported):
    def fill(file):
        file["time"] = [0.0, 500.0, 1000.0]
        file["time"].attrs["units"] = "milliseconds since 2024-05-01 10:00:00"
        file["time"].make_scale()
        for name in ("P", "n"):
            file[name] = [2.0, 1.5, 1.25]
            file[name].dims[0].attach_scale(file["time"])

    found = imported(hdf5(fill), mapping_text("hdf5", **PLAIN | {"time_s": "@time"}))
    assert found["time_s"].tolist() == [0.0, 0.5, 1.0]


def test_logs_of_several_clocks_stand_on_one_time_line_with_gaps(hdf5, imported):
    def fill(file):
        log(file, "P", [2.0, 1.5], [0.0, 1000.0], "ms", "2024-05-01T10:00:00+00:00")
        log(file, "n", [300.0, 200.0, 100.0], [0.0, 0.5, 1.0], "s", "2024-05-01T12:00:00.500+02:00")

    found = imported(hdf5(fill), mapping_text("hdf5", **LOGS))
    np.testing.assert_allclose(found["time_s"], [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(found["pressure_bar_abs"], [2.0, np.nan, 1.5, np.nan])
    np.testing.assert_allclose(found["speed_rpm"], [np.nan, 300.0, 200.0, 100.0])


@pytest.mark.parametrize(
    ("late", "units", "start", "change", "words"),
    [
        (0.5, "s", "", {"time_s": "P/time"}, r"two clocks: 'P/value' from no date \+ 0 s every 0.5 s .* and 'n/value'"),
        (0.5, "s", "2024-05-01T10:00:00", {}, r"two clocks: .*; one tells no date, so that they cannot be placed"),
        (0.0, "", "", {}, r"'n/value': its clock '/n/time' says no unit of time"),
        (0.0, "s", "May", {}, r"its times count from 'May', which is no date \(ISO 8601\)"),
    ],
)
def test_clocks_that_differ_or_cannot_be_placed_are_refused(hdf5, imported, late, units, start, change, words):
    def fill(file):
        log(file, "P", [2.0, 1.5, 1.25], [0.0, 0.5, 1.0])
        log(file, "n", [300.0, 200.0, 100.0], np.array([0.0, 0.5, 1.0]) + late, units, start)

    with pytest.raises(RunError, match=words):
        imported(hdf5(fill), mapping_text("hdf5", **LOGS | change))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"kind": "steady"}, "a steady file has whole rows"),
        (
            {"more": "[columns.supply_open]\ncolumn = 'v/value'\nunit = '0/1'\n"},
            "supply_open holds between its samples",
        ),
        (
            {"more": '[[files]]\nfile = "data.h5"\nkind = "transient"\naverage_rows = 2\n'},
            "average_rows takes whole rows",
        ),
    ],
)
def test_gaps_between_the_samples_of_two_clocks_are_refused_where_rows_are_whole(hdf5, imported, more, words):
    def fill(file):
        log(file, "P", [2.0, 1.5, 1.25], [0.0, 0.5, 1.0])
        log(file, "n", [300.0, 200.0, 100.0], [0.1, 0.6, 1.1])
        log(file, "v", [1.0, 1.0, 0.0], [0.1, 0.6, 1.1])

    with pytest.raises(RunError, match=f"two clocks: .*; {words}"):
        imported(hdf5(fill), mapping_text("hdf5", **LOGS | more))


def test_a_channel_without_a_clock_is_not_laid_on_that_of_another(hdf5, imported):
    def fill(file):
        log(file, "P", [2.0, 1.5, 1.25], [0.0, 0.5, 1.0])
        file["n"] = [300.0, 200.0, 100.0]

    with pytest.raises(RunError, match="'n': it has no clock, as 'P/value' has"):
        imported(hdf5(fill), mapping_text("hdf5", **LOGS | {"speed_rpm": "n"}))
    found = imported(hdf5(fill), mapping_text("hdf5", **LOGS | {"speed_rpm": "n", "time_s": "P/time"}))
    assert found["speed_rpm"].tolist() == [300.0, 200.0, 100.0]


def test_datasets_have_no_order_and_are_not_taken_by_place(hdf5, imported):
    def fill(file):
        file["n"], file["P"] = [397.0], [2.0]

    text = mapping_text("hdf5", "steady", pressure_bar_abs="P", speed_rpm="n").replace('"n"', "2")
    with pytest.raises(RunError, match="have no order; take them by their paths"):
        imported(hdf5(fill), text)


def test_the_time_track_is_in_seconds(tmp_path):
    (tmp_path / "map.toml").write_text(mapping_text("hdf5", **LOGS).replace('unit = "s"', 'unit = "ms"'))
    with pytest.raises(RunError, match="'@time' is in seconds"):
        read_mapping(tmp_path / "map.toml")


@pytest.mark.parametrize(("stated", "told"), [("bar(a)", False), ("kPa", True), ("bar(g)", True)])
def test_where_the_file_states_another_unit_than_the_mapping_it_is_told(hdf5, tmp_path, stated, told):
    def fill(file):
        file["P"], file["n"] = [2.0, 1.5], [300.0, 200.0]
        file["P"].attrs["units"] = stated

    (tmp_path / "map.toml").write_text(mapping_text("hdf5", "steady", pressure_bar_abs="P", speed_rpm="n"))
    made = import_recording([hdf5(fill)], read_mapping(tmp_path / "map.toml"), tmp_path / "out")
    said = f"'P': the file says '{stated}', the mapping 'bar abs' for pressure_bar_abs; the mapping's is taken"
    assert (said in (made / "notes.txt").read_text()) is told


def linked(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["n"] = [1.0, 2.0, 3.0]
    file["n"] = h5py.ExternalLink("other.h5", "/n")


def raw(file, folder):
    (folder / "secret").write_bytes(np.arange(3.0).tobytes())
    file.create_dataset("n", (3,), "f8", external=[(str(folder / "secret"), 0, h5py.h5f.UNLIMITED)])


def virtual(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["n"] = [1.0, 2.0, 3.0]
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "n", (3,))
    file.create_virtual_dataset("n", layout)


def circle(file, folder):
    file["n"] = h5py.SoftLink("/n")


@pytest.mark.parametrize(
    ("put", "words"),
    [
        (linked, "'n' is a link to another file"),
        (raw, "its values lie in another file"),
        (virtual, "its values lie in another file"),
        (circle, "in a circle"),
        (lambda file, folder: file.create_dataset("n", data=np.zeros((3, 2))), r"its shape is \(3, 2\)"),
        (lambda file, folder: file.create_dataset("n", (10**12,), "f8", chunks=(8,)), "at most 20000000 rows"),
        (lambda file, folder: file.create_dataset("n", data=[1j, 2, 3]), "neither numbers nor text"),
        (lambda file, folder: None, r"no dataset is called 'n'; there are 'P', 't'"),
    ],
)
def test_what_is_no_column_of_this_file_is_refused(hdf5, imported, tmp_path, put, words):
    def fill(file):
        file["t"], file["P"] = [0.0, 0.5, 1.0], [2.0, 1.5, 1.25]
        put(file, tmp_path)

    with pytest.raises(RunError, match=words):
        imported(hdf5(fill), mapping_text("hdf5", **PLAIN))


@pytest.fixture
def mdf(tmp_path):
    """Writes an MDF 4 file of groups, each a name, its times and its channels; returned is its path."""

    def write(*groups, version="4.10"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from asammdf import MDF, Signal
        with MDF(version=version) as file:
            for name, time, channels in groups:
                signals = [
                    Signal(np.asarray(values), np.asarray(time, float), name=channel, unit="-", **more)
                    for channel, (values, more) in channels.items()
                ]
                file.append(signals, acq_name=name, common_timebase=True)
            file.save(tmp_path / f"data{'.mf4' if version[0] == '4' else '.mdf'}")
        return next(iter(tmp_path.glob("data.*")))

    return write


TRANSIENT = {"time_s": "@time", "pressure_bar_abs": "P", "speed_rpm": "n"}


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_channels_of_an_mdf_group_are_columns(mdf, imported, version):
    channels = {"P": ([2.0, 1.5, 1.25], {}), "n": (np.uint16([300, 200, 150]), {"conversion": {"a": 0.5, "b": 10.0}})}
    found = imported(mdf(("daq", [0.0, 0.5, 1.0], channels), version=version), mapping_text("mdf", **TRANSIENT))
    assert found["time_s"].tolist() == [0.0, 0.5, 1.0]
    assert found["speed_rpm"].tolist() == [160.0, 110.0, 85.0]


def test_groups_of_two_rates_stand_on_one_time_line_and_invalid_samples_are_missing(mdf, imported):
    slow = ("slow", [0.0, 1.0], {"P": ([2.0, 1.5], {})})
    invalid = {"invalidation_bits": np.array([False, True, False, False])}
    fast = ("fast", [0.25, 0.5, 0.75, 1.0], {"n": ([300.0, -1.0, 200.0, 150.0], invalid)})
    found = imported(mdf(slow, fast), mapping_text("mdf", **TRANSIENT))
    np.testing.assert_allclose(found["time_s"], [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(found["pressure_bar_abs"], [2.0, np.nan, np.nan, np.nan, 1.5])
    np.testing.assert_allclose(found["speed_rpm"], [np.nan, 300.0, np.nan, 200.0, 150.0])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", r"'n' stands in several groups: 'a', 'b'; name one in \[table\]"),
        ('group = "c"', r"name the group of channels in \[table\]: group = one of 'a', 'b'"),
    ],
)
def test_an_mdf_channel_that_is_there_twice_or_not_at_all_is_refused(mdf, imported, table, words):
    time, values = [0.0, 0.5, 1.0], [2.0, 1.5, 1.25]
    path = mdf(("a", time, {"P": (values, {}), "n": (values, {})}), ("b", time, {"n": (values, {})}))
    with pytest.raises(RunError, match=words):
        imported(path, mapping_text("mdf", table=table, **TRANSIENT))


def test_tdms_waveforms_of_two_clocks_stand_on_one_time_line(tmp_path, imported):
    begin = np.datetime64("2024-05-01T10:00:00")
    with nptdms.TdmsWriter(tmp_path / "data.tdms") as writer:
        for name, late_ms, step in (("P", 0, 0.02), ("n", 10, 0.01)):
            clock = {"wf_start_time": begin + np.timedelta64(late_ms, "ms"), "wf_increment": step}
            writer.write_segment([nptdms.ChannelObject("g", name, np.arange(1.0, 4.0), clock)])
    found = imported(tmp_path / "data.tdms", mapping_text("tdms", **TRANSIENT))
    np.testing.assert_allclose(found["time_s"], [0.0, 0.01, 0.02, 0.03, 0.04])
    np.testing.assert_allclose(found["pressure_bar_abs"], [1.0, np.nan, 2.0, np.nan, 3.0])
    np.testing.assert_allclose(found["speed_rpm"], [np.nan, 1.0, 2.0, 3.0, np.nan])


def test_a_merged_import_makes_a_run_too(hdf5, tmp_path):
    def fill(file):
        log(file, "P", [2.0, 1.5, 1.25], [0.0, 0.5, 1.0])
        log(file, "n", [300.0, 200.0, 100.0], [0.1, 0.6, 1.1])

    (tmp_path / "map.toml").write_text(mapping_text("hdf5", **LOGS))
    told = []
    run = read_run(import_table([hdf5(fill)], read_mapping(tmp_path / "map.toml"), tmp_path / "runs", told.append))
    assert [words.partition(": ")[2][:17] for words in told] == ["two clocks: 'P/va"]
    assert len(run.samples) == 6
    assert run.samples[run.samples["channel"] == "speed_rpm"]["time_s"].tolist() == [0.1, 0.6, 1.1]


@pytest.mark.parametrize(("reader", "package", "extra"), [("hdf5", "h5py", "formats"), ("mdf", "asammdf", "mdf")])
def test_without_its_package_the_error_says_what_to_install(imported, tmp_path, monkeypatch, reader, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / "data").write_bytes(b"")
    with pytest.raises(RunError, match=rf"needs the package {package}; .*spinbench\[{extra}\]"):
        imported(tmp_path / "data", mapping_text(reader, **TRANSIENT))


ROTAMETER = '[columns.flow_l_min]\ncolumn = "Q"\nunit = "{unit}"\nrotameter = {{{scale}}}\n'


@pytest.mark.parametrize(
    ("scale", "factor"),
    [
        ("pressure_bar_abs = 1.0, temperature_c = 20.0", (1.0 / 2.0) ** 0.5),
        ("pressure_bar_abs = 8.0, temperature_c = 20.0", 2.0),
        ("gas = 'carbon dioxide', pressure_bar_abs = 2.0, temperature_c = 20.0", (44.009 / 28.965) ** 0.5),
        ("gas = 'air', pressure_bar_abs = 2.0, temperature_c = 0.0", (293.15 / 273.15) ** 0.5),
    ],
)
def test_a_rotameter_s_scale_is_brought_to_the_inlet_s_density(imported, tmp_path, scale, factor):
    (tmp_path / "data.csv").write_text("P;Q\n2.0;70.0\n")
    text = mapping_text("csv", "steady", 'delimiter = ";"\ndecimal = "."', pressure_bar_abs="P")
    found = imported(tmp_path / "data.csv", text + ROTAMETER.format(unit="L/min", scale=scale))
    assert found["flow_l_min"] == pytest.approx([70.0 * factor])


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [
        ("sL/min", "pressure_bar_abs = 1.0, temperature_c = 20.0", "a rotameter's scale is of a volume flow"),
        ("L/min", "gas = 'steam', pressure_bar_abs = 1.0, temperature_c = 20.0", "rotameter.gas"),
        ("L/min", "temperature_c = 20.0", "rotameter"),
    ],
)  # fmt: skip
def test_a_rotameter_s_scale_that_cannot_be_is_refused(tmp_path, unit, scale, words):
    text = mapping_text("csv", "steady", 'delimiter = ";"\ndecimal = "."', pressure_bar_abs="P")
    (tmp_path / "map.toml").write_text(text + ROTAMETER.format(unit=unit, scale=scale))
    with pytest.raises(Exception, match=words):
        read_mapping(tmp_path / "map.toml")


COLUMNS = {"P": np.array([2.0, 2.1]), "drehzahl": np.array([300.0, 310.0]), "note": np.array([1.0, 2.0])}


def write_tdms(path):
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("g", name, data) for name, data in COLUMNS.items()])


WRITE = {
    "mat": lambda path: savemat(path, COLUMNS),
    "tdms": write_tdms,
    "parquet": lambda path: pq.write_table(pa.table({name: pa.array(data) for name, data in COLUMNS.items()}), path),
}


@pytest.mark.parametrize("reader", [*WRITE, "mdf"])
def test_a_column_that_is_not_there_is_refused_with_all_that_are(reader, tmp_path, mdf, imported):
    if reader == "mdf":
        path = mdf(("g", [0.0, 0.5], {name: (data, {}) for name, data in COLUMNS.items()}))
    else:
        path = tmp_path / f"data.{reader}"
        WRITE[reader](path)
    with pytest.raises(RunError, match=r"no column is called 'n'; there are 'P', 'drehzahl', 'note'$"):
        imported(path, mapping_text(reader, kind="steady", pressure_bar_abs="P", speed_rpm="n"))
