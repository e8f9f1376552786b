"""What a port is: bytes out, bytes in, each with its time. A serial port, a socket, a terminal or a log played back."""

from __future__ import annotations

from typing import Protocol

from rig.readings import Quality


class LineError(Exception):
    """A question got no usable answer. The text says what was expected and what came."""

    quality = Quality.TIMEOUT


class NoReplyError(LineError):
    """Nothing, or not enough, came before the time was up."""


class BadReplyError(LineError):
    """Bytes came, but not an answer to the question."""

    def __init__(self, text: str, quality: Quality = Quality.CRC) -> None:
        super().__init__(text)
        self.quality = quality


class LostError(LineError):
    """The port itself failed: unplugged, refused, or taken by another program. The text says what to do."""


class Port(Protocol):
    """A way for bytes. Times are the bench's clock [ns]; every method raises `LostError` when the port fails."""

    def open(self) -> None:
        """Open, or open again; nothing received before counts."""

    def close(self) -> None:
        """Close; harmless when closed."""

    def write(self, data: bytes) -> int:
        """Send all bytes, and return the time at which sending began [ns]."""

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """Wait for bytes and return what is there, with the time; no bytes when none came in time.

        `until_ns`: when to give up [ns]; what has arrived already is returned even when that is past.
        """
