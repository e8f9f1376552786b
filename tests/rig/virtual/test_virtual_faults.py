"""A few cells of the campaign that `make faults` runs whole: no wrong value is taken for a good one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from rig.readings import Quality, Reading
from tests.faults import Cell, cells, kept, measure, off_rpm, table

# Late, misaddressed, mismatched, echoed, split, stray bytes. No corrupted bytes:
# only a checksum can tell those.
CELLS = [
    ("rtu", "late"),
    ("rtu", "wrong_unit"),
    ("rtu", "wrong_function"),
    ("rtu", "wrong_count"),
    ("rtu", "echo"),
    ("rtu", "split"),
    ("rtu", "noise"),
    ("tcp", "late"),
    ("tcp", "number_next"),
    ("text", "late"),
    ("text", "echo"),
    ("text", "split"),
    ("text", "noise"),
]
POLLS, SLOW = 8, 2.4


@pytest.mark.slow
def test_no_late_misaddressed_mismatched_echoed_split_or_stray_reply_gives_a_wrong_value():
    with ThreadPoolExecutor(5) as pool:
        found = list(pool.map(lambda cell: measure(*cell, POLLS, 4, SLOW), CELLS))
    assert [(cell.line, cell.kind) for cell in found if cell.wrong_ok or cell.wrong_unverified] == []
    assert [(cell.line, cell.kind) for cell in found if not cell.faults or not cell.ok] == []


@pytest.mark.parametrize(("value", "off"), [(1010.0, 0.0), (1010.5, 0.0), (1009.9, 0.1), (1011.0, 0.5)])
def test_a_reading_is_true_when_the_device_could_have_said_it_between_question_and_answer(value, off):
    reading = Reading("tach", "speed_rpm", value, "rpm", Quality.OK, 0, 1_000_000_000, 1_050_000_000)
    assert off_rpm(reading, "rtu") == pytest.approx(off)


def test_every_fault_has_its_cells_and_a_cell_that_was_measured_is_not_measured_again(tmp_path):
    assert len(cells()) == 62
    there = Cell("rtu", "late", 9, 1, 2, 7, 0, 2, 0, 0, 0.0, 0, 0.4)
    (tmp_path / "rtu_late_9_1.json").write_text(str(there.__dict__).replace("'", '"'))
    assert kept(tmp_path, "rtu", "late", 9, 1) == there
    assert "| rtu | `late` | 9 | 2 | 7 | 0 |" in table([there])
