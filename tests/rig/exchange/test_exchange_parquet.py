"""Parquet files of others: columns with their units, and what is no column is refused in a line."""

import datetime
from decimal import Decimal

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rig.exchange.guess.proposal import propose
from tests.rig.exchange.test_exchange_as_found import given  # noqa: F401 - a fixture
from tests.rig.runlog.test_runlog_import import CLOCKED, SIMPLE, put  # noqa: F401 - a fixture


def parquet(table):
    """Writes an Arrow table as a Parquet file."""
    return lambda path: pq.write_table(table, path)


def test_a_parquet_file_s_columns_are_read_with_their_units_and_what_is_null_is_missing(given):  # noqa: F811 - the fixture
    unit = pa.schema(
        [pa.field("P", pa.float64(), metadata={"unit": "kPa"}), pa.field("n", pa.dictionary(pa.int8(), pa.int16()))]
    )
    table = pa.table({"P": [2.0, None, 2.2], "n": pa.array([397, 450, None], pa.int16()).dictionary_encode()}, unit)
    code, said, made = given(parquet(table), reader="parquet")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0", ",450.0", "2.2,"])
    assert "column 'P': no reading 1 times" in said and "'P': the file says 'kPa', the mapping 'bar abs'" in said


MOMENTS = [datetime.datetime(2024, 5, 1, 10, 0, 0, 500_000), datetime.datetime(2024, 5, 1, 10, 0, 2)]
PARQUET_TIMES = {
    "naive": (pa.array(MOMENTS, pa.timestamp("ns")), "ISO"),
    "of a zone": (pa.array(MOMENTS, pa.timestamp("us", "Europe/Prague")), "ISO"),
    "of day": (pa.array([moment.time() for moment in MOMENTS], pa.time64("ns")), "hh:mm:ss"),
}


@pytest.mark.parametrize("name", PARQUET_TIMES)
def test_a_parquet_file_s_times_are_read_as_text_is(given, name):  # noqa: F811 - the fixture
    times, unit = PARQUET_TIMES[name]
    table = pa.table({"t": times, "P": pa.array([Decimal("2.0"), Decimal("2.1")]), "n": ["397", "OL"]})
    code, said, made = given(parquet(table), SIMPLE + CLOCKED.format(unit), reader="parquet")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0,0.0", "2.1,,1.5"]), said


LISTS = pa.array([[397.0], [450.0]])
BAD_PARQUET = {
    "lists": (pa.table({"P": [2.0, 2.1], "n": LISTS}), "'n': it holds lists or records"),
    "a name twice": (pa.table([pa.array([2.0]), *[pa.array([397.0])] * 2], ["P", "n", "n"]), "'n': several columns"),
    "no such column": (pa.table({"P": [2.0], "N": [397.0]}), "no column is called 'n'; there are 'P'"),
    "no rows": (pa.table({"P": pa.array([], pa.float64()), "n": pa.array([], pa.float64())}), "data.parquet: "),
    "a span of time": (pa.table({"P": [2.0], "n": pa.array([5], pa.duration("s"))}), "'n': holds duration[s]"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_PARQUET)
def test_what_is_no_column_of_a_parquet_file_is_refused(given, name):  # noqa: F811 - the fixture
    table, words = BAD_PARQUET[name]
    code, said, _ = given(parquet(table), reader="parquet")
    assert (code, words in said) == (2, True), said
    assert "Traceback" not in said


def test_a_column_that_is_none_does_not_hide_the_others(given, tmp_path):  # noqa: F811 - the fixture
    table = pa.table({"P": [2.0], "raw": pa.array([b"x"]), "lists": pa.array([[1.0]]), "n [rpm]": [397.0]})
    by_place = SIMPLE.replace('"P"', "1").replace('"n"', "4")
    code, _, made = given(parquet(table), by_place, reader="parquet")
    assert (code, made.splitlines()[1:]) == (0, ["2.0,397.0"])
    assert 'column = "n [rpm]"' in propose(tmp_path / "data.parquet")
