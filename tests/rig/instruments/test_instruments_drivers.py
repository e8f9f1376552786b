"""The drivers over real bytes: a scripted peer on a pty says what a good, a faulty and a strange device say."""

import os
import struct
import threading
from pathlib import Path

import pytest

from rig.acquisition import actions
from rig.bench.bench import DeviceTable, LineTable, Place
from rig.bench.instrument import IdentityError, InstrumentError
from rig.clock import Clock
from rig.instruments import adam_4024, alicat, alicat_modbus, ascii, keller_30x, lutron, manual, modbus
from rig.lines import BadReplyError, Line, LineError, LostError, NoReplyError, Timing
from rig.lines.serial import SerialPort
from rig.readings import Quality
from rig.replay.player import ReplayPort
from tests.instrument_peers import Peer, lutron_bytes, read_instrument
from tests.modbus_peer import rtu

TIMING = Timing(timeout_s=0.05, slowest_reply_s=0.08, quiet_s=0.005)


@pytest.fixture
def bench():
    """Puts a driver on an open line to a peer that replies as told."""
    made = []

    def put(driver, reply=lambda request: None, timing=TIMING):
        peer, clock = Peer(reply), Clock()
        line = Line("bus", SerialPort(peer.path, clock, baud=115200), clock, timing)
        line.open()
        made.append((line, peer))
        driver.open(line)
        return line, peer

    yield put
    for line, peer in made:
        line.close()
        peer.end()


def place(kind="serial", echo=False, data_bits=8, **table):
    lines = {"serial": {"port": "pty", "data_bits": data_bits}, "tcp": {"host": "localhost"}, "keyboard": {}}
    return Place(DeviceTable(instrument="i", line="bus", **table), LineTable(kind=kind, echo=echo, **lines[kind]))


def changed(name, **changes):
    """An instrument's file with other keys."""
    settings = read_instrument(name)
    return type(settings).model_validate(settings.model_dump() | changes)


class Registers:
    """A Modbus slave with some registers; `twist(answer)` spoils what it says."""

    def __init__(self, registers, twist=lambda answer: answer, unit=1, read_only=()):
        self.registers, self.twist, self.unit, self.read_only = dict(registers), twist, unit, read_only

    def __call__(self, request):
        if request[0] != self.unit or rtu(request[:-2]) != request:
            return None
        return self.twist(rtu(bytes([self.unit]) + self.answer(request)))

    def answer(self, request):
        function, (address, count) = request[1], struct.unpack(">HH", request[2:6])
        wanted = range(address, address + (1 if function == 6 else count))
        if any(register not in self.registers for register in wanted):
            return bytes([function | 0x80, 2])
        if function in (3, 4):
            return bytes([function, 2 * count]) + b"".join(self.registers[i].to_bytes(2, "big") for i in wanted)
        if address in self.read_only:
            return bytes([function | 0x80, 2])
        values = [count] if function == 6 else struct.unpack(f">{count}H", request[7:-2])
        self.registers.update(zip(wanted, values, strict=True))
        return request[1:6]


def pulled_out_at_a_write(peers, slave):
    """What a device says whose cable is pulled out as it is written to. `peers`: gets the peer that says it."""

    def reply(request):
        if request[1] != 6:
            return slave(request)
        (peer,) = peers
        peer.ended.set()
        with Path(os.devnull).open() as nothing:
            os.dup2(nothing.fileno(), peer.master)  # the far end of the pty is closed
        return None

    return reply


def floats(first, *numbers):
    words = struct.unpack(f">{2 * len(numbers)}H", struct.pack(f">{len(numbers)}f", *numbers))
    return dict(enumerate(words, first))


def keller(**changes):
    return keller_30x.build("gauge", changed("keller_30x_abs", **changes), place(unit_id=1))


def qualities(readings):
    return [(reading.value, reading.quality) for reading in readings]


def test_a_poll_reads_every_channel_with_its_times(bench):
    driver = keller()
    line, _ = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25)))
    pressure, temperature = driver.poll(line)
    assert (pressure.name, pressure.value, pressure.unit) == ("gauge.pressure_bar_abs", 2.5, "bar")
    assert (temperature.value, temperature.quality, temperature.raw) == (21.25, Quality.OK, "21.25")
    assert 0 < pressure.request_ns <= pressure.time_ns <= pressure.reply_ns
    assert pressure.retries == 0


SPOILED = {
    "wrong unit": (lambda good: rtu(b"\x02" + good[1:-2]), Quality.CRC),
    "wrong function": (lambda good: rtu(good[:1] + b"\x04" + good[2:-2]), Quality.CRC),
    "too few registers": (lambda good: rtu(good[:2] + b"\x04" + good[3:7]), Quality.TIMEOUT),  # more is waited for
    "too many registers": (lambda good: rtu(good[:2] + b"\x10" + good[3:-2] + bytes(4)), Quality.CRC),
    "wrong CRC": (lambda good: good[:-1] + bytes([good[-1] ^ 1]), Quality.CRC),
    "much noise before": (lambda good: bytes(13) + good, Quality.CRC),
    "half": (lambda good: good[:6], Quality.TIMEOUT),
    "silence": (lambda good: None, Quality.TIMEOUT),
    "exception": (lambda good: rtu(bytes([good[0], good[1] | 0x80, 4])), Quality.EXCEPTION),
}


@pytest.mark.parametrize("fault", SPOILED)
def test_a_failed_poll_is_a_reading_without_a_value(bench, fault):
    twist, quality = SPOILED[fault]
    driver = keller()
    line, peer = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25), twist))
    readings = driver.poll(line)
    assert qualities(readings) == [(None, quality)] * 2
    retries = 0 if quality is Quality.EXCEPTION else 1  # a refusal is an answer
    assert {reading.retries for reading in readings} == {retries}
    assert len(peer.requests) == retries + 1
    assert readings[0].detail and readings[0].reply_ns >= readings[0].request_ns > 0


def test_the_echo_of_the_question_is_no_reading(bench):
    driver = keller()
    line, _ = bench(driver, lambda request: request)
    assert qualities(driver.poll(line))[0][0] is None


def test_a_retry_is_counted(bench):
    answers = iter([lambda good: None, lambda good: good])
    driver = keller()
    line, _ = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25), lambda good: next(answers)(good)))
    assert [(r.value, r.retries) for r in driver.poll(line)] == [(2.5, 1), (21.25, 1)]


def test_an_answer_that_came_too_late_costs_no_retry(bench):
    """The first question is answered at the second: two answers to one, of which nobody knows which is which."""
    answers = iter([lambda good: None, lambda good: 2 * good, lambda good: good])
    driver = keller()
    line, _ = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25), lambda good: next(answers)(good)))
    assert [(r.value, r.retries) for r in driver.poll(line)] == [(2.5, 2), (21.25, 2)]


def test_a_doubled_answer_is_read_once(bench):
    driver = keller()
    slave = Registers(floats(2, 2.5, 0.0, 21.25), lambda good: good + good)
    line, _ = bench(driver, slave)
    assert driver.poll(line)[0].value == 2.5
    slave.registers.update(floats(2, 3.5, 0.0, 21.25))
    assert driver.poll(line)[0].value == 3.5


@pytest.mark.parametrize(
    ("number", "value", "quality", "censored"),
    [
        (float("nan"), None, Quality.EXCEPTION, 0),
        (float("inf"), 10.0, Quality.OVER_RANGE, 1),
        (float("-inf"), 0.0, Quality.OVER_RANGE, -1),
    ],
)
def test_a_keller_s_marks_are_faults_of_the_channel_alone(bench, number, value, quality, censored):
    driver = keller()
    line, _ = bench(driver, Registers(floats(2, number, 0.0, 21.25)))
    pressure, temperature = driver.poll(line)
    assert (pressure.value, pressure.quality, pressure.censored) == (value, quality, censored)
    assert (temperature.value, temperature.quality) == (21.25, Quality.OK)


def test_three_failed_polls_in_a_row_mark_a_device_and_one_good_one_clears_it(bench):
    driver = keller(retries=0)
    silent = [True]
    line, _ = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25), lambda good: None if silent[0] else good))
    for failing in (False, False, True):
        driver.poll(line)
        assert driver.failing is failing
    silent[0] = False
    assert driver.poll(line)[0].value == 2.5
    assert not driver.failing


def test_a_failing_device_is_probed_without_retries(bench):
    driver = keller()
    line, peer = bench(driver)
    for _ in range(4):
        driver.poll(line)
    assert len(peer.requests) == 3 * 2 + 1


def test_a_block_that_never_changes_goes_stale(bench):
    driver = keller(stale_s=0.05)
    slave = Registers(floats(2, 2.5, 0.0, 21.25))
    line, _ = bench(driver, slave)
    assert driver.poll(line)[0].quality is Quality.OK
    line.clock.sleep(0.06)
    stale = driver.poll(line)[0]
    assert (stale.value, stale.quality, stale.raw) == (None, Quality.STALE, "2.5")
    slave.registers.update(floats(2, 2.5, 0.0, 21.5))  # the other channel moves: the device lives
    assert driver.poll(line)[0].quality is Quality.OK


def test_another_device_in_the_keller_s_place_is_told(bench):
    driver = keller()
    line, _ = bench(driver, Registers(dict.fromkeys(range(2, 8), 0x7000)))
    with pytest.raises(IdentityError, match=r"gauge: unit 1 gives .* another device answers"):
        driver.identify(line)


def test_a_dead_device_is_not_identified(bench):
    driver = keller()
    line, _ = bench(driver)
    with pytest.raises(NoReplyError):
        driver.identify(line)


def test_a_lost_port_is_no_reading(bench):
    driver = keller()
    line, _ = bench(driver)
    line.close()
    with pytest.raises(LostError):
        driver.poll(line)


def test_a_replay_of_the_wire_gives_the_same_readings(bench):
    answers = iter([lambda good: good, lambda good: None, lambda good: good[:5], lambda good: good])
    driver = keller()
    line, _ = bench(driver, Registers(floats(2, 2.5, 0.0, 21.25), lambda good: next(answers)(good)))
    live = [actions.perform(line, "gauge", driver, actions.POLL)[0] for _ in range(3)]

    port = ReplayPort()
    again, replayed = keller(), Line("bus", port, Clock(), TIMING)
    again.open(replayed)
    for exchange in live:
        port.load(exchange.events)
        assert actions.perform(replayed, "gauge", again, actions.POLL)[0].readings == exchange.readings
    assert port.differences == []
    assert [exchange.readings[0].value for exchange in live] == [2.5, None, 2.5]


# Generic Modbus.


def generic(setpoint=True, **changes):
    data = {"format": "instrument/1", "family": "modbus", "title": "box", "source": "s", "trust": "documented"}
    data["channels"] = {
        "flow_l_min": {"unit": "L/min", "address": 10, "type": "u32", "scale": 0.001},
        "temperature_c": {"unit": "degC", "address": 13, "type": "i16", "scale": 0.1},
    }
    if setpoint:
        table = {"address": 40, "type": "u16", "scale": 0.01, "unit": "bar abs", "lowest": 0.0, "highest": 5.0}
        data["setpoint"] = table | ({} if setpoint is True else setpoint)
    return modbus.build("box", modbus.Settings.model_validate(data | changes), place(unit_id=1))


BOX = {10: 0, 11: 20340, 12: 0, 13: 0xFF38, 40: 0}


def test_a_generic_device_is_read_as_one_block(bench):
    driver = generic()
    line, peer = bench(driver, Registers(BOX))
    assert [reading.value for reading in driver.poll(line)] == [pytest.approx(20.34), pytest.approx(-20.0)]
    assert peer.requests == [rtu(bytes([1, 3, 0, 10, 0, 4]))]


def test_input_registers_are_asked_with_function_4(bench):
    driver = generic(registers="input")
    line, peer = bench(driver, Registers(BOX))
    assert driver.poll(line)[0].good
    assert peer.requests[0][1] == 4


def test_the_identity_register_tells_another_device(bench):
    check = {"address": 5, "values": [0x4711], "meaning": "model"}
    driver = generic(identity=check)
    line, _ = bench(driver, Registers(BOX | {5: 0x4711}))
    assert "model: 18193" in driver.identify(line)
    line, _ = bench(driver, Registers(BOX | {5: 7}))
    with pytest.raises(IdentityError, match="register 5 of unit 1 holds 7, not 18193"):
        driver.identify(line)


def test_a_set_point_is_written_once_and_read_back(bench):
    driver = generic()
    slave = Registers(BOX)
    line, peer = bench(driver, slave)
    assert driver.write(line, 2.5) == pytest.approx(2.5)
    assert slave.registers[40] == 250
    assert [request[1] for request in peer.requests] == [6, 3]


def test_a_set_point_that_does_not_arrive_is_an_error(bench):
    driver = generic()
    slave = Registers(BOX)
    slave.registers[40] = 100
    line, _ = bench(driver, lambda request: None if request[1] == 6 else slave(request))
    with pytest.raises(InstrumentError, match=r"was ordered 2\.5 bar abs and reads back 1 bar abs; .* not confirmed"):
        driver.write(line, 2.5)


def test_a_set_point_whose_confirmation_is_lost_counts_when_it_reads_back(bench):
    driver = generic()
    slave = Registers(BOX)

    def reply(request):
        answer = slave(request)
        return None if request[1] == 6 else answer

    line, peer = bench(driver, reply)
    assert driver.write(line, 2.5) == pytest.approx(2.5)
    assert [request[1] for request in peer.requests].count(6) == 1


@pytest.mark.parametrize("value", [-0.1, 5.1, float("nan")])
def test_a_set_point_outside_the_limits_is_not_sent(bench, value):
    driver = generic()
    line, peer = bench(driver, Registers(BOX))
    with pytest.raises(InstrumentError, match="is not a set-point; it takes 0 to 5 bar abs"):
        driver.write(line, value)
    assert peer.requests == []


def test_a_device_that_refuses_a_set_point_is_told(bench):
    driver = generic()
    line, _ = bench(driver, Registers(BOX, read_only=[40]))
    with pytest.raises(InstrumentError, match=r"box refuses 1 bar abs: .*illegal register address"):
        driver.write(line, 1.0)


def test_a_cable_that_is_pulled_out_at_a_set_point_is_told_as_such_and_nothing_is_read_back(bench):
    driver, peers = generic(), []
    line, peer = bench(driver, pulled_out_at_a_write(peers, Registers(BOX)))
    peers.append(peer)
    with pytest.raises(LostError):
        driver.write(line, 2.5)
    assert [request[1] for request in peer.requests] == [6]


def test_a_set_point_that_does_not_fit_its_register_is_told_and_not_sent(bench):
    driver = generic(setpoint={"scale": 1e-5})
    line, peer = bench(driver, Registers(BOX))
    with pytest.raises(InstrumentError, match=r"box: .*250000"):
        driver.write(line, 2.5)
    assert peer.requests == []


def test_a_set_point_that_is_a_float_is_read_back_to_a_millionth(bench):
    driver = generic(setpoint={"type": "f32", "scale": 1.0})
    takes, holds = Registers(BOX | {41: 0}), Registers(floats(40, 2.1001))
    line, _ = bench(driver, takes)
    assert driver.write(line, 2.1) == pytest.approx(2.1, rel=1e-6)
    line, _ = bench(driver, lambda request: holds(request) if request[1] == 3 else takes(request))
    with pytest.raises(InstrumentError, match=r"was ordered 2\.1 bar abs and reads back 2\.1001 bar abs"):
        driver.write(line, 2.1)


@pytest.mark.parametrize(("tolerance", "is_taken"), [(0.06, True), (0.04, False)])
def test_a_device_that_rounds_a_set_point_may_be_off_by_what_its_file_says(bench, tolerance, is_taken):
    takes, holds = Registers(BOX), Registers({40: 210})
    driver = generic(setpoint={"tolerance": tolerance})
    line, _ = bench(driver, lambda request: holds(request) if request[1] == 3 else takes(request))
    if is_taken:
        assert driver.write(line, 2.15) == pytest.approx(2.1)
        return
    with pytest.raises(InstrumentError, match=r"reads back 2\.1 bar abs"):
        driver.write(line, 2.15)


def test_a_device_that_has_none_of_the_registers_gives_no_value_and_says_so(bench):
    driver = generic()
    line, _ = bench(driver, Registers({}))
    readings = driver.poll(line)
    assert qualities(readings) == [(None, Quality.EXCEPTION)] * 2
    assert all("illegal register address" in reading.detail for reading in readings)


def test_without_a_set_point_table_nothing_can_be_written():
    assert not hasattr(generic(setpoint=False), "write")


def test_a_generic_device_has_no_failsafe(bench):
    driver = generic()
    line, _ = bench(driver)
    with pytest.raises(InstrumentError, match="no communications failsafe is described"):
        driver.set_failsafe(line)


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (place(), r"devices\.box\.unit_id: the key is missing"),
        (place(unit_id=0), "0 is no unit of an RTU bus"),
        (place(unit_id=1, data_bits=7), r"lines\.bus\.data_bits: Modbus RTU has 8"),
        (place(kind="keyboard", unit_id=1), "cannot be on a keyboard"),
        (place(kind="tcp", echo=True, unit_id=1), r"lines\.bus\.echo: is of a serial bus, and this is Modbus TCP"),
    ],
)
def test_a_bench_file_that_cannot_place_a_modbus_device_is_refused(where, words):
    with pytest.raises(ValueError, match=words):
        modbus.build("box", generic().settings, where)


# ADAM-4024.

ADAM = dict.fromkeys(range(4), 0) | dict.fromkeys(range(200, 204), 0x31) | {214: 0, 215: 0}
ADAM |= {210: 0x4024, 211: 0, 212: 0xA200, 213: 0}


def adam(**table):
    where = place(**{"unit_id": 1, "channel": 2, "span": [0.0, 5.0]} | table)
    return adam_4024.build("dac", read_instrument("adam_4024_regulator"), where)


def test_an_adam_tells_its_name_version_and_range(bench):
    driver = adam()
    line, _ = bench(driver, Registers(ADAM))
    assert driver.identify(line) == "Advantech ADAM-4024 at unit 1 (version A200 0000; output 2: 4-20 mA)"


def test_an_adam_that_does_not_tell_its_name_is_known_by_its_range(bench):
    driver = adam()
    line, _ = bench(driver, Registers({register: held for register, held in ADAM.items() if not 210 <= register < 214}))
    assert driver.identify(line).endswith("at unit 1 (it does not tell its name; output 2: 4-20 mA)")


def test_an_adam_that_is_busy_as_it_starts_is_not_taken_for_one_without_a_name(bench):
    driver = adam()
    line, _ = bench(driver, lambda request: rtu(bytes([1, request[1] | 0x80, 6])))
    with pytest.raises(LineError, match="busy"):
        driver.identify(line)


@pytest.mark.parametrize(("register", "words"), [(210, "calls itself 4017, not 4024"), (202, "type code 0x4017")])
def test_another_module_or_range_is_told(bench, register, words):
    driver = adam()
    line, _ = bench(driver, Registers(ADAM | {register: 0x4017}))
    with pytest.raises(IdentityError, match=words):
        driver.identify(line)


def test_an_adam_sets_its_own_output_alone(bench):
    driver = adam()
    slave = Registers(ADAM)
    line, _ = bench(driver, slave)
    assert driver.write(line, 2.0) == pytest.approx(2.0, abs=0.001)
    assert [slave.registers[i] for i in range(4)] == [0, 0, 1638, 0]
    (reading,) = driver.poll(line)
    assert (reading.channel, reading.raw, reading.quality) == ("setpoint_bar_gauge", "1638 counts", Quality.OK)
    assert reading.value == pytest.approx(2.0, abs=0.001)


def test_an_output_that_went_to_its_safe_value_is_a_fault(bench):
    driver = adam()
    line, _ = bench(driver, Registers(ADAM | {214: 1, 215: 1}))
    (reading,) = driver.poll(line)
    assert (reading.value, reading.quality) == (None, Quality.EXCEPTION)
    assert "communications safety has occurred" in reading.detail


def test_the_communications_safety_is_switched_on_and_read_back(bench):
    driver = adam()
    slave = Registers(ADAM)
    line, _ = bench(driver, slave)
    assert "40215 read back as 1" in driver.set_failsafe(line)
    assert slave.registers[214] == 1


def test_a_communications_safety_that_does_not_take_is_an_error(bench):
    driver = adam()
    line, _ = bench(driver, Registers(ADAM, read_only=[214]))
    with pytest.raises(InstrumentError, match="is off and cannot be switched on over Modbus"):
        driver.set_failsafe(line)


def test_a_cable_that_is_pulled_out_as_the_communications_safety_is_set_is_told_as_such(bench):
    driver, peers = adam(), []
    line, peer = bench(driver, pulled_out_at_a_write(peers, Registers(ADAM)))
    peers.append(peer)
    with pytest.raises(LostError):
        driver.set_failsafe(line)


@pytest.mark.parametrize(
    ("table", "words"), [({"channel": 4}, "0 to 3"), ({"channel": None}, "0 to 3"), ({"span": None}, "span")]
)
def test_a_bench_file_that_does_not_say_output_or_span_is_refused(table, words):
    with pytest.raises(ValueError, match=words):
        adam(**table)


# Alicat, both protocols.


class AlicatPeer:
    """A controller that talks text."""

    def __init__(self, deaf=False, flags=""):
        self.setpoint, self.deaf, self.flags, self.number = 0.0, deaf, flags, 1.25

    def __call__(self, request):
        text = request.decode()
        if text.startswith("AS") and not self.deaf:
            self.setpoint = float(text[2:])
        if text[0] != "A" or text[1] not in "S\r":
            return b"A ?\r"
        return f"A {self.number:+.3f} {self.setpoint:+.3f} {self.flags}".strip().encode() + b"\r"


def alicat_driver(address="A"):
    return alicat.build("regulator", read_instrument("alicat_pc_ascii"), place(address=address))


def test_an_alicat_value_is_verified_by_the_next_poll(bench):
    driver, peer = alicat_driver(), AlicatPeer()
    line, _ = bench(driver, peer)
    first, second = driver.poll(line)[0], driver.poll(line)[0]
    assert [(r.value, r.quality) for r in (first, second)] == [(1.25, Quality.UNVERIFIED), (1.25, Quality.OK)]
    peer.number = 1.5
    assert driver.poll(line)[0].quality is Quality.UNVERIFIED


def test_an_alicat_flag_stays_on_the_reading(bench):
    driver = alicat_driver()
    line, _ = bench(driver, AlicatPeer(flags="POV HLD"))
    reading = driver.poll(line)[0]
    assert (reading.quality, reading.value, reading.detail) == (Quality.OVER_RANGE, 1.25, "POV HLD")


def test_an_alicat_set_point_is_read_back(bench):
    driver, peer = alicat_driver(), AlicatPeer()
    line, wire = bench(driver, peer)
    assert driver.write(line, 2.125) == 2.125
    assert wire.requests == [b"AS2.125\r", b"A\r"]


def test_an_alicat_that_keeps_its_set_point_is_told(bench):
    driver = alicat_driver()
    line, _ = bench(driver, AlicatPeer(deaf=True))
    with pytest.raises(InstrumentError, match="ordered 2 bar abs and reads back 0 bar abs"):
        driver.write(line, 2.0)


def test_dashes_in_the_place_of_alicat_s_set_point_cost_no_reading_and_confirm_no_order(bench):
    driver = alicat_driver()
    line, _ = bench(driver, lambda request: b"A +1.250 ------\r")
    assert [driver.poll(line)[0].value, driver.poll(line)[0].quality] == [1.25, Quality.OK]
    with pytest.raises(BadReplyError, match="'------' stands where the layout has setpoint"):
        driver.write(line, 2.0)


def test_an_alicat_s_question_mark_is_a_refusal(bench):
    driver = alicat_driver()
    line, _ = bench(driver, lambda request: b"A ?\r")
    assert qualities(driver.poll(line)) == [(None, Quality.EXCEPTION)]
    with pytest.raises(InstrumentError, match="regulator refuses 1 bar abs: unit A refuses"):
        driver.write(line, 1.0)


def test_half_an_alicat_frame_from_before_is_dropped(bench):
    driver = alicat_driver()
    line, peer = bench(driver, AlicatPeer())
    peer.send(b".750 +1.000\r")
    assert driver.poll(line)[0].value == 1.25


@pytest.mark.parametrize("module", [alicat, alicat_modbus])
def test_alicat_s_controllers_have_no_documented_failsafe(bench, module):
    name = {alicat: "alicat_pc_ascii", alicat_modbus: "alicat_pc_modbus"}[module]
    driver = module.build("regulator", read_instrument(name), place(address="A", unit_id=1))
    line, _ = bench(driver)
    with pytest.raises(InstrumentError, match=r"no communications failsafe .* documented"):
        driver.set_failsafe(line)


def test_an_alicat_s_letter_is_one(bench):
    with pytest.raises(ValueError, match="'a1' is no unit; it is one letter, A to Z"):
        alicat_driver("a1")


def test_an_alicat_over_modbus_is_read_and_set(bench):
    driver = alicat_modbus.build("regulator", read_instrument("alicat_pc_modbus"), place(unit_id=1))
    slave = Registers({1200: 0, 1201: 0} | floats(1202, 1.25, 20.0, 1.0, 2.0) | floats(1009, 0.0))
    line, _ = bench(driver, slave)
    assert qualities(driver.poll(line)) == [(1.25, Quality.OK)]
    assert driver.write(line, 2.125) == 2.125
    slave.registers[1201] = 1 << 6 | 1 << 8
    reading = driver.poll(line)[0]
    assert (reading.quality, reading.detail) == (Quality.OVER_RANGE, "POV HLD")


@pytest.mark.parametrize(("status", "note"), [(0, ""), (1 << 8, "; flags HLD")])
def test_an_alicat_over_modbus_is_identified_by_its_block_with_its_flags(bench, status, note):
    driver = alicat_modbus.build("regulator", read_instrument("alicat_pc_modbus"), place(unit_id=1))
    line, _ = bench(driver, Registers({1200: 0, 1201: status} | floats(1202, 1.25, 20.0, 1.0, 2.0)))
    assert driver.identify(line).endswith(f"at unit 1 (its block reads; it is not asked who it is{note})")


# Generic text.


def monarch(serial_number="", **changes):
    return ascii.build("tach", changed("monarch_act3x", **changes), place(serial_number=serial_number))


def test_a_text_device_is_asked_and_verified_by_the_next_poll(bench):
    driver = monarch()
    answers = iter([b"394.8\r\n", b"395.0\r\n", b"420.0\r\n"])
    line, peer = bench(driver, lambda request: next(answers))
    found = [qualities(driver.poll(line))[0] for _ in range(3)]
    assert found == [(394.8, Quality.UNVERIFIED), (395.0, Quality.OK), (420.0, Quality.UNVERIFIED)]
    assert peer.requests == [b"@D3\r"] * 3


@pytest.mark.parametrize(
    ("answer", "quality"),
    [
        (b"ERR\r\n", Quality.EXCEPTION),
        (b"@D4\r\n394.8\r\n", Quality.CRC),  # of another question
        (b"39\xb4.8\r\n", Quality.CRC),
        (b"9" * 300, Quality.CRC),
        (b"394.8", Quality.TIMEOUT),
        (b"100001.0\r\n", Quality.OVER_RANGE),
    ],
)
def test_a_text_that_is_no_value_is_not_taken_for_one(bench, answer, quality):
    driver = monarch()
    line, _ = bench(driver, lambda request: answer)
    reading = driver.poll(line)[0]
    assert reading.quality is quality
    assert reading.value == (99999.0 if quality is Quality.OVER_RANGE else None)


@pytest.mark.parametrize("echo", [False, True])
@pytest.mark.parametrize("pieces", [1, 2])
def test_the_echo_of_a_question_in_text_is_skipped_and_told_once_where_no_key_expects_it(bench, echo, pieces):
    where = place(echo=echo)
    driver = ascii.build("tach", changed("monarch_act3x"), where)
    line, peer = bench(driver)

    def reply(request):
        whole = request + b"+0600.00\r\n"
        peer.send(whole[:2] if pieces == 2 else b"")
        return whole[2:] if pieces == 2 else whole

    peer.reply = reply
    assert [driver.poll(line)[0].value for _ in range(2)] == [600.0, 600.0]
    assert len(line.take_remarks()) == (0 if echo else 1)
    driver.poll(line)
    assert line.take_remarks() == []


def test_the_echo_of_a_question_in_text_may_come_in_two_parts(bench):
    driver = monarch()
    line, _ = bench(driver, lambda request: [(0.0, request[:2]), (0.02, request[2:] + b"+0600.00\r\n")])
    assert driver.poll(line)[0].value == 600.0


@pytest.mark.parametrize("behind", [b"", b"> "])
def test_a_terminal_s_echo_has_a_line_feed_and_a_prompt_follows(bench, behind):
    driver = monarch()
    line, _ = bench(driver, lambda request: request + b"\n+0600.00\r\n" + behind)
    assert [driver.poll(line)[0].value for _ in range(3)] == [600.0] * 3


@pytest.mark.parametrize(
    ("terminator", "answer"), [("\n", b"+0600.00\r\n"), ("\r", b"+0600.00\n\r"), ("\r\n", b"\0\n+0600.00\r\n")]
)
def test_another_way_to_end_lines_costs_no_reading(bench, terminator, answer):
    driver = ascii.build("tach", changed("monarch_act3x", terminator=terminator), place())
    line, _ = bench(driver, lambda request: answer)
    assert [driver.poll(line)[0].value for _ in range(3)] == [600.0] * 3


def test_the_echo_alone_of_a_question_in_text_is_no_answer(bench):
    driver = alicat_driver()
    line, _ = bench(driver, lambda request: request)
    assert qualities(driver.poll(line))[0] == (None, Quality.TIMEOUT)
    with pytest.raises(NoReplyError, match="its own question, as an echo, and no answer"):
        driver.identify(line)


def test_an_alicat_is_told_by_the_layout_of_its_frame(bench):
    driver = alicat_driver()
    line, _ = bench(driver, AlicatPeer())
    assert "unit A (its frame has the layout" in driver.identify(line)


def test_an_alicat_s_set_point_is_taken_over_a_line_that_echoes(bench):
    driver = alicat_driver()
    slave = AlicatPeer()
    line, _ = bench(driver, lambda request: request + slave(request))
    assert driver.write(line, 1.0) == pytest.approx(1.0)


def test_a_text_device_s_number_is_checked(bench):
    keys = {"identity_query": "@PI\r", "identity_pattern": r"ACT-3X (?P<serial>\d{1,8})"}
    line, _ = bench(monarch(), lambda request: b"ACT-3X 1234\r\n")
    assert monarch("1234", **keys).identify(line) == "ACT-3X 1234"
    with pytest.raises(IdentityError, match="number '1234' answers, the bench file says '99'"):
        monarch("99", **keys).identify(line)


@pytest.mark.parametrize("pattern", [None, "ACT-3X.{0,20}"])
def test_the_number_of_a_text_device_that_does_not_tell_it_is_taken_as_it_is_said(bench, pattern):
    keys = {"identity_query": "@PI\r", "identity_pattern": pattern} if pattern else {}
    line, _ = bench(monarch(), lambda request: b"ACT-3X 1234\r\n" if pattern else b"394.8\r\n")
    assert monarch("99", **keys).identify(line)


def test_another_text_device_is_told(bench):
    driver = monarch(identity_query="@PI\r", identity_pattern="ACT-3X.{0,20}")
    line, _ = bench(driver, lambda request: b"PAX \x1b[2J\r\n")
    with pytest.raises(IdentityError, match=r"'PAX \\x1b\[2J' answers, which is not a Monarch ACT-3X"):
        driver.identify(line)


def test_the_first_line_that_comes_unasked_is_dropped_and_the_newest_is_read(bench):
    driver = monarch(query="")
    line, peer = bench(driver)
    peer.send(b"4.8\r\n395.0\r\n396.0\r\n39")
    assert qualities(driver.poll(line)) == [(396.0, Quality.UNVERIFIED)]
    peer.send(b"6.5\r\n")
    assert qualities(driver.poll(line)) == [(396.5, Quality.OK)]


def test_where_the_first_line_that_comes_unasked_is_alone_the_next_is_waited_for(bench):
    driver = monarch(query="")
    line, peer = bench(driver)
    peer.send(b"4.8\r\n")
    later = threading.Timer(0.02, peer.send, [b"395.0\r\n"])
    later.start()
    assert qualities(driver.poll(line)) == [(395.0, Quality.UNVERIFIED)]
    later.join()


# Lutron.


def meter(**changes):
    return lutron.build("tach", changed("lutron_tachometer", timeout_s=0.1, retries=0, **changes), place())


def test_a_lutron_meter_is_listened_to(bench):
    driver = meter()
    line, peer = bench(driver)
    frame = bytes.fromhex("02 34 31 31 39 30 31 30 30 30 30 34 33 31 30 0D")
    peer.send(frame[5:] + b"\x02\x02" + frame + frame[:7])
    reading = driver.poll(line)[0]
    assert (reading.value, reading.quality, reading.raw) == (431.0, Quality.UNVERIFIED, "41190100004310")
    assert "unit code 19 (not checked" in reading.detail
    peer.send(frame[7:])
    assert qualities(driver.poll(line)) == [(431.0, Quality.OK)]


def test_a_lutron_meter_set_to_another_unit_is_a_fault(bench):
    channel = read_instrument("lutron_tachometer").channels["speed_rpm"].model_dump() | {"unit_codes": ["19"]}
    driver = meter(channels={"speed_rpm": channel})
    line, peer = bench(driver)
    peer.send(lutron_bytes(lutron.Frame("1", "08", 431.0), 1))
    reading = driver.poll(line)[0]
    assert (reading.value, reading.quality) == (None, Quality.EXCEPTION)
    assert "unit code 08, not 19" in reading.detail


def test_of_two_displays_one_may_be_silent_and_a_third_is_none_of_the_file(bench):
    speed = read_instrument("lutron_tachometer").channels["speed_rpm"].model_dump()
    driver = meter(channels={"speed_rpm": speed, "temperature_c": speed | {"unit": "degC", "display": "2"}})
    line, peer = bench(driver)
    peer.send(lutron_bytes(lutron.Frame("1", "08", 431.0), 1))
    found, silent = driver.poll(line)
    assert (found.value, silent.value, silent.quality) == (431.0, None, Quality.TIMEOUT)
    assert "no frame of display 2" in silent.detail
    peer.send(lutron_bytes(lutron.Frame("3", "08", 431.0), 1))
    assert qualities(driver.poll(line)) == [(None, Quality.CRC)] * 2
    peer.send(lutron_bytes(lutron.Frame("1", "08", 432.0), 1))
    assert "its frames come; " in driver.identify(line)


def test_a_meter_that_never_stops_sending_and_sends_no_frame_is_not_waited_for(bench):
    driver = meter()
    line, peer = bench(driver)
    ended = threading.Event()

    def send():
        while not ended.wait(0.01):
            peer.send(b"rubbish")

    sending = threading.Thread(target=send)
    sending.start()
    try:
        reading = driver.poll(line)[0]
    finally:
        ended.set()
        sending.join()
    assert reading.quality is Quality.CRC
    assert "bytes in 0.1 s, and no whole frame among them" in reading.detail


@pytest.mark.parametrize(("noise", "quality"), [(b"", Quality.TIMEOUT), (b"\x02garbage", Quality.CRC)])
def test_a_meter_that_sends_no_frame_gives_no_value(bench, noise, quality):
    driver = meter()
    line, peer = bench(driver)
    peer.send(noise) if noise else None
    assert qualities(driver.poll(line)) == [(None, quality)]


# By hand.


def person(**changes):
    return manual.build("person", changed("manual_bench", **changes), place(kind="keyboard"))


def test_a_person_is_asked_again_until_the_entry_can_be_read(bench):
    answers = iter([b"2,00 72 394\n", b"2.00 <10 394\n"])
    driver = person(timeout_s=1.0)
    line, peer = bench(driver, lambda prompt: next(answers))
    pressure, flow, speed = driver.poll(line)
    assert (pressure.value, pressure.quality, speed.value) == (2.0, Quality.MANUAL, 394.0)
    assert (flow.value, flow.censored, flow.raw) == (10.0, -1, "<10")
    assert peer.requests[0].startswith(b"person: pressure_bar_abs [bar], flow_l_min [L/min], speed_rpm [rpm]")
    assert b"write the decimals after a dot" in peer.requests[1]


def test_a_person_whose_entries_can_never_be_read_is_a_gap_that_says_why(bench):
    driver = person(timeout_s=1.0)
    line, peer = bench(driver, lambda prompt: b"two\n")
    readings = driver.poll(line)
    assert qualities(readings) == [(None, Quality.EXCEPTION)] * 3
    assert f"{len(peer.requests)} entries could not be read; the last: " in readings[0].detail
    assert "separated by spaces" in driver.identify(line)


def test_what_is_typed_in_the_unit_of_a_face_is_logged_in_the_columns(bench):
    faces = read_instrument("manual_bench").model_dump()["channels"]
    faces["pressure_bar_abs"] |= {"unit": "psi", "highest": 87.0, "bias_sd": 0.8}
    driver = person(timeout_s=1.0, channels=faces)
    line, _ = bench(driver, lambda prompt: b"29 72 394\n")
    pressure = driver.poll(line)[0]
    assert (pressure.value, pressure.unit) == (pytest.approx(1.99948, abs=1e-5), "bar")
    figures = driver.channels["pressure_bar_abs"]
    assert (figures.unit, figures.bias_sd) == ("bar", pytest.approx(0.055158, abs=1e-6))
    assert figures.highest == pytest.approx(5.99844, abs=1e-5)
    with pytest.raises(ValueError, match="'furlong' is not known for pressure_bar_abs: one of bar, mbar"):
        person(channels=faces | {"pressure_bar_abs": faces["pressure_bar_abs"] | {"unit": "furlong"}})


def test_a_person_who_went_home_is_a_gap(bench):
    driver = person(timeout_s=0.02)
    line, _ = bench(driver)
    assert qualities(driver.poll(line)) == [(None, Quality.TIMEOUT)] * 3


def test_lines_typed_ahead_answer_the_next_prompts(bench):
    driver = person(timeout_s=1.0)
    line, peer = bench(driver)
    peer.send(b"1.60 44 232.3\n1.70 51 272.9\n")
    assert [driver.poll(line)[0].value for _ in range(2)] == [1.6, 1.7]


def test_manual_entry_needs_a_keyboard():
    with pytest.raises(ValueError, match="needs a line of kind 'keyboard'"):
        manual.build("person", read_instrument("manual_bench"), place())
