"""The lines, over real bytes: question and answer on a pty and a socket, late replies, noise, and lost ports."""

import contextlib
import os
import pty
import random
import select
import socket
import termios
import threading
import time
import tty

import pytest
import serial

from rig.clock import Clock
from rig.instruments import ascii
from rig.lines import BadReplyError, Line, LostError, NoReplyError, Timing, modbus
from rig.lines import serial as lines_serial
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort
from rig.readings import Quality
from rig.virtual.devices import frames
from tests.instrument_peers import Peer
from tests.modbus_peer import rtu

TIMING = Timing(timeout_s=0.05, slowest_reply_s=0.15, quiet_s=0.005)
REQUEST = 8  # bytes of a read and of a single write
REGISTERS = {0: 111, 10: 222, 20: 333}  # each address has its own value, so that a wrong answer shows


def answer_of(request):
    """What a good slave says to a read of one register."""
    address = int.from_bytes(request[2:4], "big")
    return rtu(bytes([request[0], request[1], 2]) + REGISTERS[address].to_bytes(2, "big"))


@pytest.fixture
def on_line():
    """Opens a line to a slave that replies as told, and closes both."""
    made = []

    def make(reply, timing=TIMING):
        slave = Peer(reply, REQUEST)
        clock = Clock()
        line = Line("bus", SerialPort(slave.path, clock, baud=115200), clock, timing)
        line.open()
        made.append((line, slave))
        return line

    yield make
    for line, slave in made:
        line.close()
        slave.end()


def read(line, address, unit=1):
    return modbus.exchange(line, "rtu", modbus.Request(unit, modbus.READ_HOLDING, address))[0]


def test_a_register_is_read(on_line):
    assert read(on_line(lambda request: [(0.0, answer_of(request))]), 10) == (222,)


def test_a_reply_in_pieces_is_put_together(on_line):
    def reply(request):
        return [(0.004 * i, answer_of(request)[i : i + 1]) for i in range(7)]

    assert read(on_line(reply), 10) == (222,)


def test_silence_is_a_timeout(on_line):
    with pytest.raises(NoReplyError, match=r"bus: nothing within 0\.05 s"):
        read(on_line(lambda request: []), 0)


def test_half_a_reply_is_a_timeout_that_says_what_came(on_line):
    with pytest.raises(NoReplyError, match=r"3 bytes \(01 03 02\)"):
        read(on_line(lambda request: [(0.0, answer_of(request)[:3])]), 0)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda good: good[:-1] + bytes([good[-1] ^ 1]), "wrong CRC"),
        (lambda good: rtu(b"\x02" + good[1:-2]), "unit 2 answers"),
        (lambda good: rtu(bytes([good[0], 4]) + good[2:-2]), "an answer to function 4"),
        (lambda good: rtu(good[:2] + b"\x06" + bytes(6))[:7], "wrong CRC"),
        (lambda good: rtu(good[:2] + b"\x01" + good[3:-2]), "1 bytes of data where 2"),
        (lambda good: rtu(good[:2] + b"\x06" + bytes(6)), "6 bytes of data where 2"),
        (lambda good: bytes(13) + good, "wrong CRC"),
    ],
    ids=["crc", "unit", "function", "longer, cut off", "count", "longer", "much noise before"],
)
def test_what_is_not_the_answer_is_refused(on_line, damage, words):
    line = on_line(lambda request: [(0.0, damage(answer_of(request)))])
    with pytest.raises(BadReplyError, match=words) as refused:
        read(line, 0)
    assert refused.value.quality is Quality.CRC


def test_an_exception_is_told_with_its_meaning(on_line):
    line = on_line(lambda request: [(0.0, rtu(bytes([request[0], request[1] | 0x80, 2])))])
    with pytest.raises(modbus.RefusedError, match=r"exception 2 \(illegal register address\)") as refused:
        read(line, 0)
    assert (refused.value.code, refused.value.quality) == (2, Quality.EXCEPTION)


ABOUT = {
    "zero before": lambda request, good: b"\x00" + good,
    "echo before": lambda request, good: request + good,
    "echo and noise before": lambda request, good: request + b"\xff\x00" + good,
    "zero after": lambda request, good: good + b"\x00",
    "zeros about": lambda request, good: b"\x00" + good + b"\x00\x00",
}


@pytest.mark.parametrize("what", ABOUT)
def test_bytes_about_the_answer_cost_neither_it_nor_a_long_wait(on_line, what):
    timing = Timing(timeout_s=0.4, slowest_reply_s=0.5, quiet_s=0.005)
    line = on_line(lambda request: [(0.0, ABOUT[what](request, answer_of(request)))], timing)
    begin = time.monotonic()
    for _ in range(4):
        assert [read(line, address) for address in (0, 10, 20)] == [(111,), (222,), (333,)]
    assert time.monotonic() - begin < 6 * timing.slowest_reply_s  # of twelve questions


@pytest.mark.parametrize("pause_s", [0.0, 0.02])
@pytest.mark.parametrize("other", [b"\x07\x03\x04\x01\x02\x03\x04", b"\x07\x84\x02", b"\x07\x06\x00\x01\x00\x02"])
def test_a_late_answer_of_another_unit_before_the_right_one_costs_nothing(on_line, other, pause_s):
    timing = Timing(timeout_s=0.4, slowest_reply_s=0.5, quiet_s=0.005)
    line = on_line(lambda request: [(0.0, rtu(other)), (pause_s, answer_of(request))], timing)
    begin = time.monotonic()
    assert [read(line, address) for address in (0, 10, 20)] == [(111,), (222,), (333,)]
    assert time.monotonic() - begin < timing.timeout_s


def test_a_stray_byte_that_comes_late_costs_no_answer(on_line):
    line = on_line(lambda request: [(0.0, answer_of(request)), (0.01, b"\x00")])
    for _ in range(3):
        assert read(line, 10) == (222,)
        time.sleep(0.02)


def test_of_an_exception_after_an_echo_the_meaning_is_told(on_line):
    line = on_line(lambda request: [(0.0, request + rtu(bytes([request[0], request[1] | 0x80, 2])))])
    with pytest.raises(modbus.RefusedError, match="illegal register address"):
        read(line, 0)


@pytest.mark.long
@pytest.mark.slow
def test_noise_about_answers_that_may_be_late_gives_no_wrong_value(on_line):
    """Echoes, stray bytes before and after, late answers and damaged ones, all mixed."""
    draw = random.Random(8)
    timing = Timing(timeout_s=0.01, slowest_reply_s=0.04, quiet_s=0.002)

    def reply(request):
        good = answer_of(request)
        if draw.random() < 0.1:
            good = good[:-3] + bytes([good[-3] ^ 1 << draw.randrange(8)]) + good[-2:]
        before = request * (draw.random() < 0.3) + draw.randbytes(draw.choice([0, 0, 1, 2, 3]))
        late = draw.random() < 0.15
        return [(draw.uniform(0.012, 0.02) if late else 0.0, before + good + draw.randbytes(draw.choice([0, 0, 1])))]

    line = on_line(reply, timing)
    good = 0
    for i in range(600):
        address = (0, 10, 20)[i % 3]
        try:
            values = read(line, address)
        except (NoReplyError, BadReplyError):
            continue
        assert values == (REGISTERS[address],)
        good += 1
    assert good > 250


def test_the_echo_of_the_question_is_not_an_answer(on_line):
    line = on_line(lambda request: [(0.0, b"\x00" + request)])
    for address in REGISTERS:
        with pytest.raises(NoReplyError, match="its own question, as an echo, and no answer"):
            read(line, address)


def write_one(line, habits, address=5, value=7):
    return modbus.exchange(line, "rtu", modbus.Request(1, modbus.WRITE_ONE, address, 1, (value,)), None, habits)[0]


def test_an_echo_is_told_once_with_the_key_that_expects_it(on_line):
    line = on_line(lambda request: [(0.0, request + answer_of(request))])
    assert [read(line, address) for address in REGISTERS] == [(111,), (222,), (333,)]
    (text,) = line.take_remarks()
    assert "write echo = true" in text
    assert read(line, 0) == (111,)
    assert line.take_remarks() == []


ECHO = modbus.Habits(echo=True)


def test_where_an_echo_is_expected_it_is_no_confirmation_of_a_write(on_line):
    """The confirmation is the same bytes as the order, and so as the echo."""
    line = on_line(lambda request: [(0.0, request)])
    with pytest.raises(NoReplyError, match="as an echo, and no answer"):
        write_one(line, ECHO)
    line = on_line(lambda request: [(0.0, b"\x00" + request), (0.01, request)])
    assert write_one(line, ECHO) == ()
    assert line.take_remarks() == []


def test_where_an_echo_was_seen_it_is_no_confirmation_of_a_write_either(on_line):
    line = on_line(lambda request: [(0.0, request + (answer_of(request) if request[1] == 3 else b""))])
    assert read(line, 0) == (111,)
    with pytest.raises(NoReplyError, match="as an echo, and no answer"):
        write_one(line, modbus.STANDARD)


def test_where_an_echo_is_expected_and_none_comes_that_is_told_and_answers_are_read(on_line):
    line = on_line(lambda request: [(0.0, answer_of(request))])
    assert modbus.exchange(line, "rtu", modbus.Request(1, modbus.READ_HOLDING, 10), None, ECHO)[0] == (222,)
    (text,) = line.take_remarks()
    assert "echo = true, and no question comes back" in text


def test_an_answer_that_comes_twice_is_not_taken_for_the_next(on_line):
    line = on_line(lambda request: [(0.0, answer_of(request)), (0.01, answer_of(request))])
    for address in (0, 10, 20, 0, 10, 20):
        assert read(line, address) == (REGISTERS[address],)
        time.sleep(0.03)


def test_after_a_timeout_the_late_reply_is_thrown_away(on_line):
    delays = iter([0.1, 0.0])
    line = on_line(lambda request: [(next(delays), answer_of(request))])
    with pytest.raises(NoReplyError):
        read(line, 0)
    assert read(line, 10) == (222,)
    assert [event.kind for event in line.take_events()] == ["tx", "silence", "rx", "silence", "tx", "rx", "silence"]


def test_a_reply_later_than_the_slowest_is_told_by_the_one_that_follows_it(on_line):
    delays = iter([0.2, 0.07, 0.0])
    timing = Timing(timeout_s=0.1, slowest_reply_s=0.15, quiet_s=0.005)
    line = on_line(lambda request: [(next(delays), answer_of(request))], timing)
    with pytest.raises(NoReplyError):
        read(line, 0)
    with pytest.raises(BadReplyError, match="two answers to one question") as refused:
        read(line, 10)
    assert refused.value.quality is Quality.STALE
    assert read(line, 20) == (333,)


def test_what_follows_a_reply_is_drained_before_the_next_question(on_line):
    line = on_line(lambda request: [(0.0, answer_of(request) * 2)])
    assert [read(line, address) for address in (0, 10, 20)] == [(111,), (222,), (333,)]


def test_a_reply_sooner_than_its_bytes_can_cross_the_wire_is_an_old_one(on_line):
    slow = Timing(timeout_s=0.5, slowest_reply_s=0.5, byte_s=0.02)
    line = on_line(lambda request: [(0.0, answer_of(request))], slow)
    with pytest.raises(BadReplyError, match="an old one") as refused:
        read(line, 0)
    assert refused.value.quality is Quality.STALE


def test_a_babbling_line_is_told(on_line):
    timing = Timing(timeout_s=0.2, slowest_reply_s=0.2)
    line = on_line(lambda request: [(0.0005 * i, bytes(64)) for i in range(100)], timing)
    with pytest.raises(BadReplyError, match="without the end of a reply"):
        line.ask(b"?", lambda buffer: None)


@pytest.mark.long
@pytest.mark.slow
def test_with_one_reply_in_five_late_a_thousand_reads_give_no_wrong_value(on_line):
    draw = random.Random(7)
    timing = Timing(timeout_s=0.01, slowest_reply_s=0.04, quiet_s=0.002)

    def reply(request):
        return [(draw.uniform(0.012, 0.02) if draw.random() < 0.2 else 0.0, answer_of(request))]

    line = on_line(reply, timing)
    good = late = 0
    for i in range(1000):
        address = (0, 10, 20)[i % 3]
        try:
            values = read(line, address)
        except NoReplyError:
            late += 1
            continue
        except BadReplyError as error:
            assert error.quality is Quality.STALE
            continue
        assert values == (REGISTERS[address],)
        good += 1
    assert late > 150  # the fault was really there
    assert good > 500


def test_a_port_that_is_not_there_is_told_with_what_to_do():
    line = Line("bus", SerialPort("/dev/ttyUSB_none", Clock()), Clock())
    with pytest.raises(LostError, match="no such port; is the cable plugged in"):
        line.open()
    assert [event.kind for event in line.take_events()] == ["lost"]


def test_a_port_that_another_program_has_open_is_told(on_line):
    line = on_line(lambda request: [])
    with pytest.raises(LostError, match="another program has it open"):
        SerialPort(line.port.path, Clock()).open()


def test_an_unplugged_port_is_told():
    slave = Peer(lambda request: [])
    clock = Clock()
    line = Line("bus", SerialPort(slave.path, clock), clock, TIMING)
    line.open()
    slave.end()
    with pytest.raises(LostError):
        for _ in range(3):
            line.ask(b"?", lambda buffer: None)
    line.close()


def test_bytes_waiting_from_before_the_opening_do_not_count(on_line):
    line = on_line(lambda request: [(0.0, answer_of(request)), (0.02, b"late")])
    assert read(line, 0) == (111,)
    time.sleep(0.05)
    line.open()
    assert read(line, 10) == (222,)


def tcp_reply(request, registers, transaction=None):
    body = bytes([request[6], 3, 2 * len(registers)]) + b"".join(value.to_bytes(2, "big") for value in registers)
    return (transaction or request[:2]) + b"\0\0" + len(body).to_bytes(2, "big") + body


@pytest.fixture
def on_socket():
    """Opens a line to a TCP peer that answers each request with what `reply` gives; None closes the connection."""
    ended = []

    def make(reply):
        server = socket.create_server(("127.0.0.1", 0))

        def serve():
            connection, _ = server.accept()
            with connection:
                while request := connection.recv(256):
                    answer = reply(request)
                    if answer is None:
                        return
                    connection.sendall(answer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        clock = Clock()
        line = Line("net", TcpPort(*server.getsockname(), clock), clock, TIMING)
        line.open()
        ended.append((line, server))
        return line

    yield make
    for line, server in ended:
        line.close()
        server.close()


def test_registers_are_read_over_tcp(on_socket):
    line = on_socket(lambda request: tcp_reply(request, [7, 8]))
    assert modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0, 2))[0] == (7, 8)


def test_the_answer_to_another_question_is_stale_over_tcp(on_socket):
    line = on_socket(lambda request: tcp_reply(request, [7], b"\x0f\xff"))
    with pytest.raises(BadReplyError, match="the answer to question 4095, not to 1") as refused:
        modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0))
    assert refused.value.quality is Quality.STALE


def other_number(how):
    """Transaction numbers of devices that do not repeat them."""
    return {
        "zero": lambda number: b"\0\0",
        "swapped": lambda number: number[::-1],
        "next": lambda number: (int.from_bytes(number, "big") + 1).to_bytes(2, "big"),
        "last": lambda number: (int.from_bytes(number, "big") - 1).to_bytes(2, "big"),
    }[how]


ANY = modbus.Habits(any_number=True)


@pytest.mark.parametrize("how", ["zero", "swapped", "next", "last"])
def test_other_transaction_numbers_are_an_error_that_names_the_key_and_with_it_answers(on_socket, how):
    line = on_socket(lambda request: tcp_reply(request, [7], other_number(how)(request[:2])))
    request = modbus.Request(1, modbus.READ_HOLDING, 0)
    with pytest.raises(BadReplyError, match='write transaction_numbers = "any" at this line'):
        modbus.exchange(line, "tcp", request)
    assert [modbus.exchange(line, "tcp", request, None, ANY)[0] for _ in range(3)] == [(7,)] * 3


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda good: good[:6] + b"\x02" + good[7:], "unit 2 answers"),
        (lambda good: good[:7] + b"\x04" + good[8:], "an answer to function 4"),
        (lambda good: good[:5] + b"\x07" + good[6:8] + b"\x04" + good[9:] + b"\0\0", "4 bytes of data where 2"),
    ],
)
def test_with_any_number_an_answer_still_has_the_unit_function_and_length_of_the_question(spoil, words):
    with Gateway(lambda request: [(0.0, spoil(tcp_reply(request, [7], b"\0\0")))]) as gateway:
        line = gateway.line(TIMING)
        with pytest.raises(BadReplyError, match=words):
            modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0), None, ANY)


class Gateway(threading.Thread):
    """A device on TCP whose `reply(request)` gives (delay, bytes) pairs; each goes to the connection of its question,
    or to the newest one.
    """

    def __init__(self, reply, to_newest=False):
        super().__init__(daemon=True)
        self.server = socket.create_server(("127.0.0.1", 0))
        self.reply, self.to_newest, self.lines = reply, to_newest, []
        self.ended = threading.Event()
        self.connections = 0

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        for line in self.lines:
            line.close()
        self.ended.set()
        self.join()
        self.server.close()

    def line(self, timing):
        clock = Clock()
        line = Line("net", TcpPort(*self.server.getsockname(), clock), clock, timing)
        line.open()
        self.lines.append(line)
        return line

    def run(self):
        connections, pending = [], []
        while not self.ended.is_set():
            now = time.monotonic()
            for item in [item for item in pending if item[0] <= now]:
                pending.remove(item)
                with contextlib.suppress(OSError):
                    (connections[-1] if self.to_newest else item[1]).sendall(item[2])
            for ready in select.select([self.server, *connections], [], [], 0.001)[0]:
                if ready is self.server:
                    connections.append(self.server.accept()[0])
                    self.connections += 1
                    continue
                with contextlib.suppress(OSError):
                    if request := ready.recv(256):
                        pending += [(time.monotonic() + delay, ready, data) for delay, data in self.reply(request)]
                        continue
                ready.close()
                connections.remove(ready)
        for connection in connections:
            connection.close()


def late_answers(count, latest_s, to_newest, seed=5):
    """Reads over a line that takes any number, 35 % of the answers late: how many were good, how many failed."""
    draw = random.Random(seed)
    timing = Timing(timeout_s=0.02, slowest_reply_s=0.05, quiet_s=0.002)

    def reply(request):
        answer = tcp_reply(request, [REGISTERS[int.from_bytes(request[8:10], "big")]], b"\0\0")
        return [(draw.uniform(0.022, latest_s) if draw.random() < 0.35 else 0.0, answer)]

    good = failed = 0
    with Gateway(reply, to_newest) as gateway:
        line = gateway.line(timing)
        for i in range(count):
            address = (0, 10, 20)[i % 3]
            try:
                values = modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, address), None, ANY)[0]
            except (NoReplyError, BadReplyError):
                failed += 1
                continue
            assert values == (REGISTERS[address],), f"question {i}"
            good += 1
    return good, failed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("latest_s", "to_newest"),
    [(0.2, False), (0.045, True)],
    ids=["much later than the slowest", "a gateway that answers on another connection"],
)
def test_with_any_number_and_a_third_of_the_answers_late_no_value_is_another_s(latest_s, to_newest):
    good, failed = late_answers(60, latest_s, to_newest)
    assert good > 5
    assert failed > 5


def test_a_late_answer_before_the_right_one_costs_nothing_over_tcp(on_socket):
    def reply(request):
        before = int.from_bytes(request[:2], "big") - 1
        late = tcp_reply(before.to_bytes(2, "big") + request[2:6] + b"\x07" + request[7:], [7])
        return late + tcp_reply(request, [8])

    line = on_socket(reply)
    begin = time.monotonic()
    for _ in range(3):
        assert modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0))[0] == (8,)
    assert time.monotonic() - begin < line.timing.slowest_reply_s


def test_a_reply_of_another_length_is_refused_over_tcp(on_socket):
    line = on_socket(lambda request: tcp_reply(request, [7]))
    with pytest.raises(BadReplyError, match="2 bytes of data where 6"):
        modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0, 3))


@pytest.mark.parametrize("registers", [[7], [0, 0], [256, 8192, 1], [7, 8, 9], [0] * 20, list(range(60))])
def test_an_rtu_frame_where_modbus_tcp_was_expected_is_told_with_the_key_to_set(on_socket, registers):
    """A converter that hands on a serial bus as it is."""

    def rtu(request):
        body = bytes([1, 3, 2 * len(registers)]) + b"".join(value.to_bytes(2, "big") for value in registers)
        return frames.rtu(1, body[1:])

    line = on_socket(rtu)
    with pytest.raises(BadReplyError, match='an RTU frame where Modbus TCP was expected: write framing = "rtu"'):
        modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0, len(registers)))


class OnceEach(threading.Thread):
    """A device that closes the connection after each answer, and after `most` answers takes no more questions."""

    def __init__(self, most):
        super().__init__(daemon=True)
        self.server, self.most, self.answers = socket.create_server(("127.0.0.1", 0)), most, 0
        self.start()

    def run(self):
        with self.server:
            while True:
                connection, _ = self.server.accept()
                with connection:
                    request = connection.recv(256)
                    if not request or self.answers == self.most:
                        return
                    self.answers += 1
                    connection.sendall(tcp_reply(request, [self.answers]))


def test_a_device_that_closes_after_each_answer_is_connected_to_again():
    device, clock = OnceEach(20), Clock()
    line = Line("net", TcpPort(*device.server.getsockname(), clock), clock, TIMING)
    line.open()
    request = modbus.Request(1, modbus.READ_HOLDING, 0)
    assert [modbus.exchange(line, "tcp", request)[0] for _ in range(20)] == [(n,) for n in range(1, 21)]
    with pytest.raises(LostError, match=r"closed the connection|connection broke"):
        modbus.exchange(line, "tcp", request)
    line.close()


def test_a_device_that_closes_after_many_answers_is_lost(on_socket):
    answers = iter([b"a", b"b", b"c"])
    line = on_socket(lambda request: tcp_reply(request, [1]) if next(answers, None) else None)
    for _ in range(3):
        modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0))
    with pytest.raises(LostError):
        modbus.exchange(line, "tcp", modbus.Request(1, modbus.READ_HOLDING, 0))


def test_a_connection_that_the_device_closes_is_lost(on_socket):
    line = on_socket(lambda request: None)
    with pytest.raises(LostError, match=r"closed the connection without an answer: .*another program"):
        line.ask(b"?", lambda buffer: None)


class MuteAfter(threading.Thread):
    """A gateway that answers `most` questions on its first connection, then hears no more of it, and all on others."""

    def __init__(self, most):
        super().__init__(daemon=True)
        self.server, self.most, self.kept = socket.create_server(("127.0.0.1", 0)), most, []
        self.start()

    def run(self):
        with self.server:
            while True:
                connection, _ = self.server.accept()
                self.kept.append(connection)
                count = self.most if len(self.kept) == 1 else 1000
                while count and (request := connection.recv(256)):
                    count -= 1
                    connection.sendall(tcp_reply(request, [len(self.kept)]))


def test_a_connection_over_which_nothing_comes_any_more_is_made_anew():
    device, clock = MuteAfter(2), Clock()
    line = Line("net", TcpPort(*device.server.getsockname(), clock), clock, TIMING)
    line.open()
    request, read = modbus.Request(1, modbus.READ_HOLDING, 0), []
    for _ in range(8):
        try:
            read += modbus.exchange(line, "tcp", request)[0]
        except NoReplyError:
            read.append(None)
    assert read == [1, 1, None, None, None, 2, 2, 2]
    line.close()


def test_a_refused_connection_is_told():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
    with pytest.raises(LostError, match="does not take a connection"):
        Line("net", TcpPort(*address, Clock()), Clock()).open()


def test_writes_are_confirmed_or_refused(on_line):
    def reply(request):
        return [(0.0, rtu(request[:6]) if request[1] == 16 else rtu(request[:4] + b"\x00\x01"))]

    line = on_line(reply)
    many = modbus.Request(1, modbus.WRITE_MANY, 1009, 2, (0x40C0, 0))
    assert modbus.exchange(line, "rtu", many)[0] == ()
    with pytest.raises(BadReplyError, match="confirms another write"):
        modbus.exchange(line, "rtu", modbus.Request(1, modbus.WRITE_ONE, 5, 1, (7,)))


def test_a_terminal_that_fails_while_it_is_opened_is_lost(on_line, monkeypatch):
    """pyserial lets the error of termios through, which is none of the system's."""

    def gone(*arguments, **options):
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(serial, "Serial", gone)
    with pytest.raises(LostError, match=r"cannot be opened: .*Input/output error"):
        SerialPort("/dev/ttyUSB0", Clock()).open()


def test_a_name_that_no_host_can_have_is_told():
    with pytest.raises(LostError, match=r"a\.\.b:502 does not take a connection"):
        TcpPort("a..b", 502, Clock()).open()


def test_a_device_that_takes_nothing_is_lost(monkeypatch):
    monkeypatch.setattr(lines_serial, "WRITE_S", 0.2)
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = SerialPort(os.ttyname(slave), Clock())
    try:
        port.open()
        with pytest.raises(LostError, match="writing failed"):
            port.write(bytes(1_000_000))
    finally:
        port.close()
        os.close(master)
        os.close(slave)


SLOW_WIRE = Timing(timeout_s=20.0, slowest_reply_s=20.0, quiet_s=0.005, byte_s=0.1)  # as slow as a busy machine


@pytest.mark.slow
def test_a_copy_of_an_answer_that_comes_while_the_next_question_goes_out_is_thrown_away(on_line):
    said = []

    def reply(request):
        said.append(answer_of(request))
        return [*((0.0, old) for old in said[-2:-1]), (1.6, said[-1])]

    line = on_line(reply, SLOW_WIRE)
    assert [read(line, address) for address in (0, 10)] == [(111,), (222,)]
    assert len(said) == 2  # no question was asked again


@pytest.mark.slow
def test_an_answer_that_begins_before_the_question_is_out_is_thrown_away_however_late_it_ends(on_line):
    old, new = (rtu(bytes([1, 3, 20]) + bytes(range(first, first + 20))) for first in (0, 100))
    line = on_line(lambda request: [(0.0, old[:10]), (3.0, old[10:]), (3.3, new)], SLOW_WIRE)
    values, reply = modbus.exchange(line, "rtu", modbus.Request(1, modbus.READ_HOLDING, 0, 10))
    assert values[0] == 100 << 8 | 101
    assert reply.data == new


@pytest.mark.slow
def test_a_text_s_copy_that_follows_its_answer_is_drained_before_the_next_question(on_line):
    said = []

    def reply(request):
        said.append(b"%d\r" % len(said))
        return [(1.6, said[-1]), (1.7, said[-1])]

    line = on_line(reply, SLOW_WIRE)
    ends = ascii.ends_with(b"\r", 20)
    assert [ascii.ask_text(line, b"@D3\r....", ends, SLOW_WIRE, False).data for _ in range(2)] == [b"0\r", b"1\r"]
