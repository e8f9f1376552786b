"""Question and answer over a port: who waits how long, what is thrown away, and what is written down.

A late answer is the trap of every polled instrument: Modbus RTU frames do not say which question they answer, so a
reply that comes after its timeout is taken for the answer to the next question, and is a good value of the wrong
register. Here a question is asked only into silence: after every timeout and every damaged reply the line waits until
the slowest reply could have come and the line is quiet, and throws away what came. A reply that begins before the
question is out, or is complete before its bytes could have crossed the wire, is an old one or a second copy: it is
thrown away, and the line goes on waiting. And the first answer after a timeout is only
believed when no second one follows: a reply that was even later than the slowest is followed by the real one. Two
replies in a row that are later than a line was told to expect can still deceive it; so every device is read as one
block, in which an old reply is old and never another quantity.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rig.clock import Clock
from rig.lines.port import BadReplyError, LostError, NoReplyError, Port
from rig.readings import NS, Event, Quality

# A virtual bench that runs faster than real time still shares a machine with everything else: no wait is shorter.
LEAST_REAL_WAIT_S = 0.5
MOST_REPLY_BYTES = 4096  # more than any reply of a device known here; a babbling line is cut off there
ECHOES = (
    "each question comes back before its answer, as from an RS-485 adapter that hears itself: write echo = true at "
    "this line in the bench file, so that no echo is taken for the answer to a set-point"
)
SOONEST = 0.85  # of the time that bytes take on the wire: crystals differ, and a device may send one stop bit less
MOST_STRAY = 4  # bytes before an answer, as adapters make them, beside the question's echo
SILENT_BYTES = 3.5  # between an answer and the next question, as Modbus RTU has it
TOO_SOON = (
    "sooner than its bytes can cross the wire: an old one. If all are like it, as of a USB device, whose baud rate "
    "means nothing, write paced = false at this line in the bench file"
)
MOST_DRAIN_S = 2.0  # a line that never falls silent is a stream or a fault


@dataclass(frozen=True, slots=True)
class Timing:
    """The times of a line or of one device on it.

    `timeout_s`: how long an answer may take before the question counts as failed [s].
    `slowest_reply_s`: how long after a question an answer may still come [s]; at least the timeout. Nothing is asked
        before.
    `quiet_s`: silence that ends a drain [s].
    `byte_s`: time of one byte on the wire [s]; 0 where that says nothing (USB, TCP).
    """

    timeout_s: float = 0.3
    slowest_reply_s: float = 1.0
    quiet_s: float = 0.02
    byte_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Reply:
    """A whole answer and its times on the bench's clock [ns]."""

    data: bytes
    request_ns: int
    reply_ns: int


# How many bytes at the start of a buffer end with a whole frame; None while more are needed. Raises BadReplyError when
# the buffer cannot become one.
Complete = Callable[[bytes], int | None]


def _is_old(request: bytes, answer: bytes, early: int, after_ns: int, byte_s: float) -> bool:
    """Whether an answer came too soon to be one: more of it than stray bytes before the question was out, or its end.

    `early`: how many of its bytes came before the question was out [-]. `after_ns`: from the question to its end [ns].
    An echo comes while the question goes out.
    """
    if request in answer:
        return after_ns < SOONEST * len(answer) * byte_s * NS
    return early > MOST_STRAY or after_ns < SOONEST * (len(request) + len(answer)) * byte_s * NS


class Line:
    """A port with the manners of question and answer; everything that crosses it is kept as events.

    `timing`: used where a question brings none of its own.
    """

    def __init__(self, name: str, port: Port, clock: Clock, timing: Timing | None = None) -> None:
        self.name = name
        self.port = port
        self.clock = clock
        self.timing = timing or Timing()
        self.transactions = 0  # questions since the line was opened: the transaction number of Modbus TCP
        self.copies = False  # whether bytes followed an answer, as where a device answers twice
        self.echoes = False  # whether the last question that could tell came back before its answer
        self.asked_ns = 0  # when something was last sent, and when a wait for bytes last ended: the times of a failure
        self.heard_ns = 0
        self._events: list[Event] = []
        self._remarks: dict[str, bool] = {}  # what a person should know: whether it was told
        self._not_before_ns = 0  # no question before this time: an answer to an earlier one may still come
        self._slowest_ns = 0  # until when an answer to the last question may come
        self._dirty = False
        self._doubtful = False  # a question went unanswered: its answer may still come, later than it should

    def open(self) -> None:
        """Open the port and forget what was; the line starts clean."""
        self.transactions = 0
        self._dirty = self._doubtful = self.echoes = self.copies = False
        with self._losing():
            self.port.open()

    def close(self) -> None:
        """Close the port."""
        self.port.close()

    def take_events(self) -> tuple[Event, ...]:
        """What crossed the wire since the last call, in order."""
        taken = tuple(self._events)
        self._events.clear()
        return taken

    def remark(self, text: str) -> None:
        """Keep what a person should know of the line; the same is told once."""
        self._remarks.setdefault(text, False)

    def take_remarks(self) -> list[str]:
        """What is not told yet."""
        untold = [text for text, is_told in self._remarks.items() if not is_told]
        self._remarks.update(dict.fromkeys(untold, True))
        return untold

    def ask(
        self, request: bytes, complete: Complete, timing: Timing | None = None, spoiled: Complete | None = None
    ) -> Reply:
        """Ask a question and return the whole answer.

        `complete`: tells how many of the bytes received end with a whole frame, or None while more are needed.
        `timing`: the device's own; the line's when left out.
        `spoiled`: the same, asked when no more bytes came in time: what is damaged is worth telling.
        Returns the bytes up to the end of the first whole frame; what follows it in the same breath makes the line
        dirty and is drained before the next question. Raises NoReplyError when the time was up; BadReplyError when
        what came cannot be an answer, or nothing but what came too early to be one; LostError when the port failed.
        """
        timing = timing or self.timing
        if self._dirty:
            self._drain(timing)
        request_ns = self._send(request)
        self._not_before_ns = request_ns + self._wait_ns(timing.slowest_reply_s)
        deadline_ns = request_ns + self._wait_ns(timing.timeout_s)
        self._dirty = True  # until the answer is in
        out_ns = request_ns + int(SOONEST * len(request) * timing.byte_s * NS)
        buffer, reply_ns, early, old = b"", request_ns, 0, ""
        while True:
            heard_ns, data = self._receive(deadline_ns)
            if not data:
                length = spoiled(buffer) if spoiled else None
                if length is not None:
                    break
                self._doubtful = True
                if old:
                    raise BadReplyError(old, Quality.STALE)
                raise NoReplyError(self._too_little(request, buffer, timing))
            reply_ns = heard_ns
            buffer += data
            early = len(buffer) if heard_ns < out_ns else early
            length = complete(buffer)
            while length is not None and _is_old(request, buffer[:length], early, reply_ns - request_ns, timing.byte_s):
                old = f"line {self.name}: a reply {(reply_ns - request_ns) / 1e6:.2f} ms after the question, {TOO_SOON}"
                buffer, early, self.copies = buffer[length:], max(early - length, 0), True
                length = complete(buffer)
            if length is not None:
                break
            if len(buffer) > MOST_REPLY_BYTES:
                raise BadReplyError(f"line {self.name}: {len(buffer)} bytes without the end of a reply")
        self._dirty = len(buffer) > length
        self.copies |= self._dirty
        if self._doubtful:
            self._expect_no_second(request_ns, timing)
        self._slowest_ns, self._not_before_ns = self._not_before_ns, reply_ns  # no other answer is due
        return Reply(buffer[:length], request_ns, reply_ns)

    def tell(self, data: bytes) -> int:
        """Send bytes that nothing answers, and return the time [ns]."""
        return self._send(data)

    def listen(self, wait_s: float) -> tuple[int, bytes]:
        """What a device that sends unasked has sent, with the time [ns]; no bytes when it was silent.

        `wait_s`: how long to wait for the first byte [s]; what is there already is returned at once.
        """
        return self._receive(self.clock.now_ns() + self._wait_ns(wait_s))

    def drop(self) -> None:
        """Mark the line as holding bytes that belong to no question; they are drained before the next one.

        The answer to the last question may still come.
        """
        self._dirty = True
        self._not_before_ns = max(self._not_before_ns, self._slowest_ns)

    def look(self, byte_s: float) -> None:
        """See whether bytes come before a question is asked: they answer none, and are drained first.

        `byte_s`: the wire is to be silent for `SILENT_BYTES` of so long [s] after what was heard last, since a copy of
            an answer follows it at once; 0 to see what is there.
        """
        silent_ns = self.heard_ns + int(SILENT_BYTES * byte_s * NS)
        time_ns, data = self._read(max(self.clock.now_ns(), silent_ns))
        if data:
            self._events.append(Event("rx", time_ns, data))
            self._dirty = self.copies = True

    def renew(self) -> None:
        """Close and open the port, so that what is still on its way does not come. Raises LostError."""
        with self._losing():
            self.port.close()
            self.port.open()

    def _expect_no_second(self, request_ns: int, timing: Timing) -> None:
        """After a timeout: the first answer is the right one only when none comes after it."""
        self._doubtful = False
        until_ns = request_ns + self._wait_ns(timing.slowest_reply_s)
        _, data = self._receive(until_ns)
        if data or self._dirty:
            self._dirty = self._doubtful = True
            raise BadReplyError(
                f"line {self.name}: two answers to one question after a timeout: the first was a late one",
                Quality.STALE,
            )

    def _send(self, data: bytes) -> int:
        with self._losing():
            time_ns = self.port.write(data)
        self._events.append(Event("tx", time_ns, data))
        self.asked_ns = time_ns
        return time_ns

    def _read(self, until_ns: int) -> tuple[int, bytes]:
        with self._losing():
            return self.port.read(until_ns)

    def _receive(self, until_ns: int) -> tuple[int, bytes]:
        time_ns, data = self._read(until_ns)
        self._events.append(Event("rx" if data else "silence", time_ns, data))
        self.heard_ns = time_ns
        return time_ns, data

    def _drain(self, timing: Timing) -> None:
        """Throw away what comes until the slowest reply could have come and the line is quiet."""
        quiet_ns = self._wait_ns(timing.quiet_s, least_real_s=0.0)
        time_ns, data = self._receive(max(self._not_before_ns, self.clock.now_ns() + quiet_ns))
        give_up_ns = max(time_ns, self._not_before_ns) + self._wait_ns(MOST_DRAIN_S)
        while data:
            until_ns = max(self._not_before_ns, time_ns + quiet_ns)
            time_ns, data = self._receive(until_ns)
            if data and time_ns > give_up_ns:
                raise BadReplyError(f"line {self.name} does not fall silent: is something else sending on it?")
        self._dirty = False

    def _wait_ns(self, span_s: float, least_real_s: float = LEAST_REAL_WAIT_S) -> int:
        if self.clock.rate > 1.0:
            span_s = max(span_s, least_real_s * self.clock.rate)
        return int(span_s * NS)

    @contextlib.contextmanager
    def _losing(self) -> Iterator[None]:
        """A port that fails is an event too."""
        try:
            yield
        except LostError as error:
            self._events.append(Event("lost", self.clock.now_ns(), str(error).encode()))
            raise

    def _too_little(self, request: bytes, buffer: bytes, timing: Timing) -> str:
        came = f"{len(buffer)} bytes ({buffer[:16].hex(' ')}) and then nothing" if buffer else "nothing"
        if buffer.endswith(request):
            came = "its own question, as an echo, and no answer"
        return f"line {self.name}: {came} within {self._wait_ns(timing.timeout_s) / NS:g} s (timeout_s)"
