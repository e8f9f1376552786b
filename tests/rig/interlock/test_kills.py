"""Kill -9: a few moments of the campaign that `make kills` runs two hundred of."""

import random
from pathlib import Path

import pytest

from tests.kills import CAPTURE, kill_once
from tests.kills_of_commands import COMMANDS, half_written
from tests.kills_of_commands import kill_once as kill_command

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize("after_s", [0.4, 5.3])
def test_a_killed_sweep_loses_no_row_and_leaves_the_regulator_at_zero(after_s):
    kill = kill_once(after_s)
    assert kill.fault == ""
    assert not kill.finished
    assert kill.rows_after > 0
    assert kill.raised == (after_s > 5.0)  # so that there was something to take back


@pytest.mark.long
def test_a_killed_capture_loses_no_row_and_leaves_the_regulator_at_zero():
    assert kill_once(2.8, CAPTURE).fault == ""


@pytest.mark.long
@pytest.mark.parametrize("name", ["repair", "export", "export_samples", "import", "diagnose"])
def test_a_killed_command_leaves_nothing_half_written_and_can_be_run_again(name):
    assert kill_command(COMMANDS[name], 2.0, random.Random(f"{name} 1")).faults == []


def test_a_killed_import_leaves_no_part_of_a_recording_and_can_be_run_again():
    kill = kill_command(COMMANDS["import_recording"], 1.0, random.Random(1))
    assert kill.moment.startswith("from the first writing")
    assert kill.faults == []


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b'{"a": 1'),
        ("a.toml", b"a = [1,"),
        ("a.csv", b"a,b\n1,2\n3"),
        ("a.html", b"<html>"),
        ("a.png", b"\x89PNG"),
        ("a.parquet", b"PAR1 and no more"),
        ("a.txt", b""),
    ],
)
def test_what_is_written_by_half_is_seen(name, content):
    assert half_written(Path(name), content)
