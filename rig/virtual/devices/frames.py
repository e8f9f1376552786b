"""Modbus frames as the standard writes them, made by hand: a mistake shared with the rig's own reader would hide."""

from __future__ import annotations

READ_COILS, READ_INPUTS, READ_HOLDING, READ_INPUT_REGISTERS, WRITE_ONE, WRITE_MANY = 1, 2, 3, 4, 6, 16
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
MOST_REQUEST = 260
HEADER = 7  # of a TCP frame: transaction, protocol, length, unit


def crc(data: bytes) -> bytes:
    """Checksum of an RTU frame, low byte first: polynomial 0xA001, started with 0xFFFF."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ 0xA001 if register & 1 else register >> 1
    return bytes([register & 0xFF, register >> 8])


def rtu(unit: int, body: bytes) -> bytes:
    """An RTU frame."""
    frame = bytes([unit]) + body
    return frame + crc(frame)


def tcp(transaction: bytes, unit: int, body: bytes) -> bytes:
    """A TCP frame."""
    return transaction + b"\0\0" + (len(body) + 1).to_bytes(2, "big") + bytes([unit]) + body


def rtu_request_length(buffer: bytes) -> int | None:
    """How long the request is that a buffer starts with; None while that is not known, 0 when it is none."""
    if len(buffer) < 2:
        return None
    if buffer[1] == WRITE_MANY:
        return None if len(buffer) < 7 else 9 + buffer[6]
    return 8 if 1 <= buffer[1] <= 8 else 0


def tcp_request_length(buffer: bytes) -> int | None:
    """The same for a TCP frame."""
    if len(buffer) < HEADER:
        return None
    length = 6 + int.from_bytes(buffer[4:6], "big")
    return length if buffer[2:4] == b"\0\0" and HEADER + 1 < length <= MOST_REQUEST else 0
