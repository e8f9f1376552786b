"""What `spinbench runs` shows: a row a run, and one run in full."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.readings import with_error
from rig.recording.mistakes import shown
from rig.runlog.folder import A_FILE, PLATEAUS, SAMPLES, START, RunError, is_locked
from rig.runlog.lines import whole_lines
from rig.runlog.plateaus import QUANTITIES, Mean, PlateauRow
from rig.runlog.reader import BEING_WRITTEN, Run, read_end, read_start, state_of
from rig.runlog.rows import utc_ns, utc_text
from rig.runlog.schema import ended

SHOWN_EVENTS = 40
# Events that are no news in a summary.
QUIET = {
    *("state", "set-point", "statistics", "asked", "note", "plateau", "model check", "course", "expected"),
    *("zero", "failsafe", "watchdog", "capture", "capture start"),
}


@dataclass(frozen=True)
class RunRow:
    """One run in the list."""

    name: str
    kind: str = ""
    bench: str = ""
    outcome: str = ""
    rows: int = 0
    plateaus: int = 0
    simulated: bool = False


def list_runs(root: str | Path) -> list[RunRow]:
    """The runs of a folder, oldest first; other folders in it are passed over. Raises RunError where it is a file."""
    return [_row(folder) for folder in sorted(_folders(Path(root)), key=age_of)]


def _folders(root: Path) -> list[Path]:
    if not root.is_dir():
        if root.exists():
            raise RunError(f"{root}: {A_FILE}")
        return []
    return [entry for entry in root.iterdir() if entry.is_dir() and (entry / START).exists()]


def age_of(folder: Path) -> tuple[str, str]:
    """What runs are in order by: when each began, as names have it, then the name; that alone if it cannot be read."""
    try:
        begun = utc_text(utc_ns(read_start(folder).utc_start))
    except (ValueError, OverflowError):
        return folder.name, folder.name
    return begun.replace("-", "").replace(":", "").replace("T", "-"), folder.name


def _row(folder: Path) -> RunRow:
    name = shown(folder.name, 100)
    try:
        start = read_start(folder)
        locked = is_locked(folder)
        end = read_end(folder)
        outcome = state_of(end, locked)
        counts = dict(end.counts) if end is not None else {}
        rows = counts.get("samples", -1) if counts else _lines(folder / SAMPLES)
        plateaus = counts.get("plateaus", -1) if counts else _lines(folder / PLATEAUS)
        return RunRow(name, start.kind, start.bench, outcome, max(rows, 0), max(plateaus, 0), start.simulated)
    except RunError as error:
        return RunRow(name, outcome=f"unreadable: {shown(str(error).splitlines()[0], 120)}")


def _lines(path: Path) -> int:
    """Rows under the header."""
    return max(sum(1 for _ in whole_lines(path)) - 1, 0)


def find_run(name: str | Path, root: Path) -> Path:
    """A run's folder, by its path, its name, or the beginning of its name.

    `name`: what the person typed; ``last`` is the run that began last.
    Raises RunError when there is no such run, or more than one.
    """
    path = Path(name)
    if (path / START).exists() or len(path.parts) > 1:
        return path
    folders = _folders(root)
    if str(name) == "last" and folders:
        return max(folders, key=age_of)
    found = sorted(folder.name for folder in folders if folder.name.startswith(str(name)))
    if str(name) in found or len(found) == 1:
        return root / (str(name) if str(name) in found else found[0])
    if found:
        names = ", ".join(shown(one, 100) for one in found[:10])
        raise RunError(f"{len(found)} runs in {root} begin with '{name}': {names}; type more of the name")
    if not folders:
        raise RunError(f"there is no run in {root} yet; take one, or say with --logs where runs are")
    raise RunError(f"no run in {root} is called '{name}'; `spinbench runs list` shows those there are")


def summary(run: Run) -> str:
    """One run in full, for reading: start, plateaus, what went wrong, end."""
    return (
        "\n".join([*_start_lines(run), "", *_plateau_lines(run), "", *_event_lines(run), "", *_end_lines(run)]) + "\n"
    )


def _start_lines(run: Run) -> list[str]:
    start = run.start
    ambient = start.ambient
    room = [
        "pressure not noted" if ambient.pressure_bar_abs is None else f"{ambient.pressure_bar_abs:.4f} bar",
        "temperature not noted" if ambient.temperature_c is None else f"{ambient.temperature_c:.1f} °C",
        "humidity not noted"
        if ambient.relative_humidity is None
        else f"{100.0 * ambient.relative_humidity:.0f} % relative humidity",
    ]
    motor = (
        start.motor
        if isinstance(start.motor, str)
        else str(start.motor.get("name") or start.motor.get("kind", "a motor given in full"))
    )
    number = f" no. {_text(start.motor_serial)}" if start.motor_serial else ""
    lines = [
        f"{shown(run.name, 100)}: {start.kind} on bench {_text(start.bench)}{', simulated' if start.simulated else ''}",
        f"state      {run.state}",
        f"start      {_when(start.utc_start)}, operator {_text(start.operator) or 'not noted'}",
        f"motor      {_text(motor)}{number}, lubrication {_text(start.lubrication) or 'not noted'}",
        f"room       {', '.join(room)}",
    ]
    if start.note:
        lines.append(f"note       {_text(start.note)}")
    if start.parent:
        lines.append(f"parent     {_text(start.parent)}")
    lines += [f"{key:<10} {_text(value)}" for key, value in start.imported.items() if value]
    for name, device in start.devices.items():
        calibrated = f"calibration {device.calibration}" if device.calibration else ""
        known = ", ".join(_text(part) for part in (device.instrument, device.identity, calibrated) if part)
        trust = "" if start.simulated and device.trust == "simulated" else device.trust
        lines.append(f"device     {_text(name)}: {known}{f' ({_text(trust)})' if trust else ''}")
    return lines


def _plateau_lines(run: Run) -> list[str]:
    if not run.plateaus:
        return ["no plateaus"]
    names = [name for name in QUANTITIES if any(name in plateau.means for plateau in run.plateaus)]
    lines = ["  n  way   " + "  ".join(f"{name:>22}" for name in names) + "  note"]
    for plateau in run.plateaus:
        cells = "  ".join(f"{_mean(plateau, name):>22}" for name in names)
        note = "; ".join(word for word in ("" if plateau.settled else "not settled", _text(plateau.note)) if word)
        lines.append(f"{plateau.n:>3}  {plateau.direction:<5} {cells}  {note}".rstrip())
    gone = len({row.n for row in run.plateau_rows}) - len(run.plateaus)
    return lines + [f"{gone} plateaus were taken back"] * bool(gone)


def _mean(plateau: PlateauRow, name: str) -> str:
    mean: Mean | None = plateau.means.get(name)
    if mean is None:
        return ""
    sign = {-1: "<", 0: "", 1: ">"}[mean.censored]
    return f"{sign}{with_error(mean.mean, mean.se)}"


def _event_lines(run: Run) -> list[str]:
    news = [event for event in run.events if event.event not in QUIET]
    told = news[-SHOWN_EVENTS:]
    which = f"{len(told)}" if len(told) == len(news) else f"the last {len(told)}"
    lines = [f"{len(run.events)} events" + (f"; {which} out of the ordinary:" if news else "")]
    for event in told:
        details = _text(str(event.details["text"])) if "text" in event.details else _all_of(event.details)
        lines.append(f"{event.time_s:10.2f} s  {_text(event.event)}  {shown(details, 160)}".rstrip())
    return lines


def _all_of(details: Mapping[str, Any]) -> str:
    return ", ".join(f"{_text(str(key))}={_text(str(value))}" for key, value in details.items())


def _end_lines(run: Run) -> list[str]:
    qualities = ", ".join(f"{count} {quality}" for quality, count in run.samples["quality"].value_counts().items())
    lines = [f"samples    {len(run.samples)}{f' ({qualities})' if qualities else ''}"]
    lines += [f"torn       {name}: {dropped} bytes at its end are left out" for name, dropped in run.torn.items()]
    if run.end is None:
        killed = "killed: there is no end record; `spinbench runs repair` seals the run"
        return [
            *lines,
            "end        a program writes it now" if run.state == BEING_WRITTEN else f"end        {killed}",
        ]
    end = run.end
    lines.append(f"end        {_when(end.utc_end)}, {ended(end.outcome, end.stopped_by, _text(end.reason))}")
    if end.vented is not None:
        lines.append(f"line       {'vented' if end.vented else 'NOT known to be vented'}")
    return lines


def _when(utc: str) -> str:
    """A moment, to the second."""
    return f"{_text(utc).partition('.')[0].removesuffix('Z').replace('T', ' ')} UTC"


def _text(text: str) -> str:
    """Text of a file, fit for a terminal."""
    return shown(text, 200)
