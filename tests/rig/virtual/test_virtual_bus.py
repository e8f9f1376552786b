"""What the virtual bench puts on the wire, seen by pymodbus and by plain bytes."""

from __future__ import annotations

import itertools
import math
import re
import struct
import time

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusIOException

from configs import ConfigError
from rig.readings import NS
from rig.virtual.devices import frames
from rig.virtual.devices.ascii import line_of
from rig.virtual.devices.edge_counter import crc8
from rig.virtual.devices.faults import Place, read_fault
from tests.virtual_benches import MODBUS, WORDS, bench, everything, serving

READ_PRESSURE = bytes.fromhex("010300020002 65CB")  # of the maker's document
READ_FLOW = bytes.fromhex("0001 0000 0006 01 03 003A 0002")


@pytest.fixture(scope="module")
def modbus(tmp_path_factory):
    with serving(bench(MODBUS), tmp_path_factory.mktemp("modbus")) as served:
        yield served


@pytest.fixture(scope="module")
def words(tmp_path_factory):
    with serving(bench(WORDS), tmp_path_factory.mktemp("words")) as served:
        yield served


@pytest.fixture(autouse=True)
def no_faults_left(request):
    yield
    for name in {"modbus", "words"} & set(request.fixturenames):
        request.getfixturevalue(name).ask(do="clear")


@pytest.fixture
def bus(modbus):
    with modbus.serial("bus") as port:
        yield port


@pytest.fixture
def rtu(modbus):
    client = ModbusSerialClient(modbus.ports["lines"]["bus"]["port"], baudrate=19200, timeout=0.6, retries=0)
    assert client.connect()
    yield client
    client.close()


@pytest.fixture
def tcp(modbus):
    place = modbus.ports["lines"]["net"]
    client = ModbusTcpClient(place["host"], port=place["tcp_port"], timeout=1.0, retries=0)
    assert client.connect()
    yield client
    client.close()


def float_of(registers):
    return struct.unpack(">f", struct.pack(">2H", *registers))[0]


def pressure_of(answer):
    return struct.unpack(">f", answer[3:7])[0]


def is_whole(frame):
    return frames.crc(frame[:-2]) == frame[-2:]


def asked(port, request=READ_PRESSURE):
    port.write(request)
    return everything(port, first_s=30.0)


def unanswered(port, request=READ_PRESSURE):
    port.write(request)
    return everything(port) == b""


def test_the_checksum_is_that_of_the_documents():
    assert frames.rtu(1, bytes.fromhex("0300020002")) == READ_PRESSURE
    assert frames.rtu(1, bytes.fromhex("030440C00000")) == bytes.fromhex("01030440C00000EFCF")


def test_pymodbus_reads_the_transmitter_over_a_serial_line(rtu, modbus):
    answer = rtu.read_holding_registers(2, count=2, device_id=1)
    assert float_of(answer.registers) == pytest.approx(1.01325, abs=0.002)


def test_pymodbus_reads_scaled_integers_and_swapped_words_over_tcp(tcp, modbus):
    modbus.ask(do="supply", pressure_bar_abs=2.0)
    modbus.wait_until(lambda state: state["flow_l_min"] > 60.0 and state["pressure_bar_abs"] > 1.9999)
    block = tcp.read_holding_registers(58, count=6, device_id=1).registers
    flow = (block[0] << 16 | block[1]) / 1000.0
    state = modbus.ask(do="state")
    assert flow == pytest.approx(state["flow_kg_s"] / (1.01325e5 / (287.1 * 273.15)) * 60e3, rel=0.02)
    assert float_of(block[5:3:-1]) == pytest.approx(2.0 - 1.01325, abs=1e-4)
    modbus.ask(do="supply", pressure_bar_abs=0.0)


def test_a_unit_that_is_not_there_is_silent(rtu):
    with pytest.raises(ModbusIOException):
        rtu.read_holding_registers(2, count=2, device_id=9)


@pytest.mark.parametrize(
    ("function", "arguments", "code"),
    [
        ("read_holding_registers", {"address": 500, "count": 1}, 2),
        ("read_input_registers", {"address": 2, "count": 2}, 1),
        ("write_register", {"address": 2, "value": 1}, 2),
    ],
)
def test_what_a_device_does_not_have_it_refuses_with_the_standard_s_exception(rtu, function, arguments, code):
    answer = getattr(rtu, function)(**arguments, device_id=1)
    assert answer.isError()
    assert answer.exception_code == code


def test_a_damaged_request_is_not_answered(bus):
    assert unanswered(bus, READ_PRESSURE[:-1] + b"\0")
    assert len(asked(bus)) == 9


def test_a_request_in_two_parts_is_one(bus):
    bus.write(READ_PRESSURE[:3])
    time.sleep(0.005)
    assert len(asked(bus, READ_PRESSURE[3:])) == 9


def test_pymodbus_sets_the_regulator_and_reads_back_what_it_set(rtu, modbus):
    assert not rtu.write_register(0, 800, device_id=2).isError()
    assert rtu.read_holding_registers(0, count=4, device_id=2).registers == [800, 0, 0, 0]
    state = modbus.wait_until(lambda state: abs(state["pressure_bar_abs"] - 2.01325) < 1e-4)
    assert [entry["pressure_bar_abs"] for entry in state["setpoints"]][-1] == pytest.approx(2.01325)
    assert not rtu.write_registers(0, [0], device_id=2).isError()
    modbus.wait_until(lambda state: state["pressure_bar_abs"] < 1.0133)


def test_after_silence_the_communications_safety_sends_the_outputs_to_zero_and_says_so(rtu, modbus):
    assert not rtu.write_register(214, 1, device_id=2).isError()
    assert not rtu.write_register(0, 400, device_id=2).isError()
    state = modbus.wait_until(lambda state: state["vented"])
    on, off = state["setpoints"][-2:]
    silence_s = off["time_s"] - on["time_s"]
    assert 100.0 <= silence_s < 160.0  # 5 s of the wall
    assert rtu.read_holding_registers(0, count=1, device_id=2).registers == [0]
    assert rtu.read_holding_registers(214, count=2, device_id=2).registers == [1, 1]
    assert not rtu.write_register(0, 0, device_id=2).isError()
    assert rtu.read_holding_registers(214, count=2, device_id=2).registers == [1, 0]
    assert not rtu.write_register(214, 0, device_id=2).isError()


def test_a_module_without_power_is_silent_and_comes_back_with_its_outputs_at_zero(rtu, modbus):
    rtu.write_register(0, 400, device_id=2)
    modbus.ask(do="power_cycle", device="dac", by_s=10.0)
    with pytest.raises(ModbusIOException):
        rtu.read_holding_registers(0, count=1, device_id=2)
    modbus.wait_until(lambda state: not state["without_power"])
    assert rtu.read_holding_registers(0, count=1, device_id=2).registers == [0]
    assert modbus.ask(do="state")["vented"]


def test_a_line_keeps_the_pace_of_its_baud_rate(tmp_path):
    with serving(bench(MODBUS), tmp_path, rate=1.0) as served, served.serial("bus") as port:
        whole = frames.rtu(2, bytes.fromhex("0300000004"))
        start = served.clock.now_ns()
        for _ in range(10):
            port.write(whole)
            assert len(port.read(13)) == 13
        spent_s = (served.clock.now_ns() - start) / NS
    wire_s = 10 * (8 + 13) * 10 / 19200
    assert spent_s > 0.99 * wire_s


def test_a_line_that_is_not_paced_is_quicker_than_its_baud_rate_would_be(tmp_path):
    with serving(bench(MODBUS, paced=False), tmp_path, rate=1.0) as served, served.serial("bus") as port:
        whole = frames.rtu(2, bytes.fromhex("0300000004"))
        quickest = 1.0
        for _ in range(10):
            start = time.monotonic()
            port.write(whole)
            assert len(port.read(13)) == 13
            quickest = min(quickest, time.monotonic() - start)
    assert quickest < 21 * 10 / 19200


def test_at_another_baud_rate_nothing_is_understood(modbus):
    with modbus.serial("bus", baud=9600) as port:
        assert unanswered(port)
    with modbus.serial("bus") as port:
        assert len(asked(port)) == 9


def test_requests_seen_are_told(modbus, bus):
    asked(bus)
    last = modbus.ask(do="log", line="bus", last=1)["requests"]
    assert [(entry["device"], entry["request"]) for entry in last] == [("gauge", READ_PRESSURE.hex())]


# the menu of faults, each seen as bytes


def test_late(modbus, bus):
    modbus.ask(do="fault", kind="late", device="gauge", by_s=12.0)
    bus.write(READ_PRESSURE)
    start = modbus.clock.now_ns()
    assert len(bus.read(9)) == 9
    assert (modbus.clock.now_ns() - start) / NS > 11.9


def test_split(modbus, bus):
    modbus.ask(do="fault", kind="split", line="bus", by_s=6.0)
    bus.write(READ_PRESSURE)
    first = bus.read(5)
    start = modbus.clock.now_ns()
    rest = bus.read(4)
    assert (modbus.clock.now_ns() - start) / NS > 4.0
    assert is_whole(first + rest)


def test_dropped(modbus, bus):
    modbus.ask(do="fault", kind="dropped", device="gauge")
    assert unanswered(bus)
    assert len(asked(bus, frames.rtu(2, bytes.fromhex("0300000001")))) == 7  # the other device answers


def test_doubled(modbus, bus):
    modbus.ask(do="fault", kind="doubled", device="gauge")
    answer = asked(bus)
    assert len(answer) == 18
    assert answer[:9] == answer[9:]


def test_corrupt(modbus, bus):
    modbus.ask(do="fault", kind="corrupt", device="gauge")
    answer = asked(bus)
    assert len(answer) == 9
    assert not is_whole(answer)


def test_wrong_unit(modbus, bus):
    modbus.ask(do="fault", kind="wrong_unit", device="gauge")
    answer = asked(bus)
    assert answer[0] == 2
    assert is_whole(answer)


def test_wrong_function(modbus, bus):
    modbus.ask(do="fault", kind="wrong_function", device="gauge")
    answer = asked(bus)
    assert answer[1] == 4
    assert is_whole(answer)


def test_wrong_count(modbus, bus):
    modbus.ask(do="fault", kind="wrong_count", device="gauge")
    answer = asked(bus)
    assert (answer[2], len(answer)) == (6, 11)
    assert is_whole(answer)


def test_wrong_count_over_tcp_has_a_header_that_fits(modbus):
    modbus.ask(do="fault", kind="wrong_count", line="net")
    with modbus.socket("net") as connection:
        connection.sendall(READ_FLOW)
        answer = connection.recv(100)
    assert answer[:2] == READ_FLOW[:2]
    assert int.from_bytes(answer[4:6], "big") == len(answer) - 6 == 9


def test_noise(modbus, bus):
    modbus.ask(do="fault", kind="noise", device="gauge", count=5)
    answer = asked(bus)
    assert len(answer) == 14
    assert is_whole(answer[5:])


def test_echo(modbus, bus):
    modbus.ask(do="fault", kind="echo", device="gauge")
    answer = asked(bus)
    assert answer[:8] == READ_PRESSURE
    assert is_whole(answer[8:])


def test_exception(modbus, rtu):
    modbus.ask(do="fault", kind="exception", device="gauge", code=6)
    assert rtu.read_holding_registers(2, count=2, device_id=1).exception_code == 6


def test_frozen(modbus, bus):
    assert len({asked(bus)[3:7] for _ in range(3)}) > 1  # noise
    modbus.ask(do="fault", kind="frozen", device="gauge")
    assert len({asked(bus)[3:7] for _ in range(3)}) == 1


def test_nan(modbus, bus):
    modbus.ask(do="fault", kind="nan", device="gauge")
    assert math.isnan(pressure_of(asked(bus)))


def test_a_fault_by_chance_befalls_some_replies(modbus, bus):
    modbus.ask(do="fault", kind="wrong_unit", device="gauge", chance=0.5)
    units = []
    for _ in range(30):
        bus.write(READ_PRESSURE)
        units.append(bus.read(9)[0])
    assert 5 < units.count(2) < 25


def test_a_fault_has_its_window(modbus, bus):
    now_s = modbus.clock.now_ns() / NS
    modbus.ask(do="fault", kind="dropped", device="gauge", from_s=now_s + 1000.0)
    assert len(asked(bus)) == 9
    modbus.ask(do="fault", kind="dropped", device="gauge", from_s=0.0, to_s=now_s)
    assert len(asked(bus)) == 9


def test_a_serial_line_that_is_unplugged_hangs_up_and_comes_back_under_its_name(modbus):
    link = modbus.ports["lines"]["bus"]["port"]
    with modbus.serial("bus") as port:
        modbus.ask(do="unplug", line="bus")
        assert modbus.ask(do="state")["lines"]["bus"] is False
        with pytest.raises(OSError):
            port.write(READ_PRESSURE)
            port.read(9)
            raise AssertionError("nothing hung up")
    with pytest.raises(OSError):
        modbus.serial("bus")
    modbus.ask(do="plug", line="bus")
    with modbus.serial("bus") as port:
        assert port.name == link
        assert len(asked(port)) == 9


def test_a_network_cable_that_is_unplugged_breaks_connections_and_takes_none(modbus):
    with modbus.socket("net") as connection:
        modbus.ask(do="fault", kind="unplug", line="net", by_s=20.0)
        assert connection.recv(10) == b""
        with pytest.raises(ConnectionRefusedError):
            modbus.socket("net")
    modbus.wait_until(lambda state: state["lines"]["net"])
    with modbus.socket("net") as connection:
        connection.sendall(READ_FLOW)
        assert connection.recv(100)[:2] == READ_FLOW[:2]


PLACE = Place({"bus": ["gauge", "dac"], "usb": ["tach"]}, frozenset({"gauge", "dac"}))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"kind": "slow", "line": "bus"}, "there is no fault 'slow'; known: late, split,"),
        ({"kind": "late"}, "a fault is laid on a line or on a device: name one of the two"),
        ({"kind": "late", "line": "bus", "device": "dac"}, "a fault is laid on a line or on a device"),
        ({"kind": "late", "line": "can"}, "there is no virtual line 'can' (bus, usb)"),
        ({"kind": "late", "device": "gage"}, "there is no virtual device 'gage' (gauge, dac, tach)"),
        ({"kind": "late", "line": "bus", "chanse": 0.1}, "unknown key 'chanse'; did you mean 'chance'?"),
        ({"kind": "late", "line": "bus", "chance": 2.0}, "'chance' should be less than or equal to 1"),
        ({"kind": "late", "line": "bus", "from_s": 5, "to_s": 4}, "to_s (4) is not after from_s (5)"),
        ({"kind": "dropped", "line": "bus", "by_s": 1.0}, "by_s means nothing to 'dropped'"),
        ({"kind": "unplug", "device": "dac"}, "a line is unplugged, not a device: name the line 'bus'"),
        ({"kind": "unplug", "line": "bus", "chance": 0.5}, "'unplug' happens once"),
        ({"kind": "power_cycle", "line": "bus"}, "a device is power-cycled, not a line: name one of gauge, dac"),
        ({"kind": "exception", "device": "tach"}, "'exception' is a fault of Modbus, which tach does not speak"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused_in_one_line(table, said):
    with pytest.raises(ConfigError) as error:
        read_fault(table, PLACE, "virtual.faults.0")
    assert str(error.value).startswith("virtual.faults.0: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_the_bench_file_s_faults_are_in_force_from_the_start(tmp_path):
    found = bench(MODBUS, 'faults = [{kind = "exception", device = "gauge", code = 5}]')
    with serving(found, tmp_path) as served, served.serial("bus") as port:
        assert asked(port)[1:3] == b"\x83\x05"


# other protocols


def edge_frames(data):
    """Whole frames of the counter, taken apart; anything else is an error."""
    assert len(data) % 10 == 0
    for start in range(0, len(data), 10):
        frame = data[start : start + 10]
        assert frame[0] == 0xA5
        assert crc8(frame[:9]) == frame[9]
        yield chr(frame[1]), frame[2], frame[3], int.from_bytes(frame[4:8], "little"), frame[8]


def test_the_edge_counter_tells_who_it_is_and_is_silent_until_started(modbus):
    with modbus.serial("usb") as port:
        port.write(b"X\nI\n")
        assert re.fullmatch(rb"EDGE1 \S+ \S+ teeth=20 tick_ns=100\n", everything(port))


def test_the_edge_counter_sends_a_heartbeat_every_50_ms_at_rest(modbus):
    modbus.ask(do="supply", pressure_bar_abs=0.0)
    modbus.wait_until(lambda state: state["speed_rpm"] == 0.0 and state["vented"])
    with modbus.serial("usb") as port:
        port.write(b"S\n")
        sent = list(edge_frames(port.read(200)))
        port.write(b"X\n")
        everything(port)
    assert {kind for kind, *_ in sent} == {"H"}
    assert [sequence for _, sequence, *_ in sent] == list(range(20))
    ticks = [frame[3] for frame in sent]
    spans = [(later - earlier) % 2**32 for earlier, later in itertools.pairwise(ticks)]
    assert all(span == pytest.approx(500_000, rel=1e-3) for span in spans)


def test_the_times_of_the_teeth_give_the_speed_of_the_shaft(modbus):
    modbus.ask(do="supply", pressure_bar_abs=1.9)
    modbus.wait_until(lambda state: state["pressure_bar_abs"] > 1.899999 and state["speed_rpm"] > 300.0)
    with modbus.serial("usb") as port:
        port.write(b"S\n")
        before = modbus.ask(do="state")
        sent = list(edge_frames(port.read(8000)))
        after = modbus.ask(do="state")
        port.write(b"X\n")
        everything(port)
    modbus.ask(do="supply", pressure_bar_abs=0.0)
    edges = [frame for frame in sent if frame[0] == "E"]
    assert len(edges) == 800
    counts = [frame[4] for frame in edges]
    assert all((later - earlier) % 256 == 1 for earlier, later in itertools.pairwise(counts))
    spent_s = (edges[-1][3] - edges[0][3]) % 2**32 * 100e-9
    speed_rpm = 60.0 * (len(edges) - 1) / 20 / spent_s
    mean_rpm = (after["angle_rad"] - before["angle_rad"]) / (after["time_s"] - before["time_s"]) * 30.0 / math.pi
    assert speed_rpm == pytest.approx(mean_rpm, rel=5e-3)
    index = [place for place, frame in enumerate(edges) if frame[2] & 2]
    assert {later - earlier for earlier, later in itertools.pairwise(index)} == {20}


def test_an_alicat_answers_to_its_letter_takes_a_set_point_and_refuses_another(words):
    with words.serial("bus") as port:
        assert re.fullmatch(rb"B \+000\.00 \+000\.000\r", asked(port, b"B\r"))
        assert unanswered(port, b"A\r")
        assert asked(port, b"BS14.5\r").endswith(b" +014.500\r")
        state = words.wait_until(lambda state: state["pressure_bar_abs"] > 2.0129)
        assert state["target_bar_abs"] == pytest.approx(14.5 * 0.0689476 + 1.01325, abs=1e-4)
        assert asked(port, b"B\r").startswith(b"B +014.5")
        assert asked(port, b"BS99\r") == b"B ?\r"
        assert asked(port, b"BXYZ\r") == b"B ?\r"
        assert asked(port, b"BHC\r").endswith(b" HLD\r")
        assert words.ask(do="state")["vented"]
        asked(port, b"BC\r")
        asked(port, b"BS0\r")


def test_a_lutron_meter_sends_its_frames_unasked(words):
    words.ask(do="supply", pressure_bar_abs=1.9)
    words.wait_until(lambda state: state["speed_rpm"] > 300.0)
    time.sleep(0.2)
    with words.serial("meter", baud=9600) as port:
        port.reset_input_buffer()
        port.read_until(b"\r")
        frame = port.read(16)
    words.ask(do="supply", pressure_bar_abs=0.0)
    found = re.fullmatch(rb"\x024119(0)1(\d{8})\r", frame)
    assert found
    assert 300.0 < int(found[2]) / 10 < 400.0


def test_a_device_described_by_a_pattern_answers_with_a_line_that_fits_it(words):
    with words.serial("words") as port:
        assert re.fullmatch(rb"\d+\.\d RPM\r\n", asked(port, b"@D0\r"))
        assert asked(port, b"@PI\r") == b"ACT-3X V00001\r\n"
        assert unanswered(port, b"@XX\r")


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        (r"\s?(?P<a>[+-]?\d{1,7}(\.\d{0,4})?)\s?", b"12.50"),
        (r"OK\s+(?P<a>\+\d{5}\.\d{2}) [^x]\w*", b"OK +00012.50 0"),
        (r"(N|S)(?P<a>\d++\.\d++)[A-C]{2}", b"N12.50AA"),
    ],
)
def test_a_line_is_made_of_a_pattern(pattern, line):
    assert line_of(pattern, {"a": ["12.50", "+00012.50"]}) == line


def test_a_pattern_that_no_number_fits_is_refused():
    with pytest.raises(ValueError, match="finds no line that fits"):
        line_of(r"(?P<a>[a-z]+)", {"a": ["12.5"]})
