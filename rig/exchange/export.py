"""A run as a recording/1 folder: plateaus, zero phases and captures, with the figures of the instruments.

Only usable readings go in; what was left out is counted in notes.txt beside the data.
"""

from __future__ import annotations

import dataclasses
import hashlib
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.exchange.figures import Figures
from rig.readings import NS
from rig.recording import Ambient, Column, Recording, RecordingFile, write_recording
from rig.recording.schema import MOST_TEXT, SupplyTable, supply_of
from rig.runlog.folder import HASHED, EmptyRunError, RunError, sha256_of, write_whole
from rig.runlog.phases import DERIVED_DEVICE, Phase, Series, captures, quantity_channels, series, zeros
from rig.runlog.plateaus import PRESSURES, Mean, PlateauRow
from rig.runlog.reader import BEING_WRITTEN, Run
from rig.runlog.schema import ROOM, AmbientRecord

NOTES = "notes.txt"
GAP_S, GAP = 0.5, 5.0  # of the pressure in a capture, told when it is longer than both: seconds, usual distances
SLOWER, LATE_S = 4.0, 0.05  # times the usual exchange, and no less, from which on a reply came late
UNASKED = 2.5  # times the usual pause between two readings, after which a held value may have been shown for long
BEFORE = 4.0  # updates of a gauge before a capture, in which it has most likely shown another value
SAME = 1e-6  # share within which two ways to a speed give the same
STANDS = 3.0  # standard errors of a mean speed that is none
VENTED_WITHIN_BAR = 0.05  # a gauge's own offset is less


@dataclass(frozen=True)
class Exported:
    """What an export made.

    Attributes
    ----------
    notes : list of str
        What was left out, and what was assumed.
    """

    recording: Recording
    notes: list[str]


def export_recording(run: Run, folder: Path, unsettled: bool = False) -> Exported:
    """Write a run as a recording/1 folder.

    Raises
    ------
    RunError
        When the run is being written, or (`EmptyRunError`) holds nothing that a recording could.
    RecordingError
        When the folder cannot be made.
    """
    exported = recording_of(run, unsettled)
    Path(folder).parent.mkdir(parents=True, exist_ok=True)
    write_recording(exported.recording, Path(folder))
    text = "\n".join([f"exported from the run {run.name}", *exported.notes]) + "\n"
    write_whole(Path(folder) / NOTES, text.encode("utf-8"))
    return exported


def recording_of(run: Run, unsettled: bool = False) -> Exported:
    """A run as a recording, not written anywhere: what `fit` and `diagnose` take of a run folder.

    Raises
    ------
    RunError
        When the run is being written, or (`EmptyRunError`) holds nothing that a recording could.
    """
    if run.state == BEING_WRITTEN:
        raise RunError(f"{run.folder}: a program writes this run now; export it when it has ended")
    notes = _about(run)
    channels = quantity_channels(run)
    figures = Figures(run, channels)
    plateaus = _chosen(run, unsettled, notes)
    zero_phases, left_out = zeros(run)
    notes += left_out
    files = [
        file
        for file in (
            _steady(plateaus, figures, notes),
            _zero(run, channels, zero_phases, figures, notes),
            *_transients(run, channels, figures, notes),
        )
        if file is not None
    ]
    notes += _counted(run, channels, plateaus)
    if not files:
        raise EmptyRunError(
            f"{run.folder}: nothing to export: {len(run.plateau_rows)} plateaus written, of which {len(plateaus)} can "
            f"be used, and no zero phase or capture with readings; {'; '.join(notes[1:]) or 'the run ended too early'}"
        )
    columns = {name for file in files for name in file.columns}
    recording = Recording(
        folder=run.folder,
        motor=run.start.motor,
        ambient=_ambient(run),
        channels={name: figures.channel(name) for name in channels if name in columns},
        files=tuple(_at_rest_below(file) for file in files),
        sha256=_digest(run),
        supply=supply_of(SupplyTable(**{key: getattr(run.start.supply, key) for key in SupplyTable.model_fields})),
        origin=_origin(run),
        added_inertia_kg_m2=run.start.added_inertia_kg_m2,
    )
    return Exported(recording, notes)


def _origin(run: Run) -> dict[str, str]:
    """Where the recording comes from, as far as the run says it."""
    start = run.start
    note = start.note[: MOST_TEXT // 2]  # the run's name comes behind it in any case
    said = {
        "date": start.taken,
        "operator": start.operator,
        "motor_serial": start.motor_serial,
        "oil": start.lubrication,
        "note": f"{note}{'; ' * bool(note)}run {run.name}, bench {start.bench}",
        "parent": start.goes_on_from,
    }
    return {key: text[:MOST_TEXT] for key, text in said.items() if text}


def _about(run: Run) -> list[str]:
    notes = []
    if run.start.simulated:
        notes.append("simulated: the readings are those of a virtual bench")
    if run.state != "finished":
        reason = f" ({run.end.reason})" if run.end is not None and run.end.reason else ""
        notes.append(f"the run is {run.state}{reason}")
    if run.end is not None:
        kept = {name: sha256 for name, sha256 in run.end.sha256.items() if (run.folder / name).is_file()}
        changed = [name for name, sha256 in kept.items() if sha256_of(run.folder / name) != sha256]
        notes += [f"{name} was changed since the run was sealed" for name in changed]
    notes += [f"{name} ends in a torn line; {dropped} bytes were left out" for name, dropped in run.torn.items()]
    return notes


def _chosen(run: Run, unsettled: bool, notes: list[str]) -> list[PlateauRow]:
    """The plateaus that can be used, in the order of time."""
    chosen = []
    for plateau in run.plateaus:
        found = set(plateau.means)
        if not found & set(PRESSURES) or not found & {"speed_rpm", "flow_l_min"}:
            notes.append(f"plateau {plateau.n}: left out, no pressure, or neither speed nor flow")
        elif "speed_rpm" in found and _stood(plateau.means["speed_rpm"]):
            notes.append(
                f"plateau {plateau.n}: left out, the rotor stood still; the steady model is of a motor that runs, and "
                "says nothing of the pressure at which it starts"
            )
        elif not plateau.settled and not unsettled:
            notes.append(f"plateau {plateau.n}: left out, not settled ({plateau.note or 'no note'})")
        else:
            chosen.append(plateau)
    return sorted(chosen, key=lambda plateau: (plateau.start_s, plateau.n))


def _stood(speed: Mean) -> bool:
    """Whether the mean is no more than the last readings of a rotor that came to rest."""
    return speed.mean <= STANDS * (speed.se or 0.0)


def _steady(plateaus: list[PlateauRow], figures: Figures, notes: list[str]) -> RecordingFile | None:
    if not plateaus:
        return None
    columns = {"time_s": _column([(plateau.start_s + plateau.end_s) / 2.0 for plateau in plateaus])}
    if len(set(columns["time_s"].values.tolist())) < len(plateaus):
        notes.append("sweep.csv: without times, some plateaus have the same")
        del columns["time_s"]
    for name in figures.channels:
        means = [plateau.means.get(name) for plateau in plateaus]
        if any(mean is not None for mean in means):
            values = [np.nan if mean is None else mean.mean for mean in means]
            columns[name] = _column(values, [0 if mean is None else mean.censored for mean in means])
    direction = np.array([plateau.direction for plateau in plateaus], dtype="<U4")
    return RecordingFile("sweep.csv", "steady", 0.0, 1.0, len(plateaus), columns, direction)


def _zero(
    run: Run, channels: dict[str, str], phases: list[Phase], figures: Figures, notes: list[str]
) -> RecordingFile | None:
    """One row a zero phase, the mean of each channel."""
    from rig.plateaus.plateau import mean_of  # late: the sweep writes run logs

    derived = [name for name, channel in channels.items() if channel.startswith(f"{DERIVED_DEVICE}.")]
    if phases and derived:
        notes.append(
            "zero.csv has no flow: a zero error in standard litres cannot be carried over to the pressures of the sweep"
        )
    used = {name: channel for name, channel in channels.items() if name not in derived}
    cells: dict[str, list[tuple[float, int]]] = {name: [] for name in used}
    errors: dict[str, list[float]] = {name: [] for name in used}
    for phase in phases:
        for name, channel in used.items():
            read = series(run, channel, phase.start_s, phase.end_s)
            mean = mean_of(read.time_ns / NS, read.value, read.censored)
            value = np.nan if mean.mean is None or (name == "speed_rpm" and mean.mean < 0.0) else mean.mean
            cells[name].append((value, mean.censored))
            errors[name] += [mean.se] if mean.se else []
    columns = {
        name: _column([value for value, _ in found], [censored for _, censored in found])
        for name, found in cells.items()
        if any(not np.isnan(value) for value, _ in found)
    }
    if not columns:
        notes += [f"{len(phases)} zero phases without a usable reading"] * bool(phases)
        return None
    times = [(phase.start_s + phase.end_s) / 2.0 for phase in phases]
    if len(set(times)) == len(times):
        columns = {"time_s": _column(times)} | columns
    return RecordingFile("zero.csv", "zero", 0.0, figures.scale_of(errors), len(phases), columns)


def _transients(run: Run, channels: dict[str, str], figures: Figures, notes: list[str]) -> list[RecordingFile]:
    files: list[RecordingFile] = []
    phases, left_out = captures(run)
    notes += left_out
    for phase in phases:
        stem = phase.kind.replace("-", "_")
        number = 1 + sum(file.file.startswith(stem) for file in files)
        name = f"{stem}.csv" if number == 1 else f"{stem}_{number}.csv"
        read = {
            column: series(run, channel, phase.start_s, phase.end_s)
            for column, channel in channels.items()
            if column != "inlet_temperature_c"
        }
        for column in (one for one in PRESSURES if one in read):
            read[column], late = _of_known_moment(run, channels[column], phase, read[column])
            if late:
                notes.append(f"{name}, {column}: {late} readings left out, their replies came late")
        if "speed_rpm" in read:
            read["speed_rpm"] = _since_before(run, channels["speed_rpm"], phase, read["speed_rpm"])
        sampled = {column for column, found in read.items() if found.value.size}
        if not sampled & set(PRESSURES) or not sampled & {"speed_rpm", "flow_l_min"}:
            notes.append(f"{phase.kind} from {phase.start_s:.1f} s: left out, no pressure, or neither speed nor flow")
            continue
        files.append(_transient(name, phase, {column: read[column] for column in read if column in sampled}, figures))
        for column, found in read.items():
            if found.unusable or found.unverified:
                words = f"{found.unusable} readings unusable and left out, {found.unverified} unverified"
                notes.append(f"{name}, {column}: {words}")
        notes += [f"{name}: {text}" for text in _remarks(run, phase, read)]
    return files


def _update_s(run: Run, channel: str) -> float:
    """How long an instrument repeats a value until it has measured again [s]; 0 where it measures when asked."""
    device = run.start.devices.get(channel.partition(".")[0])
    source = None if device is None else run.start.sources.get(f"instruments/{device.instrument}.toml")
    return float(tomllib.loads(source.text).get("update_s", 0.0)) if source is not None else 0.0


def _of_known_moment(run: Run, channel: str, phase: Phase, found: Series) -> tuple[Series, int]:
    """The readings that are new and whose moment is known, and how many new ones are left out.

    A value that is repeated is of the moment when it was first shown, or of a whole number of the instrument's updates
    later. That is not known where the reply was late, or where the instrument had not been asked for long.
    """
    known, update_s = _prompt(found), _update_s(run, channel)
    if not update_s or not found.time_ns.size:
        return _only(found, np.flatnonzero(known)), int(np.sum(~known))
    if found.time_ns.size > 1:
        gap = np.diff(found.time_ns, prepend=found.time_ns[0])
        known &= gap <= max(UNASKED * float(np.median(gap[1:])), LATE_S * NS)
    # When the gauge measures, the readings before the phase tell too.
    longer = series(run, channel, phase.start_s - BEFORE * update_s, phase.end_s)
    update_ns, moment = int(update_s * NS), longer.time_ns.copy()
    new: list[int] = []
    for i, value in enumerate(longer.value):
        if new and value == longer.value[new[-1]]:
            updates = (moment[i] - moment[new[-1]]) // update_ns
            if not updates:
                continue
            moment[i] = moment[new[-1]] + updates * update_ns
        new.append(i)
    before = longer.time_ns.size - found.time_ns.size
    # The first stands for the level that was held when the phase began.
    new = [0, *(i - before for i in new if i > before and moment[i] > found.time_ns[0])]
    kept = [i for i in new if known[i]]
    moment[before] = found.time_ns[0]
    told = dataclasses.replace(found, time_ns=moment[before:])
    return _only(told, np.array(kept, dtype=int)), len(new) - len(kept)


def _only(found: Series, kept: np.ndarray) -> Series:
    """Some of the readings."""
    arrays = ("time_ns", "value", "censored", "lasted_ns")
    return dataclasses.replace(found, **{name: getattr(found, name)[kept] for name in arrays})


def _prompt(found: Series) -> np.ndarray:
    """Readings whose moment is known: a reply that was long in coming tells a pressure of any moment since the request.

    Shape (n,) of bool.
    """
    usual = float(np.median(found.lasted_ns)) if found.lasted_ns.size else 0.0
    return found.lasted_ns <= max(SLOWER * usual, LATE_S * NS)


def _since_before(run: Run, channel: str, phase: Phase, found: Series) -> Series:
    """Speeds as means since the reading before: after edges that were lost a counter tells the last tooth's alone."""
    angle = series(run, f"{channel.partition('.')[0]}.angle_rad", phase.start_s, phase.end_s)
    if not angle.value.size:
        return found
    place = np.clip(np.searchsorted(angle.time_ns, found.time_ns), 0, angle.time_ns.size - 1)
    turned = np.where(angle.time_ns[place] == found.time_ns, angle.value[place], np.nan)
    mean = np.diff(turned) / np.diff(found.time_ns) * NS * 30.0 / np.pi
    value = found.value.copy()
    other = np.isfinite(mean) & (np.abs(mean - value[1:]) > SAME * np.abs(mean))
    value[1:][other] = mean[other]
    return dataclasses.replace(found, value=value)


def _remarks(run: Run, phase: Phase, read: dict[str, Series]) -> list[str]:
    """What a person should know of a capture: where it ends early, and where its pressure is not known."""
    found = ["the run ended within this capture"] if phase.cut_short else []
    column = next((name for name in PRESSURES if name in read and read[name].value.size), None)
    if column is None:
        return found
    pressure = read[column]
    times = np.concatenate(([phase.start_s], pressure.time_ns / NS, [phase.end_s]))
    longest = int(np.argmax(np.diff(times)))
    if times[longest + 1] - times[longest] > max(GAP_S, GAP * float(np.median(np.diff(times)))):
        ends = (f"{when - phase.start_s:.2f}" for when in times[longest : longest + 2])
        found.append(f"no reading of the pressure from {' to '.join(ends)} s; the gauge was not read there")
    room = 0.0 if column.endswith("_gauge") else run.start.ambient.pressure_bar_abs
    if phase.kind == "coast-down" and room is not None and pressure.value[-1] - room > VENTED_WITHIN_BAR:
        found.append(f"ends before the line is vented: the gauge showed {pressure.value[-1]:.3f} bar last")
    return found


def _transient(name: str, phase: Phase, read: dict[str, Series], figures: Figures) -> RecordingFile:
    """Each channel at its own times: a row holds what was sampled then, and the other cells are empty."""
    times = np.unique(np.concatenate([found.time_ns for found in read.values()]))
    start_ns = round(phase.start_s * NS)
    columns = {"time_s": _column((times - start_ns) / NS)}
    for column, found in read.items():
        values = np.full(times.size, np.nan)
        censored = np.zeros(times.size, dtype=np.int8)
        rows = np.searchsorted(times, found.time_ns)
        values[rows] = np.maximum(found.value, 0.0) if column == "speed_rpm" else found.value
        censored[rows] = found.censored
        columns[column] = _column(values, censored)
    if phase.event_s is not None:
        is_open = (times >= round(phase.event_s * NS)) == (phase.kind == "spin-up")
        columns["supply_open"] = _column(is_open.astype(np.float64))
    scale = figures.sample_scale("speed_rpm" if "speed_rpm" in read else "flow_l_min")
    return RecordingFile(name, "transient", phase.start_s, scale, times.size, columns)


def _at_rest_below(file: RecordingFile) -> RecordingFile:
    """The file with a speed of 0 as a recording reads it: below what can be seen."""
    speed = file.columns.get("speed_rpm")
    if speed is None:
        return file
    censor = np.where((speed.values == 0.0) & (speed.censor == 0), -1, speed.censor)
    return dataclasses.replace(file, columns={**file.columns, "speed_rpm": _column(speed.values, censor)})


def _digest(run: Run) -> str:
    """Over the hashes of the run's files, so that a fit that goes on knows its data again."""
    digests = [sha256_of(run.folder / name) for name in HASHED if (run.folder / name).exists()]
    return hashlib.sha256("".join(digests).encode("ascii")).hexdigest()


def _counted(run: Run, channels: dict[str, str], plateaus: list[PlateauRow]) -> list[str]:
    """What there was beside checked readings, in the plateaus that were taken."""
    notes = []
    for name, channel in channels.items():
        found = [series(run, channel, plateau.start_s, plateau.end_s) for plateau in plateaus]
        unusable, unverified = sum(one.unusable for one in found), sum(one.unverified for one in found)
        if unusable or unverified:
            total = unusable + sum(one.value.size for one in found)
            words = f"of {total} readings in the plateaus {unusable} were unusable and {unverified} unverified"
            notes.append(f"{name} ({channel}): {words}")
    return notes


def _ambient(run: Run) -> Ambient:
    """The room: start and end halved, half their difference as an error when that is larger than the stated one."""
    start = _room_said(run)
    end = (run.end.ambient_end if run.end is not None else None) or AmbientRecord()
    pressure, pressure_sd = _between(start.pressure_bar_abs, end.pressure_bar_abs, start.pressure_sd_bar)
    temperature, temperature_sd = _between(start.temperature_c, end.temperature_c, start.temperature_sd_k)
    humidity, _ = _between(start.relative_humidity, end.relative_humidity, None)
    return Ambient(pressure, pressure_sd, temperature, temperature_sd, humidity)


def _room_said(run: Run) -> AmbientRecord:
    """The room at the start, as the person has put it right since."""
    corrections = [event.details for event in run.events if event.event == ROOM]
    if not corrections:
        return run.start.ambient
    said = {key: value for key, value in corrections[-1].items() if key in AmbientRecord.model_fields}
    try:
        return AmbientRecord(**(run.start.ambient.model_dump() | said))
    except ValueError:
        raise RunError(f"{run.folder}: the room in its events makes no sense; the file is damaged") from None


def _between(start: float | None, end: float | None, sd: float | None) -> tuple[float | None, float | None]:
    known = [value for value in (start, end) if value is not None]
    if not known:
        return None, None
    spread = (max(known) - min(known)) / 2.0
    return sum(known) / len(known), max(sd or 0.0, spread) or sd


def _column(values: object, censored: object = None) -> Column:
    array = np.asarray(values, dtype=np.float64)
    return Column(array, np.zeros(array.size, np.int8) if censored is None else np.asarray(censored, dtype=np.int8))
