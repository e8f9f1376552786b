"""Everything that is shown of a run, as plain data: the page and the terminal draw it and know nothing else."""

from __future__ import annotations

import statistics
from collections.abc import Collection, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from rig.readings import Quality
from rig.recording.columns import PRESSURE
from rig.runlog.plateaus import PlateauRow
from rig.runlog.reader import BEING_WRITTEN
from rig.runlog.schema import ADDED, CAPTURE, COURSE, EXPECTED, EndRecord, EventLine, ended
from rig.runlog.tail import CHECK, STATE, Shown, Tail
from spinbench.console.words import after_the_end, badge_of, guidance_for, is_imported, state_word

CHECKED = ("sweep", "manual")  # kinds of runs that are held against the model while they go on
CHARTED = ("pressure", "flow", "speed")
SHOWN_EVENTS, SHOWN_ALARMS, SHOWN_BINS = 60, 50, 400
STALE_S = 2.0  # of the wall: an older reading of a run that is being written is marked
TEXT = 300  # characters of an event
QUIET_EVENTS = {CHECK, COURSE, EXPECTED, "plateau", "statistics"}
UNITS = {"_bar_abs": "bar abs", "_bar_s": "bar/s", "_s": "s", "_rpm": "rpm"}  # of a bench file's keys
DIGITS = {"bar": 3, "L/min": 1, "rpm": 1, "degC": 1}


def facts(
    tail: Tail,
    now_s: float,
    span_s: float,
    acknowledged: Collection[int] = (),
    silent_s: float = 0.0,
    bench: str = "",
) -> dict[str, Any]:
    """A run as it stands.

    `span_s`: what the charts show [s]; 0 for the whole run.
    `acknowledged`: numbers of alarms that a person has seen.
    `silent_s`: how long nothing new has come, of the wall [s].
    `bench`: its bench as it is typed; the bench's name where empty.
    """
    from_s = max(now_s - span_s, 0.0) if span_s else 0.0
    return {
        "run": _run(tail),
        "state": _state(tail, now_s),
        "steps": _steps(tail, now_s),
        "figures": [_figure(tail, role, now_s, silent_s) for role in _roles(tail)],
        "charts": {"from_s": round(from_s, 2), "until_s": round(max(now_s, 1.0), 2), "series": _series(tail, from_s)},
        "picture": _picture(tail),
        "check": _check(tail),
        "events": [_event(event) for event in tail.events if event.event not in QUIET_EVENTS][-SHOWN_EVENTS:],
        "alarms": _alarms(tail, acknowledged, bench),
    }


def _roles(tail: Tail) -> list[str]:
    return [role for role in (*CHARTED, "temperature") if tail.start.roles.get(role)]


def _run(tail: Tail) -> dict[str, Any]:
    start, end = tail.start, tail.end
    keys = ("dwell_s", "window_s", "settle_timeout_s", "ramp_bar_s", "order", "levels_bar_abs")
    motor = start.motor if isinstance(start.motor, str) else str(start.motor.get("kind", "given in full"))
    setting = {
        "bench": f"{start.bench}: {start.title}",
        "motor": f"{motor} {start.motor_serial}".strip(),
        "operator": start.operator,
        "note": start.note,
        "lubrication": start.lubrication,
        "started (UTC)": start.utc_start[:19].replace("T", " "),
        "room": _room(start.ambient.model_dump()),
    }
    setting |= {key: start.sweep[key] for key in keys if key in start.sweep}
    setting |= {key: value for key, value in start.safety.items() if value}
    return {
        "name": tail.folder.name,
        "kind": start.kind,
        "simulated": start.simulated,
        "rate": start.clock.rate,
        "live": tail.state == BEING_WRITTEN,
        "past": _past(tail),
        "outcome": None if end is None else end.outcome,
        "stopped_by": None if end is None else end.stopped_by,
        "vented": None if end is None else end.vented,
        "setting": {_plain(key): _text(value, key) for key, value in setting.items() if value},
    }


def _plain(key: str) -> str:
    """A key without the unit at its end, which stands behind its value."""
    return key.removesuffix(_ending(key)).replace("_", " ")


def _text(value: Any, key: str) -> str:
    several = value if isinstance(value, list) else [value]
    shown = ", ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in several)
    return f"{shown} {UNITS.get(_ending(key), '')}".strip()


def _ending(key: str) -> str:
    return next((ending for ending in UNITS if key.endswith(ending)), "")


def _past(tail: Tail) -> str:
    """What a reading is of a run that is not being written; empty of one that is."""
    if tail.state == BEING_WRITTEN:
        return ""
    if is_imported(tail.start):
        return "last reading of an imported file"
    ended = "" if tail.end is None else tail.end.utc_end[:16].replace("T", " ")
    return f"last reading of a run that ended{f' {ended} UTC' if ended else ''}"


def _room(ambient: Mapping[str, Any]) -> str:
    units = {"pressure_bar_abs": "bar abs", "temperature_c": "°C"}
    told = [f"{ambient[key]:g} {unit}" for key, unit in units.items() if ambient.get(key) is not None]
    humidity = ambient.get("relative_humidity")
    return ", ".join([*told, *([] if humidity is None else [f"relative humidity {humidity:.0%}"])])


def _state(tail: Tail, now_s: float) -> dict[str, Any]:
    badge = badge_of(tail, now_s)
    still = None if badge.still_s is None else round(badge.still_s, 1)
    return asdict(badge) | {"still_s": still, "at_s": round(now_s, 1)}


def _steps(tail: Tail, now_s: float) -> dict[str, Any]:
    """The course, each step done, running, to come or left out, and what was added to it; how long still [s]."""
    course = tail.details(COURSE)
    wanted: list[tuple[Any, ...]] = [tuple(step) for step in course.get("steps", [])]
    taken = [(row.level_bar_abs, row.direction, row.repeat) for row in tail.plateaus]
    gone = {tuple(one) for event in tail.alarms for one in event.details.get("left_out", []) if isinstance(one, list)}
    steps, is_next = [], tail.state == BEING_WRITTEN and tail.details(STATE).get("state") != "capture"
    for step in _with_added(wanted, taken, _added_now(tail)):
        status = "done" if step in taken else "left out" if step in gone else ""
        if not status and is_next:
            status, is_next = "running", False
        level, direction, _ = step
        steps.append(
            {"level": level, "direction": direction, "status": status or "to come", "added": step not in wanted}
        )
    left = sum(step["status"] in ("running", "to come") for step in steps)
    lengths = [b.end_s - a.end_s for a, b in zip(tail.plateaus[:-1], tail.plateaus[1:], strict=True)]
    each = statistics.median(lengths) if lengths else None
    still = None
    if each is not None and left and tail.state == BEING_WRITTEN:
        still = max(each * left - (now_s - tail.plateaus[-1].end_s), 0.0)
    made = {event.details.get("capture") for event in tail.events if event.event == CAPTURE}
    captures = [
        {"kind": kind, "level": level, "status": "done" if kind in made else "to come"}
        for kind, level in course.get("captures", [])
    ]
    return {"steps": steps, "captures": captures, "still_s": None if still is None else round(still)}


def _added_now(tail: Tail) -> float | None:
    """The level that is gone to now, where it is none of the course's [bar abs]."""
    ways = ("ramp", "level")
    last = next((one for one in reversed(tail.events) if one.event == STATE and one.details.get("state") in ways), None)
    if last is None or not last.details.get(ADDED) or any(row.end_s > last.time_s for row in tail.plateaus):
        return None
    level = last.details.get("target_bar_abs", last.details.get("level_bar_abs"))
    return float(level) if isinstance(level, int | float) else None


def _with_added(
    wanted: list[tuple[Any, ...]], taken: list[tuple[Any, ...]], now_bar: float | None
) -> list[tuple[Any, ...]]:
    """The course with each level that was added where it was taken, and that which is gone to now."""
    steps = list(wanted)
    for i, step in enumerate(taken):
        if step not in wanted:
            before = next((one for one in steps if one in taken[i + 1 :] or one not in taken), None)
            steps.insert(len(steps) if before is None else steps.index(before), step)
    if now_bar is not None:
        at = next((i for i, one in enumerate(steps) if one not in taken), len(steps))
        steps.insert(at, (now_bar, "up", 1))
    return steps


def _figure(tail: Tail, role: str, now_s: float, silent_s: float) -> dict[str, Any]:
    shown = tail.newest.get(role)
    if shown is None:
        return {"role": role, "text": "–", "unit": "", "mark": "none", "quality": "no reading yet"}
    age_s = max((now_s - shown.time_s) / tail.start.clock.rate, silent_s)
    mark, words = _quality(shown)
    if past := _past(tail):
        mark, words = "past", past
    elif shown.quality == Quality.MANUAL:
        words = f"typed {age_s:.0f} s ago" if shown.usable else "not read"
        mark = mark if shown.usable else "none"
    elif age_s > STALE_S:
        mark, words = "old", f"old: {age_s:.0f} s"
    digits = DIGITS.get(shown.unit.split()[0] if shown.unit else "", 2)
    sign = {-1: "<" if shown.value else "", 1: ">"}.get(shown.censored, "")
    text = "–" if shown.value is None else f"{sign}{shown.value:.{digits}f}"
    return {"role": role, "text": text, "unit": _unit(role, shown), "mark": mark, "quality": words}


def readings(tail: Tail) -> dict[str, dict[str, Any]]:
    """The newest reading of each role: value, unit, censoring, quality and time on the bench's clock [s]."""
    return {
        role: {
            "value": shown.value,
            "unit": _unit(role, shown),
            "censored": shown.censored,
            "quality": str(shown.quality),
            "time_s": round(shown.time_s, 3),
        }
        for role, shown in tail.newest.items()
    }


def _unit(role: str, shown: Shown) -> str:
    if role == "pressure":
        return "bar gauge" if shown.channel.endswith("_gauge") else "bar abs"
    return "°C" if shown.unit == "degC" else shown.unit


def _quality(shown: Shown) -> tuple[str, str]:
    """A mark, which the page draws, and its words."""
    if shown.value is None or not shown.usable:
        return "bad", "beyond the scale" if shown.quality == Quality.OVER_RANGE else f"no reading: {shown.quality}"
    if shown.censored:
        return "unsure", "at rest, or too slow to see" if shown.value == 0.0 else "beyond the scale"
    return ("unsure", "unverified") if shown.quality == Quality.UNVERIFIED else ("good", shown.quality)


def _series(tail: Tail, from_s: float) -> dict[str, Any]:
    safety, room = tail.start.safety, tail.start.ambient.pressure_bar_abs or 0.0
    is_gauge = str(tail.start.roles.get("pressure")).endswith("_gauge")
    limits = {"speed": safety.get("highest_speed_rpm"), "pressure": safety.get("highest_pressure_bar_abs")}
    if is_gauge and limits["pressure"] is not None:
        limits["pressure"] -= room
    series: dict[str, dict[str, Any]] = {}
    for role in CHARTED:
        shown = tail.newest.get(role)
        if shown is None:
            continue
        bins = tail.bins[role].last(from_s, tail.now_s, SHOWN_BINS)
        series[role] = {
            "unit": _unit(role, shown),
            "limit": limits.get(role),
            "bins": [[round(t, 2), round(low, 4), round(high, 4)] for t, low, high in bins],
        }
    if series.keys() >= {"pressure", "speed"}:
        band = tail.details(EXPECTED).get("band", [])
        series["speed"]["band"] = _speeds_expected(band, series["pressure"]["bins"], room if is_gauge else 0.0)
    return series


def _speeds_expected(band: list[Any], pressures: list[list[float]], added_bar: float) -> list[list[float]]:
    """The speeds that the guard holds for possible at the pressures of a chart: when [s], lowest and highest [rpm].

    `band`: pressure [bar abs], and the lowest, the middle and the highest speed there [rpm].
    `added_bar`: from the chart's pressure to absolute [bar].
    """
    if not band or not pressures:
        return []
    levels, lowest, _, highest = np.array(band, dtype=float).T
    when, low, high = np.array(pressures).T
    bar = 0.5 * (low + high) + added_bar
    found = np.column_stack([when, *(np.interp(bar, levels, one).round(1) for one in (lowest, highest))])
    told: list[list[float]] = found[(levels[0] <= bar) & (bar <= levels[-1])].tolist()
    return told


def point_of(row: PlateauRow, room_bar: float) -> list[Any] | None:
    """A plateau in the picture: pressure [bar abs], speed [rpm] and its error, whether it had settled, direction."""
    speed = row.means.get("speed_rpm")
    pressure = next((row.means[name] for name in PRESSURE if name in row.means), None)
    if speed is None or pressure is None:
        return None
    bar = pressure.mean + (0.0 if PRESSURE[0] in row.means else room_bar)
    return [round(bar, 4), round(speed.mean, 2), round(speed.se or 0.0, 2), row.settled, row.direction]


def _picture(tail: Tail) -> dict[str, Any]:
    room = tail.start.ambient.pressure_bar_abs or 0.0
    expected = tail.details(EXPECTED)
    turning = expected.get("turning", expected.get("plateaus", 0))  # older runs count all
    points = [point_of(row, room) for row in tail.plateaus]
    return {
        "points": [point for point in points if point is not None],
        "band": expected.get("band", []),
        "f_overall": expected.get("f_overall") if turning else None,
        "turning": turning,
        "limit_rpm": tail.start.safety.get("highest_speed_rpm"),
    }


def _check(tail: Tail) -> dict[str, Any]:
    """The lamp: whether the model explains the plateaus so far."""
    found = tail.details(CHECK)
    if not found and (tail.start.kind not in CHECKED or is_imported(tail.start)):
        return {"lamp": "none", "text": "Only a sweep is checked while it runs. spinbench diagnose looks at any run."}
    if not found and tail.state != BEING_WRITTEN:
        return {"lamp": "none", "text": "The sweep ended without a check. spinbench diagnose makes one now."}
    if not found:
        return {"lamp": "waits", "text": "The model is checked from the sixth plateau on."}
    text = str(found.get("text", ""))[:600]
    if found.get("p_value") is None:
        return {"lamp": "waits", "text": text}
    return {"lamp": "differs" if found.get("differs") else "fits", "text": text}


def _event(event: EventLine) -> dict[str, Any]:
    return {"n": event.n, "at_s": round(event.time_s, 1), "kind": event.event, "text": said(event)}


def said(event: EventLine) -> str:
    """What an event says, in a line."""
    if "text" in event.details:
        return str(event.details["text"])[:TEXT]
    parts = []
    for key, value in event.details.items():
        if isinstance(value, str | int | float):
            words = f"{value:.6g}" if isinstance(value, float) else str(value)
            words = state_word(event.details) if event.event == key == STATE else words
            words = {True: "yes", False: "no"}.get(value, words) if isinstance(value, bool) else words
            shown = f"{_plain(key)} {_text(words, key)}"
            parts.append(words if key == event.event else shown)
    return ", ".join(parts)[:TEXT]


def _told_before(end: EndRecord) -> tuple[str, ...]:
    """What a sweep says when it begins to vent; in older runs by the file's word."""
    return ended(end.outcome, end.stopped_by, end.reason)[:TEXT], f"{end.outcome}: {end.reason}"[:TEXT]


def _alarms(tail: Tail, acknowledged: Collection[int], bench: str) -> list[dict[str, Any]]:
    """Newest first; the end of a run that did not finish is number 0, or that of the warning which told of it first."""
    alarms = [
        {"n": event.n, "at_s": round(event.time_s, 1), "text": said(event), "guidance": guidance_for(event.event, tail)}
        for event in list(tail.alarms)[-SHOWN_ALARMS:]
    ]
    end = after_the_end(tail, bench)
    if end is not None:
        told = [one for one in alarms if tail.end and one["text"] in _told_before(tail.end)]
        alarms = [one for one in alarms if one not in told]
        is_new = not told or (tail.end is not None and tail.end.vented is False)
        alarms.append(
            {"n": 0 if is_new else told[-1]["n"], "at_s": round(tail.now_s, 1), "text": end[0], "guidance": end[1]}
        )
    return [alarm | {"acknowledged": alarm["n"] in acknowledged} for alarm in reversed(alarms)]
