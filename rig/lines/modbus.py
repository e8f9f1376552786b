"""Modbus over a line, RTU or TCP, through pymodbus: the only module that knows it.

pymodbus makes the frames and reads them. Whether a frame answers the question is checked here: unit, function code,
byte count and, over TCP, the transaction number; pymodbus takes an answer of another function or length for good.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from rig.lines.line import ECHOES, MOST_STRAY, Complete, Line, Reply, Timing
from rig.lines.port import BadReplyError, NoReplyError
from rig.readings import Quality

READ_COILS, READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE_MANY = 1, 3, 4, 6, 16
READS, WRITES = (READ_COILS, 2, READ_HOLDING, READ_INPUT), (5, WRITE_ONE, 15, WRITE_MANY)
EXCEPTION_BIT = 0x80
MOST_REGISTERS = 125
MBAP_BYTES, MOST_TCP_BYTES = 7, 260  # transaction, protocol, length, unit; and of a whole frame
EXCEPTIONS = {
    1: "illegal function",
    2: "illegal register address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledge, still working",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not respond",
}
GATEWAY = (10, 11)
BUSY_CODES = (5, 6, *GATEWAY)
_RTU = FramerRTU(DecodePDU(False))
_TCP = FramerSocket(DecodePDU(False))


@dataclass(frozen=True, slots=True)
class Habits:
    """How a line departs from the standard.

    `echo`: each question comes back before its answer. `any_number`: over TCP, answers do not repeat the question's
    number; one that comes late is then told from another by a new connection alone.
    """

    echo: bool = False
    any_number: bool = False


STANDARD = Habits()
NO_ECHO = "the bench file says echo = true, and no question comes back: take the key out, or set-points go unconfirmed"


class RefusedError(BadReplyError):
    """The device answered with a Modbus exception."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text, Quality.EXCEPTION)
        self.code = code

    @property
    def is_busy(self) -> bool:
        """Whether it may do later what was asked, as a device that starts: it is no other model."""
        return self.code in BUSY_CODES

    @property
    def while_busy(self) -> str:
        """What to do about a device that stays busy."""
        if self.code in GATEWAY:
            return "the gateway answers, the device behind it does not: see its power, its cable and its unit_id"
        return "wait until it has started, or see what keeps it busy; try again"


@dataclass(frozen=True, slots=True)
class Request:
    """A question."""

    unit: int
    function: int
    address: int
    count: int = 1
    values: tuple[int, ...] = ()


def encode(request: Request, framing: str, transaction: int) -> bytes:
    """The bytes of a question, a whole frame."""
    pdu: ModbusPDU
    if request.function == READ_COILS:
        pdu = ReadCoilsRequest(address=request.address, count=request.count, dev_id=request.unit)
    elif request.function == READ_HOLDING:
        pdu = ReadHoldingRegistersRequest(address=request.address, count=request.count, dev_id=request.unit)
    elif request.function == READ_INPUT:
        pdu = ReadInputRegistersRequest(address=request.address, count=request.count, dev_id=request.unit)
    elif request.function == WRITE_ONE:
        pdu = WriteSingleRegisterRequest(address=request.address, registers=list(request.values), dev_id=request.unit)
    else:
        pdu = WriteMultipleRegistersRequest(
            address=request.address, registers=list(request.values), dev_id=request.unit
        )
    pdu.transaction_id = transaction
    return (_RTU if framing == "rtu" else _TCP).buildFrame(pdu)


def length_of(request: Request, framing: str, echo: bool = False, transaction: int | None = None) -> Complete:
    """What tells where the answer to a question ends.

    `echo`: whether the question comes back first, so that what reads like it is no answer yet.
    `transaction`: of Modbus TCP, the question's number: whole answers to others are passed over; any number when None.
    It takes the bytes so far and gives how many of them end with the frame, or None while more are needed.
    """
    if framing == "tcp":

        def tcp_length(buffer: bytes) -> int | None:
            late = _after_late(buffer, transaction)
            try:
                length = _tcp_length(buffer[late:])
                return None if length is None else late + length
            except BadReplyError:
                if _answer_in(request, buffer):
                    return len(buffer)
                raise

        return tcp_length

    def rtu_length(buffer: bytes) -> int | None:
        """Up to the end of the answer, or of a whole frame of this unit that is none."""
        found = _answer_in(request, buffer, echo)
        if found is not None:
            return found[1]
        begin = _after_others(request, buffer)
        whole = _whole_bytes(request, buffer[begin:])
        is_question = whole is not None and buffer[begin : begin + whole] == _rtu_question(request)[:whole]
        is_ours = whole is not None and buffer[begin] == request.unit
        return begin + whole if whole is not None and is_ours and not is_question else None

    return rtu_length


@functools.lru_cache(maxsize=256)
def _rtu_question(request: Request) -> bytes:
    return encode(request, "rtu", 0)


def _after_echo(request: Request, buffer: bytes) -> int:
    """Where the question's echo ends, before which a stray byte or two may stand; 0 where there is none."""
    question = _rtu_question(request)
    begin = buffer.find(question, 0, len(question) + MOST_STRAY)
    return 0 if begin < 0 else begin + len(question)


def _good_bytes(request: Request, frame: bytes) -> int | None:
    """Bytes of an RTU answer: an exception has five, a good one what the question asks for; None where too few came."""
    if len(frame) < 2:
        return None
    if frame[1] & EXCEPTION_BIT:
        return 5
    if request.function == READ_COILS:
        return 5 + (request.count + 7) // 8
    return 5 + (2 * request.count if request.function in (READ_HOLDING, READ_INPUT) else 3)


def _own_bytes(frame: bytes) -> int | None:
    """Bytes of an RTU answer by its own account; None where too few came, or its function is not known."""
    if len(frame) < 3:
        return None
    if frame[1] & EXCEPTION_BIT:
        return 5
    return 5 + frame[2] if frame[1] in READS else 8 if frame[1] in WRITES else None


def _whole_bytes(request: Request, buffer: bytes) -> int | None:
    """Bytes of the whole frame at the start, as many as the question asks for or more; None where there is none.

    Of another unit's it is as many as it says.
    """
    good, own = _good_bytes(request, buffer), _own_bytes(buffer)
    is_other = own is not None and (buffer[0] != request.unit or own > (good or 0))
    for length in (good, own if is_other else None):
        if length is not None and len(buffer) >= length and _is_whole(buffer[:length]):
            return length
    return None


def _after_others(request: Request, buffer: bytes) -> int:
    """Where whole answers of other units end, such as a gateway sends late; 0 where there are none."""
    begin = 0
    while (length := _own_bytes(buffer[begin:])) is not None and buffer[begin] != request.unit:
        if len(buffer) < begin + length or not _is_whole(buffer[begin : begin + length]):
            break
        begin += length
    return begin


def _is_whole(frame: bytes) -> bool:
    return bool(_RTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big")))


def _answer_in(request: Request, buffer: bytes, echo: bool = False) -> tuple[int, int] | None:
    """Where an RTU answer begins and ends. Before it may stand the question's echo, answers of other units, and a stray
    byte or two.

    An answer has the question's unit and function, its number of bytes, and a CRC that is right. To the order to write
    one register it is the question itself: where an echo comes, it is the second.
    """
    after = _after_echo(request, buffer)
    if echo and not after and request.function == WRITE_ONE:
        return None
    first = after if echo or request.function != WRITE_ONE else 0
    first += _after_others(request, buffer[first:])
    for begin in range(first, min(first + MOST_STRAY, max(len(buffer) - 4, 0)) + 1):
        frame = buffer[begin:]
        length = _good_bytes(request, frame)
        if length is None or len(frame) < length or frame[0] != request.unit:
            continue
        function, data = frame[1], length - 5
        refused = function == request.function | EXCEPTION_BIT
        is_read = request.function in READS
        if (refused or (function == request.function and (not is_read or frame[2] == data))) and _is_whole(
            frame[:length]
        ):
            return begin, begin + length
    return None


def _spoiled(request: Request, framing: str) -> Complete:
    """What tells how long a damaged answer is, or one of the other framing, once no more bytes come."""
    if framing == "tcp":
        return lambda buffer: len(buffer) if _answer_in(request, buffer) else _first_tcp(buffer)

    def length(buffer: bytes) -> int | None:
        after = _after_echo(request, buffer)
        whole = _whole_bytes(request, buffer[after:]) or _good_bytes(request, buffer[after:])
        return after + whole if whole is not None and len(buffer) >= after + whole else None

    return length


def decode(request: Request, framing: str, transaction: int | None, frame: bytes) -> tuple[int, ...]:
    """The registers, or coils, of an answer.

    `transaction`: the question's number, over TCP; any number will do when None.
    Returns registers (0-65535) or coils (0 or 1) [-]; empty for an answer to a write. Raises BadReplyError when the
    frame is damaged, or answers another question; RefusedError when the device answered with an exception.
    """
    asked = f"unit {request.unit}, function {request.function}, register {request.address}"
    if framing == "rtu":
        unit, body = frame[0], frame[1:-2]
        if not _RTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big")):
            raise BadReplyError(f"{asked}: wrong CRC in {frame[:16].hex(' ')}")
    else:
        if _is_no_tcp(frame) and _answer_in(request, frame):
            raise BadReplyError(
                f'{asked}: an RTU frame where Modbus TCP was expected: write framing = "rtu" at this line in the bench '
                "file, as for a serial bus behind a converter"
            )
        if frame[2:4] != b"\0\0":
            raise BadReplyError(f"{asked}: not Modbus TCP: {frame[:16].hex(' ')}")
        answered = int.from_bytes(frame[:2], "big")
        if transaction is not None and answered != transaction:
            raise BadReplyError(
                f"{asked}: the answer to question {answered}, not to {transaction}: a late one; if all are like it, "
                'write transaction_numbers = "any" at this line in the bench file',
                Quality.STALE,
            )
        unit, body = frame[6], frame[MBAP_BYTES:]
    if unit != request.unit:
        raise BadReplyError(f"{asked}: unit {unit} answers")
    if body[0] == request.function | EXCEPTION_BIT and len(body) == 2:
        code = body[1]
        raise RefusedError(f"{asked}: exception {code} ({EXCEPTIONS.get(code, 'not in the standard')})", code)
    if body[0] != request.function:
        raise BadReplyError(f"{asked}: an answer to function {body[0]}")
    if request.function in (WRITE_ONE, WRITE_MANY):
        return _check_written(request, body, asked)
    expected = (request.count + 7) // 8 if request.function == READ_COILS else 2 * request.count
    if body[1] != expected or len(body) != expected + 2:
        raise BadReplyError(f"{asked}: {body[1]} bytes of data where {expected} were asked for")
    if request.function == READ_COILS:
        return tuple(body[2 + i // 8] >> (i % 8) & 1 for i in range(request.count))
    return tuple(int.from_bytes(body[i : i + 2], "big") for i in range(2, expected + 2, 2))


def exchange(
    line: Line, framing: str, request: Request, timing: Timing | None = None, habits: Habits = STANDARD
) -> tuple[tuple[int, ...], Reply]:
    """Ask once, and return the registers with the times. There is no retry here: that is the driver's to decide.

    `timing`: the device's own; the line's when left out.
    Returns `registers`: of `decode` [-]; `reply`: bytes and times. Raises LineError when there was no answer, a damaged
    one, another question's, or an exception.
    """
    line.transactions += 1
    transaction = line.transactions & 0xFFFF
    is_rtu, any_number = framing == "rtu", habits.any_number and framing == "tcp"
    question = _rtu_question(request) if is_rtu else encode(request, framing, transaction)
    line.look((timing or line.timing).byte_s if line.copies else 0.0)
    try:
        number = None if is_rtu or any_number else transaction
        complete = length_of(request, framing, habits.echo or line.echoes, number)
        reply = line.ask(question, complete, timing, _spoiled(request, framing))
        late = _after_late(reply.data, number)
        begin = _answer_begins(line, request, reply.data, habits.echo) if is_rtu else late % len(reply.data)
        return decode(request, framing, number, reply.data[begin:]), reply
    except RefusedError:
        raise
    except (NoReplyError, BadReplyError) as error:
        if isinstance(error, BadReplyError):
            line.drop()  # what is damaged may have a tail
        if any_number:
            line.renew()  # an answer that comes late has nowhere to go
        raise


def _answer_begins(line: Line, request: Request, buffer: bytes, echo: bool) -> int:
    """Where an RTU answer begins, or what came in its place; that there is an echo, or none, is told once."""
    after = _after_echo(request, buffer)
    found = _answer_in(request, buffer, echo or line.echoes)
    if found and request.function != WRITE_ONE:
        line.echoes = after > 0
        if echo != line.echoes:
            line.remark(NO_ECHO if echo else ECHOES)
    return found[0] if found else after


def registers_of(values: Sequence[int]) -> bytes:
    """Registers as the bytes they came in."""
    return b"".join(value.to_bytes(2, "big") for value in values)


def _check_written(request: Request, body: bytes, asked: str) -> tuple[int, ...]:
    """The answer to a write repeats address and count, or address and value."""
    second = request.values[0] if request.function == WRITE_ONE else len(request.values)
    if body[1:] != request.address.to_bytes(2, "big") + second.to_bytes(2, "big"):
        raise BadReplyError(f"{asked}: the answer confirms another write: {body[1:].hex(' ')}")
    return ()


def _is_no_tcp(frame: bytes) -> bool:
    return frame[2:4] != b"\0\0" or 6 + int.from_bytes(frame[4:6], "big") != len(frame)


def _first_tcp(buffer: bytes) -> int | None:
    """Where the whole Modbus TCP frame at the start ends; None where none stands there."""
    if len(buffer) < MBAP_BYTES + 2 or buffer[2:4] != b"\0\0":
        return None
    length = 6 + int.from_bytes(buffer[4:6], "big")
    return length if MBAP_BYTES + 2 <= length <= min(len(buffer), MOST_TCP_BYTES) else None


def _after_late(buffer: bytes, transaction: int | None) -> int:
    """Where whole answers to other questions end, over Modbus TCP; 0 where any number will do."""
    begin = 0
    while transaction is not None and (length := _first_tcp(buffer[begin:])) is not None:
        if int.from_bytes(buffer[begin : begin + 2], "big") == transaction:
            break
        begin += length
    return begin


def _tcp_length(buffer: bytes) -> int | None:
    if len(buffer) < MBAP_BYTES + 1:
        return None
    length = 6 + int.from_bytes(buffer[4:6], "big")
    if not MBAP_BYTES + 2 <= length <= MOST_TCP_BYTES:
        raise BadReplyError(f"not a Modbus TCP frame: {buffer[:16].hex(' ')}")
    return length if len(buffer) >= length else None
