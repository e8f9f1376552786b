"""The captures of a run as files of a recording, with the moments that are known of their readings."""

from __future__ import annotations

import dataclasses

import numpy as np

from configs import parse_toml
from rig.exchange.figures import Figures
from rig.readings import NS
from rig.recording import DOWN_TO, UP_TO, Column, RecordingFile
from rig.recording.columns import PRESSURE
from rig.runlog.phases import Phase, Series, captures, quantity_channels, series
from rig.runlog.reader import Run
from rig.sweep.judge import VENTED_WITHIN_BAR

GAP_S, GAP = 0.5, 5.0  # without a pressure in a capture, told when longer than both: seconds, usual distances
SLOWER, LATE_S = 4.0, 0.05  # times the usual exchange, and no less, from which on a reply came late
UNASKED = 2.5  # times the usual pause between two readings, after which a held value may have been shown for long
BEFORE = 4.0  # updates of a gauge before a capture, in which it has most likely shown another value
SAME = 1e-6  # share within which two ways to a speed give the same


def transients(run: Run, channels: dict[str, str], figures: Figures, notes: list[str]) -> list[RecordingFile]:
    """The captures of a run as files, each channel at its own times; what was left out is added to the notes."""
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
        for column in (one for one in PRESSURE if one in read):
            read[column], late = _of_known_moment(run, channels[column], phase, read[column])
            if late:
                notes.append(f"{name}, {column}: {late} readings left out, their replies came late")
        if "speed_rpm" in read:
            read["speed_rpm"] = _since_before(run, channels["speed_rpm"], phase, read["speed_rpm"])
        sampled = {column for column, found in read.items() if found.value.size}
        if not sampled & set(PRESSURE) or not sampled & {"speed_rpm", "flow_l_min"}:
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
    name = "" if device is None else f"instruments/{device.instrument}.toml"
    if name not in run.start.sources:
        return 0.0
    text = run.start.sources[name].text
    return float(parse_toml(text.encode(), f"{run.folder.name}: {name}").get("update_s", 0.0))


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
    column = next((name for name in PRESSURE if name in read and read[name].value.size), None)
    if column is None:
        return found
    pressure = read[column]
    gap = _gap(phase, pressure, read.get("speed_rpm"), _usual_s(run, column))
    if gap is not None:
        ends = (f"{when - phase.start_s:.2f}" for when in gap)
        found.append(f"no reading of the pressure from {' to '.join(ends)} s; the gauge was not read there")
    room = 0.0 if column.endswith("_gauge") else run.start.ambient.pressure_bar_abs
    if phase.kind == "coast-down" and room is not None and pressure.value[-1] - room > VENTED_WITHIN_BAR:
        found.append(f"ends before the line is vented: the gauge showed {pressure.value[-1]:.3f} bar last")
    return found


def _usual_s(run: Run, column: str) -> float:
    """How long a gauge that is read as its bench file says gives no new value [s]; infinite where that is not known."""
    channel = quantity_channels(run)[column]
    device = run.start.devices.get(channel.partition(".")[0])
    period_s = None if device is None else device.period_s
    return float("inf") if period_s is None else max(period_s, _update_s(run, channel))


def _gap(phase: Phase, pressure: Series, speed: Series | None, usual_s: float) -> tuple[float, float] | None:
    """The longest time without a reading of the pressure, from and to [s]; None where it takes nothing away.

    A gauge that was hardly read has long distances between all its readings: its own period says that too. However
    short it is, a gap that holds the whole change of the speed is told.
    """
    times = np.concatenate(([phase.start_s], pressure.time_ns / NS, [phase.end_s]))
    distances = np.diff(times)
    longest = int(np.argmax(distances))
    if distances[longest] > max(GAP_S, GAP * min(float(np.median(distances)), usual_s)):
        return times[longest], times[longest + 1]
    over_s = _change_over_s(phase, speed)
    if phase.event_s is None or over_s is None:
        return None
    before = int(np.searchsorted(times, phase.event_s, side="left")) - 1
    return (times[before], times[before + 1]) if before >= 0 and times[before + 1] > over_s else None


def _change_over_s(phase: Phase, speed: Series | None) -> float | None:
    """When the rotor has lost, or gained, most of its speed [s]; None where the readings do not show it."""
    if speed is None or phase.event_s is None or not speed.value.size:
        return None
    after = speed.time_ns >= round(phase.event_s * NS)
    fastest = float(np.max(speed.value))
    is_down = phase.kind == "coast-down"
    there = after & ((speed.value <= DOWN_TO * fastest) if is_down else (speed.value >= UP_TO * fastest))
    return float(speed.time_ns[there][0]) / NS if fastest > 0.0 and there.any() else None


def _transient(name: str, phase: Phase, read: dict[str, Series], figures: Figures) -> RecordingFile:
    """Each channel at its own times: a row holds what was sampled then, and the other cells are empty."""
    times = np.unique(np.concatenate([found.time_ns for found in read.values()]))
    start_ns = round(phase.start_s * NS)
    columns = {"time_s": column_of((times - start_ns) / NS)}
    for column, found in read.items():
        values = np.full(times.size, np.nan)
        censored = np.zeros(times.size, dtype=np.int8)
        rows = np.searchsorted(times, found.time_ns)
        values[rows] = np.maximum(found.value, 0.0) if column == "speed_rpm" else found.value
        censored[rows] = found.censored
        columns[column] = column_of(values, censored)
    if phase.event_s is not None:
        is_open = (times >= round(phase.event_s * NS)) == (phase.kind == "spin-up")
        columns["supply_open"] = column_of(is_open.astype(np.float64))
    scale = figures.sample_scale("speed_rpm" if "speed_rpm" in read else "flow_l_min")
    return RecordingFile(name, "transient", phase.start_s, scale, times.size, columns)


def column_of(values: object, censored: object = None) -> Column:
    """Values as a column of a recording; `censored`: -1, 0 or 1 each, all 0 where left out."""
    array = np.asarray(values, dtype=np.float64)
    return Column(array, np.zeros(array.size, np.int8) if censored is None else np.asarray(censored, dtype=np.int8))
