"""Recordings that nothing can be said of: refused before any search, with the file, the row, and what to do."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from calibration.data.measurement import OBSERVED, PRESSURE_LIMITS_BAR, Rows, gather
from calibration.data.runs_in_time import lone_zeros, release, turns
from calibration.unknowns.priors import at_ambient
from configs.units import BAR
from model import geometry
from model import layout as at
from model.layout import RPM
from model.motor import Motor, read_motor
from model.solvers import steady
from rig.recording import Recording, RecordingError
from rig.recording.columns import PRESSURE, pressure_in
from rig.recording.units import UNITS, times

FULL = 0.9  # share of the swept volume that a turn takes in, measured on this motor; beside a leak up to 1.5
MOST_OFF = 3.0  # factor on flow over speed that no leak and no wrong meter makes
FEWEST_ROWS = 3
ANGLES = 361  # of one lobe
ALIKE = 1.35  # factor within which flow over speed is what a mix-up of units makes it
# What flow over speed is multiplied by where a column holds another unit than its name says; the nearest is said.
MIX_UPS = {
    UNITS[unit].factor: f"speeds in {text} under speed_rpm; {times(UNITS[unit].factor, 'them ')}"
    for unit, text in (("rad/s", "rad/s"), ("deg/s", "degrees a second"))
}
MIX_UPS |= {
    1.0 / UNITS[unit].factor: f"flows in {text} under flow_l_min; {times(UNITS[unit].factor, 'them ')}"
    for unit, text in (
        ("mL/min", "mL/min"),
        ("m3/h", "m3/h"),
        ("cfm", "cubic feet a minute"),
        ("m3/min", "m3/min"),
        ("m3/s", "m3/s"),
    )
}
MIX_UPS |= {
    60.0: "speeds in Hz (turns a second) under speed_rpm, which is to be multiplied by 60, or flows in L/h",
    1.0 / 60.0: "flows in L/s under flow_l_min, which is to be multiplied by 60, or pulses of 60 a turn for turns",
}
# Share of a run's highest speed by which it may go the wrong way: fall while the supply is open, or rise while it is
# closed. A regulator that overshoots, and a valve that is late, make 0.1 of it.
WRONG_WAY = 0.2
BY_STROKES = 0.1  # share by which two highest or two lowest readings of a rotor that goes by strokes may differ
STILL_FAST, NEARLY_AT_REST = 0.8, 0.2  # shares of a run's highest speed
SLOWEST_STOP_S = 60.0  # from the one to the other; without a flywheel this motor needs about a second
END = 3  # readings at the end of a run whose median is the speed there
LATE_S = 0.1  # by which supply_open may be late or early: so much before and after the valve is moved says nothing
MOST_STARVED = 0.5  # share of the turning rows; fewer may be misread
SHAPE_WRONG, SHAPE_RIGHT = 0.1, 0.03  # relative distances of speeds from the motor's curve, see `_shape_misfit`


def refuse_another_kind(recording: Recording) -> None:
    """Refuse the machines that are no radial piston motors: they can be diagnosed, and not fitted.

    Raises RecordingError: names the kind.
    """
    if not recording.is_of_radial_piston:
        raise RecordingError(
            f"{recording.folder}/recording.toml: an inline motor of kind {_kind_of(recording)!r} cannot be fitted yet; "
            "name a radial piston motor, or write one out"
        )


def _kind_of(recording: Recording) -> str:
    return "" if isinstance(recording.motor, str) else str(recording.motor.get("kind"))


def refuse_unusable(recording: Recording) -> None:
    """Refuse what nothing can be said of, for fit and diagnosis alike.

    `recording`: of a motor by name; another one passes.
    Raises RecordingError: file and row where there is one, what is wrong, and what to do.
    """
    if not recording.is_of_radial_piston:
        return
    _refuse_two_gauges(recording)
    motor = at_ambient(read_motor(recording.motor), recording)
    room_bar = motor.si("ambient_pressure") / BAR
    rows = gather(recording, needs_plateaus=False).steady
    _refuse_starved(recording, rows, room_bar)
    _refuse_out_of_range(recording, room_bar)
    _refuse_at_rest(recording)
    _refuse_mistaken_gauge(recording, rows, motor, room_bar)
    _refuse_mixed_units(recording, rows, motor)
    _refuse_wrong_supply(recording)


def _refuse_two_gauges(recording: Recording) -> None:
    """Refuse gauge pressures beside absolute ones: a recording's errors of the pressure are those of one instrument.

    Only a zero in gauge pressure may be beside absolute ones.
    """
    absolute, above_room = PRESSURE
    shows = [file.file for file in recording.files if file.kind != "zero" and above_room in file.columns]
    if absolute not in recording.channels or not shows:
        return
    other = next((file.file for file in recording.files if absolute in file.columns), "another file")
    raise RecordingError(
        f"{recording.folder}: {shows[0]} has {above_room}, and {other} has {absolute}: they are taken for two "
        "instruments, and a recording has one of the pressure; if it is one, write all as it shows them; if they are "
        "two, make a recording of each one's files, and name both (A B)"
    )


def _refuse_mistaken_gauge(recording: Recording, rows: Rows, motor: Motor, room_bar: float) -> None:
    """Refuse gauge pressures that are named absolute, or the reverse: the speeds tell.

    They grow with pressure as no motor's do, and as this motor's do with the other kind of pressure.
    """
    declared = rows.pressure + np.where(rows.is_gauge, room_bar, 0.0)
    other = declared + np.where(rows.is_gauge, -room_bar, room_bar)
    low, high = PRESSURE_LIMITS_BAR
    turning = rows.turning & (declared > room_bar) & (other > low) & (other < high)
    if not turning.any():
        return
    as_declared = _shape_misfit(motor, declared[turning], rows.speed[turning])
    as_other = _shape_misfit(motor, other[turning], rows.speed[turning])
    if as_declared > SHAPE_WRONG and as_other < SHAPE_RIGHT:
        i = int(np.flatnonzero(turning)[0])
        named = PRESSURE[int(rows.is_gauge[i])]
        meant = PRESSURE[not rows.is_gauge[i]]
        raise RecordingError(
            f"{recording.folder}/{rows.file[i]}: the speeds do not go with {named}: as they grow with pressure they "
            f"are {100 * as_declared:.0f} % from what a motor of any friction does, but {100 * as_other:.0f} % from it "
            f"if the pressures are {meant}; if the gauge shows {meant.rsplit('_', 1)[-1]} pressure, name the column "
            f"{meant}"
        )


def _shape_misfit(motor: Motor, pressure_bar: np.ndarray, speed_rpm: np.ndarray) -> float:
    """Relative distance of the speeds from a multiple of the default motor's, whatever its friction [-].

    f_overall scales all speeds alike, so a motor with another friction is no reason to doubt the gauge.
    """
    found = steady.steady(motor, pressure_bar * BAR).speed_rad_s[0] * RPM
    ratio = np.maximum(found, 1.0) / np.maximum(speed_rpm, 1.0)
    middle = np.median(ratio)
    # Single bad readings must not decide: the four-fifths point of the distances, not their maximum.
    return float(np.quantile(np.abs(ratio / middle - 1.0), 0.8))


def _refuse_mixed_units(recording: Recording, rows: Rows, motor: Motor) -> None:
    """Refuse flows and speeds that cannot both be in the units of their names: a turn takes in what the cylinders hold.

    That is where the plateaus' flow over speed is three times what the displacement allows, or a third of it, at the
    median.
    """
    turning = rows.turning & (rows.flow_state == OBSERVED) & (rows.flow > 0.0)
    ratios = rows.flow[turning] / rows.speed[turning]
    if ratios.size < FEWEST_ROWS:
        return
    files = dict.fromkeys(rows.file[i] for i in np.flatnonzero(turning))
    volume = swept_volume(motor.vector())
    factor = float(np.median(ratios)) / (1000.0 * volume * FULL)
    if 1.0 / MOST_OFF <= factor <= MOST_OFF:
        return
    known = min(MIX_UPS, key=lambda one: abs(np.log(factor / one)))
    like = MIX_UPS[known] if abs(np.log(factor / known)) < np.log(ALIKE) else ""
    said = f"that looks like {like}" if like else "is another quantity in one of the columns, or is it another motor?"
    raise RecordingError(
        f"{recording.folder}/{', '.join(files)}: flow over speed is {factor:.2g} times what the displacement allows "
        f"({1000.0 * volume:.3g} L a turn by the motor's geometry); {said}"
    )


def _refuse_wrong_supply(recording: Recording) -> None:
    """Refuse runs in time whose speed contradicts supply_open.

    That is where the speed falls by a fifth of its highest while the supply is said or taken to be open, or rises by as
    much while it is closed.
    """
    for file in recording.files:
        time, read = file.columns.get("time_s"), file.columns.get("speed_rpm")
        if file.kind != "transient" or time is None or read is None or not turns(recording, file):
            continue  # what did not break away has nothing to compare
        known = np.isfinite(read.values) & ~lone_zeros(read.values)
        t, speed = time.values[known], read.values[known]
        opened = np.ones(t.size, dtype=bool) if file.is_open is None else file.is_open[known]
        place = f"{recording.folder}/{file.file}"
        _hold_against_supply(place, t, speed, opened, file.is_open is not None)
        if not recording.added_inertia_kg_m2 + file.added_inertia_kg_m2:
            _refuse_slow_stop(place, t, speed, opened)


def _refuse_slow_stop(place: str, time: np.ndarray, speed: np.ndarray, opened: np.ndarray) -> None:
    """Refuse a run that slows down, with the supply closed and no flywheel, as no rotor of this motor can."""
    closed = np.flatnonzero(opened)[-1] + 1 if opened.any() else 0
    fast = np.flatnonzero(speed[closed:] > STILL_FAST * speed.max())
    slow = np.flatnonzero(speed[closed:] < NEARLY_AT_REST * speed.max())
    if not fast.size or not slow.size or slow[-1] < fast[-1]:
        return
    last, first = closed + fast[-1], closed + slow[slow > fast[-1]][0]
    if time[first] - time[last] > SLOWEST_STOP_S:
        raise RecordingError(
            f"{place}: from {speed[last]:.4g} to {speed[first]:.4g} rpm with the supply closed takes "
            f"{time[first] - time[last]:.4g} s, for which this motor needs about a second; is time_s in milliseconds? "
            "Divide it by 1000; or state the flywheel, as added_inertia_kg_m2"
        )


def _hold_against_supply(place: str, time: np.ndarray, speed: np.ndarray, opened: np.ndarray, is_said: bool) -> None:
    # A rotor that rocks to rest over a tooth makes a lone peak.
    speed = np.median(sliding_window_view(np.pad(speed, 1, mode="edge"), 3), axis=1)
    top = float(speed.max())
    edges = [0, *(np.flatnonzero(np.diff(opened.astype(int))) + 1).tolist(), time.size]
    wrong = [
        (_wrong_way(time, speed, begin, end, bool(opened[begin])) / top, begin, end)
        for begin, end in itertools.pairwise(edges)
    ]
    share, begin, end = max(wrong)
    if share <= WRONG_WAY:
        return
    says = "falls" if opened[begin] else "rises"
    by = f"the speed {says} by {100.0 * share:.0f} % of its highest"
    if not is_said:
        turning = np.flatnonzero(speed > 0.0)
        at = time[turning[max(release(time[turning], speed[turning]) - 1, 0)]]
        raise RecordingError(
            f"{place}: {by}, from about {at:.3g} s on, and the file does not say when the supply closed; add the "
            "column supply_open (1 while it is open, 0 once it is closed)"
        )
    before = float(speed[edges[edges.index(begin) - 1] : begin].max()) / top if begin else np.nan
    if (
        (before > 1.0 - WRONG_WAY) if opened[begin] else (before < WRONG_WAY)
    ):  # it ran while closed, or stood while open
        now, then, did = ("open", "closed", "ran") if opened[begin] else ("closed", "open", "stood")
        raise RecordingError(
            f"{place}: {by} while supply_open says {now}, and before that it {did} while supply_open said {then}; is "
            "supply_open inverted (1 is open)?"
        )
    if opened[begin]:
        at = time[begin + max(release(time[begin:end], speed[begin:end]) - 1, 0)]
        raise RecordingError(
            f"{place}: {by} from about {at:.3g} s on, before supply_open says that it closes at {time[end - 1]:.3g} s; "
            "correct the times of supply_open"
        )
    raise RecordingError(
        f"{place}: {by} before supply_open says that it opens at {time[end - 1]:.3g} s; correct the times of "
        "supply_open"
    )


def _wrong_way(time: np.ndarray, speed: np.ndarray, begin: int, end: int, is_open: bool) -> float:
    """How far the speed of a span falls under an open supply, or rises under a closed one [rpm].

    A slow rotor gathers speed and loses it with each stroke: a fall that it has recovered from before is none.
    """
    sure = np.ones(end - begin, dtype=bool)
    if begin:
        sure &= time[begin:end] > time[begin - 1] + LATE_S
    if end < time.size:
        sure &= time[begin:end] < time[end] - LATE_S
    part = speed[begin:end][sure]
    if part.size < END:
        return 0.0
    if not is_open:
        return float(part.max() - part[0])
    top, last = float(part[: 1 - END].max()), float(np.median(part[-END:]))
    since = part[int(np.argmax(part >= (1.0 - BY_STROKES) * top)) :]
    regained = np.maximum.accumulate(since[::-1])[::-1] - since > 0.5 * (top - since)
    fall = top - last
    return 0.0 if np.any(since[regained] <= last + BY_STROKES * fall) else fall


def swept_volume(parameters: np.ndarray) -> float:
    """What the cylinders sweep in a turn [m3]. `parameters`, shape (26,): one parameter set [SI]."""
    volumes = geometry.table(parameters, np.linspace(0.0, geometry.lobe_angle(parameters), ANGLES))["V_m3"]
    return float(np.ptp(volumes)) * float(parameters[at.N_PISTONS] * parameters[at.N_LOBES])


def _refuse_starved(recording: Recording, rows: Rows, room_bar: float) -> None:
    """Refuse absolute pressures that are not above the room's while the rotor turns: a gauge's, under a wrong name.

    That is where this is so in more than half of the plateaus at which the rotor turns.
    """
    turns = rows.turning & ~rows.is_gauge
    turning = int(turns.sum())
    starved = [
        f"{rows.file[i]}, row {rows.row[i]}, column pressure_bar_abs: '{rows.pressure[i]:g}' is not above the room's "
        f"{room_bar:.3f} bar, yet the rotor turns at {rows.speed[i]:g} rpm"
        for i in np.flatnonzero(turns & (rows.pressure <= room_bar))
    ]
    if len(starved) > MOST_STARVED * turning:
        more = f", and so in {len(starved) - 1} rows more" if len(starved) > 1 else ""
        raise RecordingError(
            f"{recording.folder}/{starved[0]}{more}; if the gauge shows gauge pressure, name the column "
            "pressure_bar_gauge"
        )


def _refuse_out_of_range(recording: Recording, room_bar: float) -> None:
    """Refuse steady rows at pressures that the air properties do not reach, be the rotor held or not."""
    low, high = PRESSURE_LIMITS_BAR
    for file in recording.files:
        name, gauge = pressure_in(file.columns)
        other = PRESSURE[not gauge]
        if file.kind != "steady" or name not in file.columns:
            continue
        column = file.columns[name]
        absolute = column.values + (room_bar if gauge else 0.0)
        outside = np.flatnonzero((column.censor == 0) & ((absolute < low) | (absolute > high)))
        if outside.size:
            i = int(outside[0])
            raise RecordingError(
                f"{recording.folder}/{file.file}: row {i + 1}: {absolute[i]:g} bar absolute is outside "
                f"{low:g}..{high:g} bar; correct the row or take it out; if the gauge shows "
                f"{other.rsplit('_', 1)[-1]} pressure, name the column {other}"
            )


def _refuse_at_rest(recording: Recording) -> None:
    """Refuse recordings in which the rotor never turns: rows in which no speed was read say nothing either way."""
    files = [file for file in recording.files if "speed_rpm" in file.columns]
    files = [file for file in files if np.isfinite(file.columns["speed_rpm"].values).any()]
    if files and not any(turns(recording, file) for file in files):
        raise RecordingError(
            f"{recording.folder}: column speed_rpm shows a rotor at rest in every row, so there is no speed to compare "
            "with the model; record plateaus at which the rotor turns, or a spin-up or coast-down"
        )
