"""Register maps with holes, of two tables, or in two files: over real bytes, against the virtual bench's devices."""

import itertools

import pytest

from configs import ConfigError
from rig.acquisition import actions
from rig.acquisition.opening import line_of, timing_of
from rig.bench.bench import DeviceTable, LineTable, Place, bench_of
from rig.clock import Clock
from rig.instruments import modbus
from rig.lines import Line, Timing
from rig.lines.modbus import RefusedError
from rig.lines.serial import SerialPort
from rig.readings import Quality
from rig.replay.player import ReplayPort
from rig.virtual.launch import port_for
from tests.modbus_peer import ModbusPeer
from tests.virtual_benches import serving

MAP = """
format = "instrument/1"
family = "modbus"
title = "logger"
source = "test"
trust = "simulated"
{keys}
[channels.pressure_bar_abs]
unit = "bar"
address = 10
type = "f64"
byte_order = "little"
[channels.temperature_c]
unit = "degC"
address = 20
type = "i16"
scale = 0.1
[channels.setpoint_bar_abs]
unit = "bar"
address = 400
type = "u64"
word_order = "little"
scale = 0.001
[channels.speed_rpm]
unit = "rpm"
registers = "input"
address = 10
type = "f32"
"""
REST = """
format = "instrument/1"
family = "modbus"
title = "logger, the rest"
source = "test"
trust = "simulated"
[channels.ambient_temperature_c]
unit = "degC"
address = 900
type = "f32"
word_order = "little"
byte_order = "little"
"""
BENCH = """
format = "bench/1"
title = "test"
[ambient]
pressure_bar_abs = 1.01325
temperature_c = 20.0
[roles]
pressure = "logger.pressure_bar_abs"
speed = "logger.speed_rpm"
[sweep]
levels_bar_abs = [2.0]
[lines.bus]
{line}
timeout_s = 0.3
slowest_reply_s = 0.4
[devices.logger]
instrument = "map"
line = "bus"
unit_id = 7
[devices.rest]
instrument = "rest"
line = "bus"
unit_id = 7
{same}
[virtual]
"""
SERIAL, TCP = 'kind = "serial"\nport = "virtual"\nbaud = 115200', 'kind = "tcp"\nhost = "virtual"'
TOGETHER = 'same_device_as = "logger"'


def bench(keys="", line=SERIAL, same=TOGETHER):
    sources = {"instruments/map.toml": MAP.format(keys=keys).encode(), "instruments/rest.toml": REST.encode()}
    return bench_of("test", {"bench.toml": BENCH.format(line=line, same=same).encode(), **sources}, "test.toml")


def opened(served, found, device):
    """A driver of the bench on an open line."""
    table = found.file.lines["bus"]
    line = line_of("bus", table, port_for(served.ports, "bus", table, served.clock), served.clock)
    line.open()
    driver = found.build(device)
    driver.open(line)
    return driver, line


@pytest.mark.parametrize("line", [SERIAL, TCP])
def test_a_map_with_holes_of_two_tables_is_read_in_blocks_each_with_its_own_times(tmp_path, line):
    found = bench("largest_gap = 0", line)
    with serving(found, tmp_path, rate=1.0) as served:
        driver, wire = opened(served, found, "logger")
        who = driver.identify(wire)
        readings = {reading.channel: reading for reading in driver.poll(wire)}
        wire.close()
    assert "its 4 blocks read: holding 10 to 13, holding 20, holding 400 to 403, input 10 to 11" in who
    assert {reading.quality for reading in readings.values()} == {Quality.OK}
    assert readings["pressure_bar_abs"].value == pytest.approx(1.01325, abs=1e-4)
    assert readings["temperature_c"].value == pytest.approx(20.0, abs=0.1)
    assert readings["setpoint_bar_abs"].value == pytest.approx(1.013, abs=1e-3)
    assert [readings[name].detail for name in ("pressure_bar_abs", "speed_rpm")] == ["block 1 of 4", "block 4 of 4"]
    times = sorted((reading.request_ns, reading.reply_ns) for reading in readings.values())
    assert all(before[1] <= after[0] for before, after in itertools.pairwise(times))
    assert all(reading.request_ns < reading.time_ns < reading.reply_ns for reading in readings.values())


def test_registers_between_are_read_where_the_file_lets_them_up_to_what_the_device_bears(tmp_path):
    found = bench("largest_gap = 6\nmost_registers = 11")
    with serving(found, tmp_path, rate=1.0) as served:
        driver, wire = opened(served, found, "logger")
        assert [reading.good for reading in driver.poll(wire)] == [True] * 4
        wire.close()
    assert [str(block) for block in driver.blocks] == ["holding 10 to 20", "holding 400 to 403", "input 10 to 11"]


def test_a_device_that_bears_fewer_registers_than_the_file_says_refuses(tmp_path):
    with serving(bench("largest_gap = 6\nmost_registers = 10"), tmp_path, rate=1.0) as served:
        driver, wire = opened(served, bench("largest_gap = 6"), "logger")
        readings = {reading.channel: reading for reading in driver.poll(wire)}
        wire.close()
    assert readings["pressure_bar_abs"].quality is Quality.EXCEPTION
    assert "exception 2" in readings["temperature_c"].detail
    assert readings["speed_rpm"].good  # of another block


@pytest.mark.parametrize(("keys", "named"), [({}, True), ({"largest_gap": 0}, False)])
def test_a_device_that_refuses_a_hole_is_told_with_the_key_that_leaves_it_out(keys, named):
    channels = {name: {"unit": "-", "address": at, "type": "u16"} for name, at in {"a_bar": 10, "b_bar": 20}.items()}
    head = {"format": "instrument/1", "family": "modbus", "title": "t", "source": "s", "trust": "simulated"}
    settings = modbus.Settings.model_validate(head | keys | {"channels": channels})
    place = Place(DeviceTable(instrument="i", line="bus", unit_id=7), LineTable(kind="serial", port="pty"))
    driver, clock = modbus.build("box", settings, place), Clock()
    with ModbusPeer({7: {10: 5} if keys else {10: 5, 20: 5}}) as device:
        wire = Line("bus", SerialPort(device.path, clock, 19200), clock, Timing(0.3, 0.4, 0.005))
        wire.open()
        with pytest.raises(RefusedError, match="exception 2") as refused:
            driver.identify(wire)
        wire.close()
    hint = "holding 10 to 20 has registers that the file does not name: if the device has none there, write largest_gap"
    assert (hint in str(refused.value)) is named
    assert refused.value.code == 2


class Losing(ModbusPeer):
    """Gives no answer to one of its questions."""

    def __init__(self, units, lost):
        self.lost, self.asked = lost, []
        super().__init__(units)

    def _answer(self, frame):
        self.asked.append(int.from_bytes(frame[2:4], "big"))
        return b"" if len(self.asked) == self.lost else super()._answer(frame)


def test_after_a_question_without_an_answer_the_same_block_is_asked_for_first():
    """An answer that comes very late is then an old one of the same registers."""
    found, clock = bench("largest_gap = 0\nretries = 0"), Clock()
    with Losing({7: dict.fromkeys([*range(10, 21), *range(400, 404)], 0)}, 3) as device:
        wire = Line("bus", SerialPort(device.path, clock, 19200), clock, Timing(0.3, 0.4, 0.005))
        wire.open()
        driver = found.build("logger")
        driver.open(wire)
        assert {reading.quality for reading in driver.poll(wire)} == {Quality.TIMEOUT}
        assert all(reading.usable for reading in driver.poll(wire))
        wire.close()
    assert device.asked == [10, 20, 400, 400, 10, 10, 20]


def test_two_files_tell_of_one_device_at_one_unit(tmp_path):
    found = bench("largest_gap = 0")
    with serving(found, tmp_path, rate=1.0) as served:
        for device, count in (("logger", 4), ("rest", 1)):
            driver, wire = opened(served, found, device)
            assert [reading.good for reading in driver.poll(wire)] == [True] * count
            wire.close()


@pytest.mark.parametrize(
    ("same", "words"),
    [
        ("", r'devices\.rest: answers to 7 .* as .logger. does; .* write same_device_as = "logger" here'),
        ('same_device_as = "gone"', r"devices\.rest\.same_device_as: there is no other device 'gone' \(logger\)"),
        ('same_device_as = "rest"', r"devices\.rest\.same_device_as: there is no other device 'rest' \(logger\)"),
        (
            'same_device_as = "far"\n[devices.far]\ninstrument = "rest"\nline = "bus"\nunit_id = 8',
            r"devices\.rest\.same_device_as: 'far' has another line, unit_id or address",
        ),
    ],
)
def test_two_devices_at_one_unit_are_refused_unless_they_say_that_they_are_one(same, words):
    with pytest.raises(ConfigError, match=words):
        bench(same=same)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "quality"), [(2, Quality.UNVERIFIED), (1, Quality.OK)])
def test_for_a_while_after_a_lost_answer_a_block_as_long_as_another_is_not_verified(count, quality):
    """Its answer is not to be told from that to the other, should that come very late."""
    address = {"pressure_bar_abs": 10, "temperature_c": 20}
    units = {"pressure_bar_abs": "bar", "temperature_c": "degC"}
    channels = {name: {"unit": units[name], "address": at, "type": "u16"} for name, at in address.items()}
    if count == 1:
        channels["temperature_c"]["type"] = "u32"  # another length
    keys = {"format": "instrument/1", "family": "modbus", "title": "t", "source": "s", "trust": "simulated"}
    settings = modbus.Settings.model_validate(keys | {"largest_gap": 0, "retries": 0, "channels": channels})
    place = Place(DeviceTable(instrument="i", line="bus", unit_id=7), LineTable(kind="serial", port="pty"))
    driver, clock = modbus.build("box", settings, place), Clock()
    with Losing({7: dict.fromkeys([10, 20, 21], 5)}, 3) as device:
        wire = Line("bus", SerialPort(device.path, clock, 19200), clock, Timing(0.3, 0.4, 0.005))
        wire.open()
        driver.open(wire)
        found = [driver.poll(wire) for _ in range(3)]
        clock.sleep(modbus.MOST_LATE * 0.4)
        found.append(driver.poll(wire))
        wire.close()
    assert [reading.quality for poll in found for reading in poll] == (
        [Quality.OK] * 2 + [Quality.TIMEOUT] * 2 + [quality] * 2 + [Quality.OK] * 2
    )
    assert ("a late answer of a block as long may pass for it" in found[2][0].detail) == (count == 2)


@pytest.mark.slow
@pytest.mark.parametrize("keys", ["", 'transaction_numbers = "any"'])
def test_a_replay_of_blocks_and_lost_answers_gives_the_same_readings(tmp_path, keys):
    found = bench("largest_gap = 0", f"{TCP}\n{keys}")
    with serving(found, tmp_path, rate=1.0) as served:
        driver, wire = opened(served, found, "logger")
        live = []
        for fault in ("", "dropped", "", "exception", "late"):
            if fault:
                served.ask(do="fault", kind=fault, device="logger", chance=1.0 if fault == "dropped" else 0.4)
            live.append(actions.perform(wire, "logger", driver, actions.POLL)[0])
            served.ask(do="clear")
        wire.close()
    port, again = ReplayPort(), found.build("logger")
    line = Line("bus", port, Clock(), timing_of(found.file.lines["bus"]))
    again.open(line)
    for exchange in live:
        port.load(exchange.events)
        assert actions.perform(line, "logger", again, actions.POLL)[0].readings == exchange.readings
    assert port.differences == []
    assert {reading.good for exchange in live for reading in exchange.readings} == {True, False}
