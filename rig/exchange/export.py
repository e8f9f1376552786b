"""A run as a recording/1 folder: plateaus, zero phases and captures, with the figures of the instruments.

Only usable readings go in; what was left out is counted in notes.txt beside the data.
"""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.exchange.captures import column_of, transients
from rig.exchange.figures import Figures
from rig.readings import NS
from rig.recording import Ambient, Recording, RecordingFile, SupplyFigures, write_recording
from rig.recording.columns import PRESSURE
from rig.recording.origin import of_run
from rig.recording.read import what_lacks
from rig.recording.schema import MOST_TEXT, SupplyTable
from rig.runlog.folder import HASHED, EmptyRunError, RunError, sha256_of
from rig.runlog.phases import DERIVED_DEVICE, Phase, corrections, quantity_channels, room_said, series, zeros
from rig.runlog.plateaus import Mean, PlateauRow
from rig.runlog.reader import BEING_WRITTEN, Run
from rig.runlog.schema import AmbientRecord

NOTES = "notes.txt"
STANDS = 3.0  # standard errors of a mean speed that is none


@dataclass(frozen=True)
class Exported:
    """What an export made. `notes`: what was left out, and what was assumed."""

    recording: Recording
    notes: list[str]


def export_recording(run: Run, folder: Path, unsettled: bool = False) -> Exported:
    """Write a run as a recording/1 folder.

    Raises RunError when the run is being written, or (`EmptyRunError`) holds nothing that a recording could;
    RecordingError when the folder cannot be made.
    """
    exported = recording_of(run, unsettled)
    Path(folder).parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join([f"exported from the run {run.name}", *exported.notes]) + "\n"
    write_recording(exported.recording, Path(folder), {NOTES: text})
    return exported


def recording_of(run: Run, unsettled: bool = False) -> Exported:
    """A run as a recording, not written anywhere: what `fit` and `diagnose` take of a run folder.

    Raises RunError when the run is being written, or (`EmptyRunError`) holds nothing that a recording could.
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
        _at_rest_below(file)
        for file in (
            _steady(plateaus, figures, notes),
            _zero(run, channels, zero_phases, figures, notes),
            *transients(run, channels, figures, notes),
        )
        if file is not None
    ]
    notes += _counted(run, channels, plateaus) + _of_another_room(run, channels)
    if not files:
        raise EmptyRunError(
            f"{run.folder}: nothing to export: {len(run.plateau_rows)} plateaus written, of which {len(plateaus)} can "
            f"be used, and no zero phase or capture with readings; {'; '.join(notes[1:]) or 'the run ended too early'}"
        )
    columns = {name for file in files for name in file.columns}
    ambient = _ambient(run)
    used = {name: figures.channel(name) for name in channels if name in columns}
    supply = {key: getattr(run.start.supply, key) for key in SupplyTable.model_fields}
    recording = Recording(
        folder=run.folder,
        motor=run.start.motor,
        ambient=ambient,
        channels=used,
        files=tuple(files),
        sha256=_digest(run),
        supply=SupplyFigures(**SupplyTable(**supply).model_dump()),
        origin=_origin(run),
        added_inertia_kg_m2=run.start.added_inertia_kg_m2,
        warnings=tuple(what_lacks(used, ambient, files)),
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
        "oil": _lubrication(run),
        "note": f"{note}{'; ' * bool(note)}{of_run(run.name, start.bench, start.seal)}",
        "parent": start.goes_on_from,
    }
    return {key: text[:MOST_TEXT] for key, text in said.items() if text}


def _lubrication(run: Run) -> str:
    """As the person has put it right since."""
    said = [text for event in corrections(run) if isinstance(text := event.details.get("lubrication"), str)]
    return said[-1] if said else run.start.lubrication


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
        if not found & set(PRESSURE) or not found & {"speed_rpm", "flow_l_min"}:
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
    columns = {"time_s": column_of([(plateau.start_s + plateau.end_s) / 2.0 for plateau in plateaus])}
    if len(set(columns["time_s"].values.tolist())) < len(plateaus):
        notes.append("sweep.csv: without times, some plateaus have the same")
        del columns["time_s"]
    for name in figures.channels:
        means = [plateau.means.get(name) for plateau in plateaus]
        if any(mean is not None for mean in means):
            values = [np.nan if mean is None else mean.mean for mean in means]
            columns[name] = column_of(values, [0 if mean is None else mean.censored for mean in means])
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
        name: column_of([value for value, _ in found], [censored for _, censored in found])
        for name, found in cells.items()
        if any(not np.isnan(value) for value, _ in found)
    }
    if not columns:
        notes += [f"{len(phases)} zero phases without a usable reading"] * bool(phases)
        return None
    times = [(phase.start_s + phase.end_s) / 2.0 for phase in phases]
    if len(set(times)) == len(times):
        columns = {"time_s": column_of(times)} | columns
    return RecordingFile("zero.csv", "zero", 0.0, figures.scale_of(errors), len(phases), columns)


def _at_rest_below(file: RecordingFile) -> RecordingFile:
    """The file with a speed of 0 as a recording reads it: below what can be seen."""
    speed = file.columns.get("speed_rpm")
    if speed is None:
        return file
    censor = np.where((speed.values == 0.0) & (speed.censor == 0), -1, speed.censor)
    return dataclasses.replace(file, columns={**file.columns, "speed_rpm": column_of(speed.values, censor)})


def _digest(run: Run) -> str:
    """Over the hashes of the run's files, so that a fit that goes on knows its data again."""
    digests = [sha256_of(run.folder / name) for name in HASHED if (run.folder / name).exists()]
    return hashlib.sha256("".join(digests).encode("ascii")).hexdigest()


def _counted(run: Run, channels: dict[str, str], plateaus: list[PlateauRow]) -> list[str]:
    """What there was beside checked readings, in the plateaus that were taken."""
    notes = []
    spans = dict.fromkeys((plateau.start_s, plateau.end_s) for plateau in plateaus)  # without times all have one
    for name, channel in channels.items():
        found = [series(run, channel, *span) for span in spans]
        unusable, unverified = sum(one.unusable for one in found), sum(one.unverified for one in found)
        if unusable or unverified:
            total = unusable + sum(one.value.size for one in found)
            counts = ((unusable, "unusable"), (unverified, "unverified"))
            words = " and ".join(f"{count} {what}" for count, what in counts if count)
            notes.append(f"{name} ({channel}): of {total} readings in the plateaus, {words}")
    return notes


def _of_another_room(run: Run, channels: dict[str, str]) -> list[str]:
    """That flows were brought to the inlet's state with what was first told of the room."""
    if not corrections(run) or not channels.get("flow_l_min", "").startswith(f"{DERIVED_DEVICE}."):
        return []
    first, last = run.start.ambient, room_said(run)
    if (first.pressure_bar_abs, first.temperature_c) == (last.pressure_bar_abs, last.temperature_c):
        return []
    return [
        f"flow_l_min: before {corrections(run)[-1].time_s:.1f} s it was brought to the inlet's state with what was "
        "told of the room by then; it was put right since"
    ]


def _ambient(run: Run) -> Ambient:
    """The room: start and end halved, half their difference as an error when that is larger than the stated one."""
    start = room_said(run)
    end = (run.end.ambient_end if run.end is not None else None) or AmbientRecord()
    pressure, pressure_sd = _between(start.pressure_bar_abs, end.pressure_bar_abs, start.pressure_sd_bar)
    temperature, temperature_sd = _between(start.temperature_c, end.temperature_c, start.temperature_sd_k)
    humidity, _ = _between(start.relative_humidity, end.relative_humidity, None)
    return Ambient(pressure, pressure_sd, temperature, temperature_sd, humidity)


def _between(start: float | None, end: float | None, sd: float | None) -> tuple[float | None, float | None]:
    known = [value for value in (start, end) if value is not None]
    if not known:
        return None, None
    spread = (max(known) - min(known)) / 2.0
    return sum(known) / len(known), max(sd or 0.0, spread) or sd
