"""What a command gives: tables on the terminal, JSON and files where they were asked for, remarks on standard error."""

from __future__ import annotations

import codecs
import csv
import html
import io
import json
import re
import sys
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

WIDTH, WIDTH_OF_FIGURES = 140, 120  # of a table in a pipe, where no column is cut


# What stands for a character that the terminal's encoding does not have.
PLAIN = {"±": "+-", "−": "-", "–": "-", "×": "x", "÷": "/", "·": "*", "°": "deg ", "…": "...", "→": "->", "ω": "omega"}
PLAIN |= {"“": '"', "”": '"', "’": "'", "≤": "<=", "≥": ">=", "µ": "u", "μ": "u"}
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")  # which a file's name may hold
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def suit_the_terminal() -> None:
    """Write what a terminal's encoding does not have in other characters: no result is lost for it."""
    codecs.register_error("plain", _in_plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _in_plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    text = re.sub(r"[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: f"^{found[0].translate(RAISED)}", text)
    return "".join(one if one.isascii() else PLAIN.get(one, "?") for one in text), error.end


def remark(*lines: str) -> None:
    """A line each on standard error, control characters escaped."""
    for words in lines:
        harmless = CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), words)
        print(f"spinbench: {harmless}", file=sys.stderr)


def on_terminal(*tables: object, width: int = WIDTH) -> None:
    """Tables on standard output; a terminal that is too narrow for one breaks its lines, and no figure is cut."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else width)
    seen = console.width
    for table in tables:
        console.width = _width_that_cuts_nothing(console, table, seen)
        console.print(table)


def _width_that_cuts_nothing(console: Any, table: Any, seen: int) -> int:
    """The width of the terminal, or the next at which no cell ends in an ellipsis that a wide one does not have."""
    from rich.measure import Measurement

    if Measurement.get(console, console.options.update(max_width=WIDTH), table).maximum <= seen:
        return seen

    def cut(width: int) -> int:
        lines = console.render_lines(table, console.options.update(width=width))
        return sum(part.text.count("…") for line in lines for part in line)

    console.width = WIDTH
    least = cut(WIDTH)
    return next((width for width in range(seen, WIDTH, 4) if cut(width) <= least), max(seen, WIDTH))


def check_places(out: Path | None, json_file: Path | None) -> None:
    """Whether results could be written, before the work that they come of.

    Raises RecordingError where they would be written among the files of a recording or run or below them, or into a
    folder that is called like a file.
    """
    from rig.recording import RecordingError, files
    from spinbench.readings import is_recording

    file = None if json_file is None or str(json_file) == "-" else json_file
    if out is not None and out.suffix.lower() in files.OF_FILES and not out.exists():
        raise RecordingError(f"{out}: '{out.suffix}' is the ending of a file, and a folder is written; name a folder")
    files.check_places(out, file)
    for folder in (out, None if file is None else file.parent):
        above = () if folder is None else (folder, *folder.resolve().parents)
        if (taken := next((one for one in above if is_recording(one)), None)) is not None:
            where = f"{folder} is" if taken == folder else f"{folder} lies in {taken}, which is"
            raise RecordingError(f"{where} a recording or run, which stays as it is; name another folder")


def write_report(out: Path, contents: Mapping[str, bytes], document: str) -> None:
    """Write a report's files; say so where that replaces one of other recordings, or the page of another command.

    A page of one recording that the diagnosis there had, and this one has not, is removed.

    `document`: which of the files says, as JSON, what it was made of.
    """
    from calibration.report.render import HTML
    from rig.recording import files
    from rig.recording.mistakes import shown

    before, page = read_if_there(out / document), title_of(read_if_there(out / HTML))
    files.write_files(out, contents)
    gone = own_pages(before) - contents.keys()
    for one in out.glob("report_*"):
        if one.name in gone:
            one.unlink()
    tell_replaced(out, recordings_in(before), recordings_in(contents[document]))
    if page.partition(" ")[0] != title_of(contents.get(HTML, b"")).partition(" ")[0] and page:
        remark(f"replaced: the page in {out}, which was '{shown(page, 100)}'")


def title_of(page: bytes) -> str:
    """The title of a page, whose first word tells which command it is of."""
    found = re.search(r"<title>([^<]*)</title>", page[:2000].decode(errors="replace"))
    return html.unescape(found[1]).strip() if found else ""


def own_pages(data: bytes) -> set[str]:
    """The files of the pages that a diagnosis has for each of several recordings; none where it does not say."""
    try:
        found = json.loads(data)
        names = {file["file"].rpartition("/")[0] for file in found["files"] if found["format"].startswith("diagnosis/")}
        return {f"{own_stem(name)}{ending}" for name in names - {""} for ending in (".html", ".png")}
    except (ValueError, LookupError, TypeError, AttributeError):
        return set()


def own_stem(name: str) -> str:
    """What the page of one of several recordings is called, without the ending."""
    return f"report_{name.replace('/', '_')}"


def tell_replaced(out: Path, before: Iterable[str], now: Collection[str]) -> None:
    """Say that the report in a folder was of other recordings than the one that is there now."""
    gone = [Path(name).name for name in dict.fromkeys(before) if name not in now]
    if gone:
        more = f" and {len(gone) - 5} more" * (len(gone) > 5)
        remark(f"replaced: the report in {out}, which was of {', '.join(gone[:5])}{more}")


def recordings_in(data: bytes) -> list[str]:
    """The recordings that a report's JSON, or a table's CSV, is of; none where it does not say."""
    try:
        text = data.decode()
        rows = json.loads(text).get("recordings") if text.startswith("{") else csv.DictReader(text.splitlines())
        return [str(row.get("folder") or row["recording"]) for row in rows or []]
    except (ValueError, csv.Error, LookupError, TypeError, AttributeError):
        return []


def read_if_there(file: Path) -> bytes:
    """A file's bytes; none where there is none."""
    try:
        return file.read_bytes() if file.is_file() else b""
    except OSError:
        return b""


def deliver(data: bytes, tables: Iterable[object], json_file: Path | None) -> None:
    """JSON where it was asked for, and the tables unless standard output is taken."""
    if not takes_output(data, json_file):
        on_terminal(*tables, width=WIDTH_OF_FIGURES)


def folder_of(json_file: Path | None) -> Path:
    """The folder that JSON is written to, whose paths are as seen from there."""
    return Path() if json_file is None or str(json_file) == "-" else json_file.parent


def takes_output(data: bytes, json_file: Path | None) -> bool:
    """Write JSON where it was asked for; whether that was standard output."""
    from rig.recording import files

    if json_file is not None and str(json_file) == "-":
        sys.stdout.flush()
        sys.stdout.buffer.write(data)
        return True
    if json_file is not None:
        files.write_file(json_file, data)
    return False
