"""f_overall and the effects of many recordings along their dates: a table, a picture, and a sentence each."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from calibration.data.dates import in_order
from calibration.diagnosis.document import Q95
from calibration.report import along_dates
from calibration.report.along_dates import Panel, Point
from calibration.report.diagnosis.words import quantity
from calibration.report.fit.words import p_in_words
from calibration.report.units import on_an_axis
from calibration.work import many_table
from calibration.work.trend import Line, line_through
from model.effects import effects
from rig.recording.origin import parsed

CSV, PNG = "trend.csv", "trend.png"
F_OVERALL = "f_overall"
MOTOR = ("motor", "motor_sha256", "motor_serial")  # columns that tell one motor from another
ALARM_P = 0.01  # of all trends together, below which something changed
# What a slope is told per, the longest that the recordings span at least twice.
PERIODS = (
    ("a year", timedelta(days=365.25)),
    ("a month", timedelta(days=30.4375)),
    ("a day", timedelta(days=1)),
    ("an hour", timedelta(hours=1)),
    ("a minute", timedelta(minutes=1)),
)


@dataclass(frozen=True)
class Figure:
    """One quantity in one recording.

    `mean`, `sd`: [the quantity's unit]
    """

    recording: str
    taken: datetime | None
    mean: float
    sd: float


@dataclass(frozen=True)
class Trend:
    """One quantity along the dates, or along the order given where one recording has none.

    `effect`: whose size it is; empty for f_overall.
    `motor`: what the motor is called; empty where it is the only one and has no serial number.
    `per`: what the line's slope is per.
    """

    effect: str
    title: str
    unit: str
    figures: Sequence[Figure]
    line: Line | None
    per: str
    motor: str = ""

    @property
    def parameter(self) -> str:
        """Its name: f_overall, or the effect's own for its size."""
        return effects()[self.effect].amplitude.name if self.effect else F_OVERALL


def trends(rows: Sequence[Mapping[str, Any]]) -> list[Trend]:
    """Of each motor and quantity that two recordings at least tell of, f_overall first.

    `rows`: of the table of fits or of diagnoses; what is not to be relied on is left out.
    """
    found: dict[tuple[str, str], list[Figure]] = {}
    motors, units = motors_of(rows), {}
    for row in rows:
        if not is_reliable(row):
            continue
        motor = motors[str(row["recording"])]
        units[motor] = unit_of(row)
        for effect, (mean, sd) in figures_of(row).items():
            found.setdefault((motor, effect), []).append(Figure(str(row["recording"]), parsed(row["date"]), mean, sd))
    ordered = sorted(found.items(), key=lambda one: (one[0][0], one[0][1] != ""))
    return [
        _trend(motor, effect, in_order(figures, lambda one: one.taken), units[motor])
        for (motor, effect), figures in ordered
        if len(figures) > 1
    ]


def motors_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """What the motor of each recording is called, by the recording's name; of what failed it is not known.

    Motors differ by what they are, by their figures and by their serial numbers. A name says what these need to be told
    apart: nothing where there is one motor without a serial number.
    """
    named = {str(row["recording"]): [str(row.get(key) or "") for key in MOTOR] for row in rows if not row["error"]}
    kinds = dict.fromkeys((motor, figures) for motor, figures, _ in named.values())
    called: dict[str, str] = {}
    for recording, (motor, figures, serial) in named.items():
        words = [motor] if len(kinds) > 1 else ["motor"] if serial else []
        words += [f"no. {serial}"] if serial else []
        alike = [one for one in kinds if one[0] == motor]  # of one name, and with other figures
        words += [f"({alike.index((motor, figures)) + 1})"] if len(alike) > 1 else []
        called[recording] = " ".join(words)
    return called


def alarms(found: Sequence[Trend]) -> list[str]:
    """Each quantity that changed, with what it was and is, in a sentence; all trends are priced."""
    return [
        f"{one.title} changed ({p_in_words(one.line.change_p)}): {_what_it_was_and_is(one)}."
        for one in found
        if one.line is not None and one.line.change_p * len(found) < ALARM_P
    ]


def _what_it_was_and_is(trend: Trend) -> str:
    """The first and the last figure, and the farthest from the mean of all where that stands between them."""
    ordered = trend.figures
    weights = np.array([one.sd**-2.0 for one in ordered])
    mean = float(np.average([one.mean for one in ordered], weights=weights))
    farthest = max(range(len(ordered)), key=lambda i: abs(ordered[i].mean - mean) / ordered[i].sd)
    told = (
        f"{quantity(ordered[i].mean, ordered[i].sd, trend.unit, trend.parameter)} in "
        f"{ordered[i].recording.rpartition('/')[2]}"
        for i in sorted({0, farthest, len(ordered) - 1})
    )
    return ", ".join(told)


def is_reliable(row: Mapping[str, Any]) -> bool:
    """Whether the model explained a recording, so that its f_overall can be relied on."""
    return not row["error"] and row.get("model_fits") is not False and row.get("verdict") != "unresolved"


def figures_of(row: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Mean and sd of the size of each effect that is named, by its id, and of f_overall, by no id [own units]."""
    found = {}
    for key in (F_OVERALL, f"{F_OVERALL}_after"):
        if row.get(f"{key}_mean") is not None:
            found[""] = (float(row[f"{key}_mean"]), float(row[f"{key}_sd"]))
    if row.get("verdict") == "named":
        for effect in json.loads(row["diagnosis"])["effects"]:
            size = effects()[effect["id"]].amplitude.name
            if one := effect["parameters"].get(size):
                found[effect["id"]] = (float(one["mean"]), float(one["sd"]))
    return found


def unit_of(row: Mapping[str, Any]) -> str:
    """The unit of a recording's f_overall: of a slide another than of what turns."""
    return str(row.get("f_overall_unit") or "N m s")


def sentence(trend: Trend) -> str:
    """The slope with its uncertainty, and what the scatter about the line says."""
    n = len(trend.figures)
    dates = sorted(taken for one in trend.figures if (taken := one.taken) is not None)
    when = f" from {dates[0].date()} to {dates[-1].date()}" if len(dates) == n else ", in the order given"
    if trend.line is None:
        return f"{trend.title}: {n} recordings{when}; no line can be drawn through them."
    line = trend.line
    slope = quantity(line.slope, line.slope_sd, trend.unit, trend.parameter)
    far = abs(line.slope) / line.slope_sd
    level = float(np.average(line.value))
    share = f" ({100.0 * line.slope / level:+.1f} %)".replace("-", "−") if level and not trend.effect else ""
    said = (
        f"{trend.title}: {slope}{share} {trend.per}, over {n} recordings{when}; {far:.1f} standard deviations from 0."
    )
    if n == 2:
        return said
    p = p_in_words(line.scatter_p)
    if line.is_scattered:
        return (
            f"{said} The scatter about the line is {line.scatter:.1f} times what the uncertainties say ({p}); that of "
            "the slope has grown with it."
        )
    return f"{said} The scatter about the line is no larger than the uncertainties say ({p})."


def table(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """A row a recording: date, f_overall, and the size of each effect that is named, as CSV.

    They stand along the dates, in the order given where one has none; what failed stands last.
    """
    rows = [*in_order([row for row in rows if not row["error"]], _taken), *(row for row in rows if row["error"])]
    told = [figures_of(row) for row in rows]
    named = dict.fromkeys(effect for one in told for effect in one if effect)
    names = {"": F_OVERALL} | {effect: f"{effect}.{effects()[effect].amplitude.name}" for effect in named}
    of = ("date", "motor_serial", "motor")
    columns = dict.fromkeys(("recording", *of), many_table.TEXT) | {"reliable": many_table.FLAG}
    for name in names.values():
        columns |= {f"{name}_{key}": many_table.NUMBER for key in ("mean", "sd")} | {f"{name}_unit": many_table.TEXT}
    made = []
    for row, one in zip(rows, told, strict=True):
        cells = {"recording": str(row["recording"]), "reliable": is_reliable(row)} | {key: row.get(key) for key in of}
        for effect, (mean, sd) in one.items():
            name, unit = names[effect], effects()[effect].amplitude.unit if effect else unit_of(row)
            cells |= {f"{name}_mean": mean, f"{name}_sd": sd, f"{name}_unit": unit}
        made.append(cells)
    return many_table.as_csv(made, columns)


def _taken(row: Mapping[str, Any]) -> datetime | None:
    return parsed(row["date"])


def picture(found: Sequence[Trend]) -> bytes:
    """Each quantity along the dates with its line, as PNG."""
    return along_dates.picture([_panel(one) for one in found])


def _trend(motor: str, effect: str, figures: Sequence[Figure], friction_unit: str) -> Trend:
    title = f"{effects()[effect].title} ({effect})" if effect else F_OVERALL
    title += f" of {motor}" if motor else ""
    unit = effects()[effect].amplitude.unit if effect else friction_unit
    at, per = _places(figures)
    line = line_through(at, [one.mean for one in figures], [one.sd for one in figures])
    return Trend(effect, title, unit, figures, line, per, motor)


def _places(figures: Sequence[Figure]) -> tuple[list[float], str]:
    """Where recordings stand along the dates, and in which unit; along the order given where one has no date."""
    dates = [taken for one in figures if (taken := one.taken) is not None]
    if len(dates) < len(figures):
        return [float(i) for i in range(len(figures))], "a recording"
    first, span = min(dates), max(dates) - min(dates)
    per, unit = next((one for one in PERIODS if span >= 2 * one[1]), PERIODS[-1])
    return [(taken - first) / unit for taken in dates], per


def _panel(trend: Trend) -> Panel:
    factor, unit = on_an_axis(trend.unit, trend.parameter)
    points = [
        Point(
            one.recording.rpartition("/")[2], one.taken, *(factor * (one.mean + k * one.sd) for k in (0.0, -Q95, Q95))
        )
        for one in trend.figures
    ]
    line = None if trend.line is None else (factor * trend.line.value, factor * trend.line.value_sd)
    quantity = effects()[trend.effect].amplitude.text if trend.effect else F_OVERALL
    return Panel(trend.title, quantity, unit, points, line)
