"""A regulator's own failsafe, asked of a real driver over a pseudo-terminal."""

from pathlib import Path

import pytest

from configs import ConfigError
from rig.acquisition import actions
from rig.acquisition.opening import line_of, port_of
from rig.bench.bench import read_bench
from rig.clock import Clock
from rig.interlock import SafetyError
from rig.interlock.failsafe import regulators, set_and_check
from tests.modbus_peer import ADAM, ModbusPeer

BENCH = """
format = "bench/1"
title = "a regulator and a gauge"
[lines.bus]
kind = "serial"
port = "{port}"
baud = 19200
timeout_s = 0.2
slowest_reply_s = 0.2
[devices.gauge]
instrument = "keller_30x_abs"
line = "bus"
unit_id = 1
[devices.regulator]
instrument = "adam_4024_regulator"
line = "bus"
unit_id = 2
channel = 0
span = [0.0, 5.0]
[lines.other]
kind = "serial"
port = "/dev/ttyUSB7"
[devices.tach]
instrument = "monarch_act3x"
line = "other"
[roles]
pressure = "gauge.pressure_bar_abs"
speed = "tach.speed_rpm"
regulator = "regulator"
[safety]
{safety}
[sweep]
levels_bar_abs = [1.5]
"""


class OneLine:
    """As much of an acquisition as a failsafe needs: its actions, over a real line."""

    def __init__(self, bench):
        self.bench, clock = bench, Clock()
        table = bench.file.lines["bus"]
        self.line = line_of("bus", table, port_of("bus", table, clock), clock)
        self.line.open()

    def command(self, device, action, argument=None, wait_s=5.0):
        exchange, fault = actions.perform(self.line, device, self.bench.build(device), action, argument)
        if fault:
            raise fault
        return exchange


@pytest.fixture
def check(tmp_path: Path):
    """Runs the check against an ADAM-4024 with these registers changed."""

    def run(safety="", read_only=(), units=(2,), **registers):
        held = ADAM | {int(name[1:]): value for name, value in registers.items()}
        with ModbusPeer(dict.fromkeys(units, held), read_only=read_only) as peer:
            path = tmp_path / "bench.toml"
            path.write_text(BENCH.format(port=peer.path, safety=safety))
            bench = read_bench(path)
            acquisition = OneLine(bench)
            try:
                return set_and_check(acquisition, bench), held
            finally:
                acquisition.line.close()

    return run


def test_only_devices_that_take_a_set_point_are_regulators(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(BENCH.format(port="/dev/null", safety=""))
    assert regulators(read_bench(path)) == ["regulator"]


def test_a_failsafe_that_is_on_is_said(check):
    said, _ = check()
    assert len(said) == 1
    assert said[0].startswith("regulator: communications safety is on")


def test_a_failsafe_that_is_off_is_switched_on(check):
    said, held = check(r214=0)
    assert held[214] == 1
    assert said[0].startswith("regulator: communications safety is on")


def test_a_regulator_without_one_is_refused_with_the_line_that_waives_it(check):
    with pytest.raises(SafetyError) as refusal:
        check(r214=0, read_only=(214,))
    assert "regulator: would hold its pressure" in str(refusal.value)
    assert "cannot be switched on" in str(refusal.value)
    assert '[safety] waive_failsafe = ["regulator"]' in str(refusal.value)


def test_a_regulator_that_is_waived_by_name_passes_and_the_record_says_so(check):
    said, _ = check('waive_failsafe = ["regulator"]', r214=0, read_only=(214,))
    assert said[0].startswith("regulator: no communications failsafe, waived by the bench file")


@pytest.mark.parametrize("name", ["gauge", "regulater"])
def test_a_waiver_that_names_no_regulator_is_refused_before_anything_is_asked(check, name):
    with pytest.raises(
        ConfigError, match=f"safety.waive_failsafe: '{name}' is no regulator of this bench \\(regulator\\)"
    ):
        check(f'waive_failsafe = ["{name}"]')


def test_a_regulator_that_does_not_answer_is_refused(check):
    with pytest.raises(SafetyError, match="would hold its pressure"):
        check(units=(9,))
