"""Bytes of a device that sends unasked, cut into frames: what is half there waits, what is no frame is dropped."""

from __future__ import annotations

from collections.abc import Callable

from rig.lines import BadReplyError, Line, NoReplyError
from rig.lines.line import MOST_REPLY_BYTES
from rig.readings import NS

# Takes a buffer, and returns the whole frames in it, oldest first, with the bytes that may still become one.
Cut = Callable[[bytes], tuple[list[bytes], bytes]]


class Stream:
    """What has come on a line and was not used yet."""

    def __init__(self, cut: Cut) -> None:
        self._cut = cut
        self._rest = b""

    def forget(self) -> None:
        """Drop what is half there."""
        self._rest = b""

    def frames(self, line: Line, wait_s: float) -> tuple[int, list[bytes]]:
        """Wait for at least one whole frame.

        Returns `time_ns`: when the last bytes came [ns]; `frames`: oldest first. Raises NoReplyError when the device
        was silent; BadReplyError when bytes came, but no frame.
        """
        came = 0
        give_up_ns = None
        while True:
            time_ns, data = line.listen(wait_s)
            give_up_ns = time_ns + int(wait_s * NS) if give_up_ns is None else give_up_ns
            if not data:
                if came:
                    raise BadReplyError(f"line {line.name}: {came} bytes came, and no whole frame among them")
                raise NoReplyError(f"line {line.name}: the device has sent nothing for {wait_s:g} s")
            came += len(data)
            frames, self._rest = self._cut(self._rest + data)
            self._rest = self._rest[-MOST_REPLY_BYTES:]
            if frames:
                return time_ns, frames
            if time_ns > give_up_ns:
                raise BadReplyError(f"line {line.name}: {came} bytes in {wait_s:g} s, and no whole frame among them")


def cut_lines(terminator: bytes, most_bytes: int) -> Cut:
    """What cuts text into lines; longer ones than a reply can be are dropped. It has the form that `Stream` takes."""

    def cut(buffer: bytes) -> tuple[list[bytes], bytes]:
        *lines, rest = buffer.split(terminator)
        return [line for line in lines if 0 < len(line) <= most_bytes], rest

    return cut
