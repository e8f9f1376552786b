"""One reading to one row of samples.csv and back, one exchange to one line of wire.jsonl and back.

Times are written from integers and read back to the same integers; a value is written so that it reads back to the same
bits. Each row is one line whatever a device said: control characters are written as escapes.
"""

from __future__ import annotations

import csv
import datetime
import io
import json
import math
import re
from collections.abc import Mapping
from typing import Any

from rig.readings import NS, Event, Exchange, Reading
from rig.recording import safe_text
from rig.runlog.schema import WireLine

COLUMNS = (
    "n",
    "exchange",
    "device",
    "channel",
    "value",
    "unit",
    "quality",
    "censored",
    "time_s",
    "request_s",
    "reply_s",
    "utc",
    "retries",
    "raw",
    "detail",
)
HEADER = (",".join(COLUMNS) + "\n").encode()
MAX_TEXT = 500  # characters of a text cell
MAX_DEPTH = 8  # of an event's details
_SECONDS = re.compile(r"(-?)([0-9]{1,10})\.([0-9]{9})", re.ASCII)
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def seconds(ns: int) -> str:
    """Nanoseconds as seconds with nine decimals."""
    whole, part = divmod(abs(ns), NS)
    return f"{'-' if ns < 0 else ''}{whole}.{part:09d}"


def nanoseconds(text: str) -> int:
    """The integer that `seconds` wrote; ValueError for anything else."""
    match = _SECONDS.fullmatch(text)
    if match is None:
        raise ValueError("expected seconds with nine decimals")
    ns = int(match[2]) * NS + int(match[3])
    return -ns if match[1] else ns


def utc_text(utc_ns: int) -> str:
    """UTC since 1970 [ns] as ISO 8601 with microseconds."""
    return (_EPOCH + datetime.timedelta(microseconds=utc_ns // 1000)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def utc_ns(text: str) -> int:
    """UTC since 1970 [ns] of a time in ISO 8601, which is UTC where it names no zone; ValueError for anything else."""
    time = datetime.datetime.fromisoformat(text)
    since = time.replace(tzinfo=time.tzinfo or datetime.UTC) - _EPOCH
    return since // datetime.timedelta(microseconds=1) * 1000


def harmless(text: str, length: int = MAX_TEXT) -> str:
    """Text fit for a CSV cell: bounded, on one line, and with an apostrophe before what a spreadsheet would run."""
    if len(text) > length:
        text = text[: length - 3] + "..."
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
    return f"'{text}" if text.startswith("'") else safe_text.harmless(text)


def unescaped(cell: str) -> str:
    """The text that `harmless` put into a cell."""
    return cell.removeprefix("'")


def csv_line(cells: list[str]) -> bytes:
    """Cells as one line of CSV."""
    if any(mark in cell for cell in cells for mark in ',"'):
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerow(cells)
        return stream.getvalue().encode("utf-8")
    return (",".join(cells) + "\n").encode("utf-8")


def sample_line(n: int, exchange: int, reading: Reading, utc_start_ns: int) -> bytes:
    """A row of samples.csv. `reading`: what is written. A value that is no finite number is written as none."""
    value = "" if reading.value is None or not math.isfinite(reading.value) else repr(float(reading.value))
    return csv_line(
        [
            str(n),
            str(exchange),
            harmless(reading.device, 100),
            harmless(reading.channel, 100),
            value,
            harmless(reading.unit, 40),
            reading.quality.value,
            str(reading.censored),
            seconds(reading.time_ns),
            seconds(reading.request_ns),
            seconds(reading.reply_ns),
            utc_text(utc_start_ns + reading.time_ns),
            str(reading.retries),
            harmless(reading.raw),
            harmless(reading.detail),
        ]
    )


def wire_line(n: int, exchange: Exchange) -> bytes:
    """A line of wire.jsonl."""
    line = {
        "n": n,
        "line": exchange.line,
        "device": exchange.device,
        "action": exchange.action,
        "argument": exchange.argument,
        "events": [[event.kind, event.time_ns, event.data.hex()] for event in exchange.events],
        "readings": len(exchange.readings),
        "outcome": clean(exchange.outcome)[:4000],
    }
    return json_line(line)


def exchange_of(line: WireLine, readings: tuple[Reading, ...]) -> Exchange:
    """The exchange of a line of wire.jsonl; ValueError when its bytes are not hexadecimal."""
    events = tuple(Event(kind, time_ns, bytes.fromhex(data)) for kind, time_ns, data in line.events)
    return Exchange(line.line, line.device, line.action, line.argument, events, readings, line.outcome)


def event_line(n: int, kind: str, time_ns: int, utc_start_ns: int, details: Mapping[str, Any]) -> bytes:
    """A line of events.jsonl. `details`: what else is to be said; a key of the line's own is kept under ``<key>_``."""
    line = {"n": n, "time_s": time_ns / NS, "utc": utc_text(utc_start_ns + time_ns), "event": clean(kind)[:200]}
    return json_line(
        line | {f"{key}_" if key in line else clean(str(key)): plain(part) for key, part in details.items()}
    )


def json_line(tree: Mapping[str, Any]) -> bytes:
    """An object as one line of JSON; ASCII, so that no text of a device can end the line."""
    return (json.dumps(tree, separators=(",", ":"), allow_nan=False) + "\n").encode("ascii")


def plain(value: Any) -> Any:
    """What JSON can hold of a value: numbers that are not finite and things of other kinds become bounded text."""
    return _bounded(safe_text.finite(value, str))


def _bounded(value: Any, depth: int = 0) -> Any:
    if value is None or isinstance(value, bool | int | float):
        return value
    if depth < MAX_DEPTH and isinstance(value, dict):
        return {clean(str(key))[:200]: _bounded(part, depth + 1) for key, part in value.items()}
    if depth < MAX_DEPTH and isinstance(value, list):
        return [_bounded(part, depth + 1) for part in value]
    return clean(str(value))[:4000]


def clean(text: str) -> str:
    """Text that UTF-8 can hold: half a surrogate pair, as Python makes of a byte that is none, becomes an escape."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
