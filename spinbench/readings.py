"""What a person names, as a recording: a recording/1 folder, or a run by its name."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from spinbench import published

MOST_PARENTS = 100
# Rows that read the same in two recordings show a copy; of two dates, where coarse dials may read alike, more of them.
FEWEST_ROWS, FEWEST_ROWS_OF_TWO_DATES = 2, 5

if TYPE_CHECKING:
    from rig.recording import Recording
    from rig.runlog import Run


def run_named(name: str, logs: Path) -> Run:
    """A run, by its folder, its name, the beginning of one, or `last`."""
    from rig.runlog import read_run
    from rig.runlog.listing import find_run

    return read_run(find_run(name, logs))


def folder_named(named: Path, logs: Path) -> Path:
    """A recording's folder; what is no path that exists may be a run, by its name, the beginning of one, or `last`.

    The sweep that comes with the program has its name too, where nothing else is called so.
    """
    from rig.recording import RecordingError
    from rig.runlog.folder import RunError
    from rig.runlog.listing import find_run

    if named.exists() and not named.name:  # a page and files are called after it
        return named.resolve()
    if named.exists() or len(named.parts) != 1:
        return named
    try:
        return find_run(named, logs)
    except RunError as error:
        if named == Path(published.NAME):
            return published.published_sweep()
        raise RecordingError(f"there is no folder '{named}', and {error}") from error


def is_recording(folder: Path) -> bool:
    """Whether a folder is a recording or a run, of a run what is left of it too."""
    from rig.runlog.folder import END, START

    return any((folder / name).is_file() for name in ("recording.toml", START, END))


def is_swept(folder: Path) -> bool:
    """Whether a recording or run is one of levels, as a sweep is; what cannot be read is left to who reads it."""
    from rig.runlog.folder import START, RunError
    from rig.runlog.reader import read_start

    if not (folder / START).is_file():
        return True
    try:
        return read_start(folder).kind in ("sweep", "manual", "import")
    except RunError:
        return True


def date_stated(folder: Path) -> str:
    """The date that a recording or run states, or nothing; what cannot be read is left to who reads it."""
    from configs import ConfigError, read_toml
    from rig.runlog.folder import START, RunError
    from rig.runlog.reader import read_start

    try:
        if (folder / START).is_file():
            return read_start(folder).taken
        origin = read_toml(folder / "recording.toml").get("origin")
    except (RunError, ConfigError):
        return ""
    return str(origin.get("date", "")) if isinstance(origin, dict) else ""


def read(path: Path, quiet: bool = False, among_many: bool = False) -> Recording:
    """A recording: a recording/1 folder, or what a run's plateaus and captures amount to, with remarks on it.

    `among_many`: the remarks have the folder's name.
    Raises RunError for a sealed run whose readings are not as they were sealed: all that is wrong with it.
    """
    from rig.recording import read_recording
    from rig.runlog.folder import END, START

    if not any((path / name).exists() for name in (START, END)):
        recording = read_recording(path)
        check_written_out(recording)
        return recording
    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    refuse_changed(path)
    exported = recording_of(read_run(path))
    whose = f"{path.name}: " if among_many else ""
    for words in exported.notes if not quiet else ():
        print(f"spinbench: {whose}{words}", file=sys.stderr)
    return exported.recording


def read_of_many(path: Path) -> Recording:
    """One recording of many, read by another process."""
    return read(path, among_many=True)


def refuse_changed(path: Path) -> None:
    """Refuse a sealed run whose readings are not as they were sealed. Raises RunError: all that is wrong with it."""
    from rig.runlog.folder import EVENTS, PLATEAUS, SAMPLES, START, RunError
    from rig.runlog.reader import read_end
    from rig.runlog.verify import changed, verify

    end = read_end(path)
    if end is not None and changed(path, end, (START, SAMPLES, EVENTS, PLATEAUS)):
        raise RunError(
            f"{path}: not as it was sealed: {'; '.join(verify(path))}; take a sound copy or, where the change is "
            "meant, export the run and name what that makes"
        )


def check_written_out(recording: Recording) -> None:
    """Refuse a radial piston motor that is written out in a recording with mistakes.

    Raises RecordingError: each mistake in a line, with its place.
    """
    from configs import ConfigError
    from model.motor import read_motor
    from rig.recording import RecordingError

    if isinstance(recording.motor, str) or not recording.is_of_radial_piston:
        return
    try:
        read_motor(recording.motor)
    except ConfigError as error:
        lines = (f"{recording.folder}/recording.toml: {line}" for line in str(error).splitlines())
        raise RecordingError("\n".join(lines)) from None


def all_named(
    named: Sequence[Path],
    logs: Path,
    parents: bool = False,
    among_many: bool = False,
    known: Sequence[Recording] = (),
) -> list[Recording]:
    """The recordings that a person names and, where asked for, what each goes on from, ahead of it.

    `among_many`: there are others besides: remarks have the name of the folder, also of a single one.
    `known`: those that are there already; what goes on from one does not take it in again.

    Raises RecordingError when a parent is missing, or parents go in a circle.
    """
    folders = [folder_named(one, logs) for one in named]
    if not parents or len({folder.resolve() for folder in folders}) < len(folders):  # whoever calls refuses these
        return [read(folder, among_many=among_many or len(folders) > 1) for folder in folders]
    found: dict[Path, Recording | None] = {}
    for folder in folders:
        found |= reversed(_back_from(folder, found, logs).items())
    own = {folder.resolve() for folder in folders}
    read_ones = [
        one
        for place, one in found.items()
        if one is not None and (place in own or not any(_is_same(one, other) for other in known))
    ]
    zeros = [one for one in read_ones if all(file.kind == "zero" for file in one.files)]
    for one in zeros if len(zeros) < len(read_ones) else []:
        print(f"spinbench: passed over: {one.folder}: it holds zero rows alone", file=sys.stderr)
        read_ones.remove(one)
    return read_ones


def _back_from(folder: Path, known: Mapping[Path, Recording | None], logs: Path) -> dict[Path, Recording | None]:
    """A recording and what it goes on from, the last one first, up to one that is known."""
    from rig.recording import RecordingError
    from rig.recording.mistakes import shown

    line: dict[Path, Recording | None] = {}
    at = folder
    while at.resolve() not in known:
        if at.resolve() in line or len(line) >= MOST_PARENTS:
            last = " after ".join(shown(place.name, 100) for place in [*line, at][-3:])
            raise RecordingError(
                f"{folder}: its parents go in a circle, or are more than {MOST_PARENTS}: ... {last}; name the "
                "recordings one after the other, without --with-parents"
            )
        line[at.resolve()], parent = _with_its_parent(at, is_named=not line)
        if not parent:
            break
        at = _place_of(parent, at, logs)
    return line


def _with_its_parent(folder: Path, is_named: bool) -> tuple[Recording | None, str]:
    """A recording, and the name of what it goes on from; a parent that holds nothing is passed over with a remark."""
    from rig.runlog.folder import START, EmptyRunError
    from rig.runlog.reader import read_start

    if not (folder / START).exists():
        one = read(folder, among_many=True)
        return one, one.origin.get("parent", "")
    parent = read_start(folder).goes_on_from
    try:
        one = read(folder, among_many=True)
    except EmptyRunError as error:
        if is_named:
            raise
        print(f"spinbench: passed over: {error}", file=sys.stderr)
        return None, parent
    return one, parent


def _place_of(parent: str, child: Path, logs: Path) -> Path:
    """Where a parent is: beside what goes on from it, or among the runs."""
    from rig.recording import RecordingError
    from rig.recording.mistakes import shown

    beside = child.resolve().parent
    places = [place / parent for place in (beside, logs)] if Path(parent).name == parent else []
    for place in places:
        if is_recording(place):
            return place
    raise RecordingError(
        f"{child}: goes on from '{shown(parent, 100)}', which is neither in {beside} nor in {logs}; name the "
        "recordings one after the other, without --with-parents"
    )


def warnings_in(parts: Sequence[Recording]) -> list[str]:
    """What is to be said of recordings, each once, with the folder's name where they are several."""
    said = [
        f"{one.folder.name}: {words}" if len(parts) > 1 and not one.joined else words
        for one in parts
        for words in one.warnings
    ]
    return list(dict.fromkeys(said))


def refuse_twice(parts: Sequence[Recording], unseen: Recording | None = None) -> None:
    """Refuse readings that are given twice, whatever their path: they would count twice, or be predicted once seen.

    So is a run held out that one instrument would have read while it read another.
    """
    from calibration.data.together import refuse_unlike
    from rig.recording import RecordingError

    for i, one in enumerate(parts):
        if unseen is not None and _is_same(one, unseen):
            also = "" if one.folder == unseen.folder else f", as {one.folder}"
            raise RecordingError(
                f"{unseen.folder} is to be held out and diagnosed{also}: name a run that is not among the others"
            )
        for other in parts[:i]:
            if _is_same(one, other):
                these = one.folder if one.folder == other.folder else f"{one.folder}, which is {other.folder} or a copy"
                dates = " and ".join(sorted({part.origin.get("date", "") for part in (one, other)} - {""}))
                also = f" under two dates ({dates})" * (" and " in dates)
                raise RecordingError(
                    f"a recording is given twice{also}: {these}; its readings would count twice, so name it once"
                )
    if unseen is not None:
        refuse_unlike([*parts, unseen])


def each_once(folders: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Folders without those that hold the readings of one before them; and what is passed over, in words.

    What cannot be read is left to who reads it.
    """
    from spinbench.cli.errors import exit_code

    kept: list[tuple[Path, Recording | None]] = []
    places: dict[Path, Path] = {}  # to find a folder's place takes longer than to hold its readings against another's
    words = []
    for folder in folders:
        try:
            one = read(folder, quiet=True)
        except Exception as error:
            if exit_code(error) is None:
                raise
            kept.append((folder, None))
            continue
        place = folder.resolve()
        same = places.get(place) or next((before for before, other in kept if other and _holds(one, other)), None)
        if same is None:
            places[place] = folder
            kept.append((folder, one))
        else:
            words.append(f"passed over: {folder}: it holds the readings of {same}")
    return [folder for folder, _ in kept], words


def _is_same(one: Recording, other: Recording) -> bool:
    return one.folder.resolve() == other.folder.resolve() or _holds(one, other)


def _holds(one: Recording, other: Recording) -> bool:
    """Whether a recording holds the readings of another."""
    if one.sha256 != "" and one.sha256 == other.sha256:
        return True
    dates = {recording.origin.get("date", "") for recording in (one, other)} - {""}
    fewest = FEWEST_ROWS if len(dates) < 2 else FEWEST_ROWS_OF_TWO_DATES
    return bool(_read_in(one, fewest) & _read_in(other, fewest))


def _read_in(recording: Recording, fewest: int) -> set[tuple[tuple[str, bytes], ...]]:
    """What was read in each file of so many rows, by channel: the same in a run and in what it was exported to.

    A zero has few readings, which another zero may have too; whatever copies one copies more.
    """
    return {
        tuple(
            (name, file.columns[name].values.tobytes()) for name in sorted(recording.channels) if name in file.columns
        )
        for file in recording.files
        if file.kind != "zero" and file.rows >= fewest
    } - {()}


def so_far(folder: Path) -> Recording:
    """The plateaus of a run that is being written; the check beside a sweep calls it in its own process."""
    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    return recording_of(replace(read_run(folder), state="so far")).recording  # an export is of what has ended
