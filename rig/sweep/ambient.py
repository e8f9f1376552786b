"""The room at the start and the end of a run, and what the motor has been through: from the bench file, the command
line, or the person.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from configs.units import IN_BAR, as_in_another_unit
from rig.bench.bench import Bench
from rig.runlog import AmbientRecord

Ask = Callable[[str], str]  # from a prompt to what was typed; EOFError when nobody is there
MOST_TEXT = 200
MOST_TRIES = 5
BACK = "back"  # typed at a question: the one before once more


class AmbientError(ValueError):
    """Something of the room is not known, and nobody is there to be asked. The text names the options."""


@dataclass(frozen=True)
class Given:
    """What the command line says; None where it says nothing.

    `pressure_bar_abs`, `temperature_c`, `relative_humidity`: the room [bar, degree Celsius, 0 to 1].
    `minutes_running`: how long the motor has run today before this [min].
    """

    pressure_bar_abs: float | None = None
    temperature_c: float | None = None
    relative_humidity: float | None = None
    lubrication: str | None = None
    minutes_running: float | None = None


@dataclass(frozen=True)
class Ambient:
    """The room, and what the motor has been through.

    `pressure_bar_abs`, `pressure_sd_bar`, `temperature_c`, `relative_humidity`: the room [bar, bar, degree Celsius, 0
        to 1].
    `minutes_running`: how long the motor has run before [min].
    """

    pressure_bar_abs: float
    pressure_sd_bar: float
    temperature_c: float
    relative_humidity: float
    lubrication: str
    minutes_running: float
    sources: dict[str, str]

    def record(self) -> AmbientRecord:
        """As the run log keeps it."""
        return AmbientRecord(**{name: getattr(self, name) for name in (*ROOM_COLUMNS, "pressure_sd_bar")})

    def told(self) -> dict[str, float | str]:
        """What a person has told of it, as the log keeps it."""
        return {name: getattr(self, name) for name in (*ROOM_COLUMNS, "minutes_running", "lubrication")}

    def words(self) -> str:
        """For people."""
        figures = (f"{getattr(self, name) / figure.factor:.6g} {figure.unit}" for name, figure in ROOM_FIGURES.items())
        return f"{', '.join(figures)} running, lubrication {self.lubrication}"


@dataclass(frozen=True)
class _Figure:
    """A number that may be asked for: its prompt, bounds, and factor from what is typed.

    `others`: units that may be typed behind the number, with their factors.
    """

    prompt: str
    low: float
    high: float
    unit: str
    factor: float = 1.0
    hint: str = ""
    others: Mapping[str, float] = field(default_factory=dict)


ROOM_FIGURES = {
    "pressure_bar_abs": _Figure(
        "Ambient pressure [mbar; or with the unit behind it: 101.3 kPa], at this height and not reduced to sea level",
        500.0,
        1200.0,
        "mbar",
        1e-3,
        "; 1013 is usual at sea level, about 12 less for each 100 m",
        IN_BAR,
    ),
    "temperature_c": _Figure("Room temperature [degC]", -20.0, 60.0, "degC"),
    "relative_humidity": _Figure("Relative humidity [%]", 0.0, 100.0, "%", 1e-2),
    "minutes_running": _Figure("Minutes that the motor has run today", 0.0, 1440.0, "min"),
}
OPTIONS = {one.name: f"--{one.name.replace('_', '-')}" for one in fields(Given)}
OPTIONS |= {"pressure_bar_abs": "--ambient-pressure-bar-abs", "temperature_c": "--ambient-temperature-c"}
ROOM_COLUMNS = ("pressure_bar_abs", "temperature_c", "relative_humidity")


def at_start(bench: Bench, given: Given | None = None, ask: Ask | None = None) -> Ambient:
    """The room at the start of a run: options before the bench file, and the person for what neither says.

    `ask`: puts a prompt and returns what was typed; None when nobody is there.
    Raises AmbientError when something is missing and nobody is there, or an option is implausible.
    """
    given = given or Given()
    known, sources = known_of(bench, given)
    missing = [one.name for one in fields(Given) if known.get(one.name) is None]
    if missing and ask is None:
        wanted = ", ".join(OPTIONS[name] for name in missing)
        raise AmbientError(
            f"{bench.name}: the room is not known and nobody can be asked; give {wanted}, or put the room's figures in "
            "[ambient] and lubrication in the bench file"
        )
    known |= _all_asked(missing, ask, {})
    sources |= dict.fromkeys(missing, "asked")
    return Ambient(pressure_sd_bar=bench.file.ambient.pressure_sd_bar, sources=sources, **known)


def again(start: Ambient, ask: Ask) -> Ambient:
    """The room asked for once more, to put an answer right; an empty answer keeps what was said.

    Raises AmbientError when nobody answers usably.
    """
    return replace(start, **_all_asked(list(start.told()), ask, start.told(), "said before"))


def at_end(start: Ambient, minutes: float, ask: Ask | None = None) -> Ambient:
    """The room at the end: what was asked at the start is asked again; an empty answer keeps it."""
    end = replace(start, minutes_running=start.minutes_running + minutes)
    if ask is None:
        return end
    names = [name for name in ROOM_COLUMNS if start.sources.get(name) == "asked"]
    return replace(end, **_all_asked(names, ask, start.told()))


def known_of(bench: Bench, given: Given) -> tuple[dict[str, Any], dict[str, str]]:
    """What is known of the room without asking, and where it comes from; options go before the bench file.

    Raises AmbientError: an option is implausible.
    """
    known: dict[str, Any] = {}
    sources: dict[str, str] = {}
    of_file = {name: getattr(bench.file.ambient, name) for name in ROOM_COLUMNS}
    of_file["lubrication"] = bench.file.lubrication or None
    if bench.file.virtual is not None:
        of_file |= {"minutes_running": 0.0, "lubrication": bench.file.lubrication}
    implausible = [_implausible(one.name, getattr(given, one.name)) for one in fields(Given)]
    if any(implausible):
        raise AmbientError("\n".join(filter(None, implausible)))
    for one in fields(Given):
        name, option = one.name, getattr(given, one.name)
        if option is not None:
            known[name] = float(option) if name in ROOM_FIGURES else str(option)[:MOST_TEXT]
            sources[name] = "option"
        elif of_file.get(name) is not None:
            known[name], sources[name] = of_file[name], "bench file"
    return known, sources


def _implausible(name: str, option: Any) -> str:
    """What is wrong with an option; empty when it is plausible, or not given."""
    figure = ROOM_FIGURES.get(name)
    if figure is None or option is None or figure.low <= option / figure.factor <= figure.high:
        return ""
    low, high = figure.low * figure.factor, figure.high * figure.factor
    meant = as_in_another_unit(name, option, high)
    return f"{OPTIONS[name]} {option:g}: expected {low:g} to {high:g}{meant and f'; {meant}'}"


def _all_asked(
    names: Sequence[str], ask: Ask | None, defaults: Mapping[str, float | str], when: str = "at the start"
) -> dict[str, Any]:
    """The answers to questions, one after the other; `BACK` puts the one before once more."""
    answers: dict[str, Any] = {}
    at = 0
    while at < len(names):
        hint = f"; {BACK} for the question before" if at == 1 else ""  # told once
        try:
            answers[names[at]] = _asked(names[at], ask, defaults.get(names[at]), when, hint)
        except _BackError:
            at = max(at - 1, 0)
        else:
            at += 1
    return answers


class _BackError(Exception):
    """The person wants the question before once more."""


def _asked(name: str, ask: Ask | None, default: float | str | None, when: str, hint: str = "") -> Any:
    """Put the question until the answer is plausible."""
    if ask is None:
        raise AmbientError(f"give {OPTIONS[name]}")
    figure = ROOM_FIGURES.get(name)
    if figure is None:
        prompt = f"Lubrication (oil, when last given; Enter for {default or 'none'})"
    else:
        prompt = figure.prompt
        if isinstance(default, float):
            prompt += f" (Enter for {default / figure.factor:.6g}, as {when})"
    why = ""
    for _ in range(MOST_TRIES):
        try:
            text = ask(f"{why}{prompt}{hint}: ").strip()[:MOST_TEXT]
        except EOFError:
            raise AmbientError(f"nobody answered '{prompt}'; give {OPTIONS[name]}") from None
        if text.lower() == BACK:
            raise _BackError
        if figure is None:
            return text or default or "none"
        if not text and default is not None:
            return default
        value, why = _number(text, figure)
        if value is not None:
            return value
    raise AmbientError(f"'{prompt}' was not answered usably {MOST_TRIES} times; give {OPTIONS[name]}")


def _number(text: str, figure: _Figure) -> tuple[float | None, str]:
    units = {**figure.others, figure.unit: figure.factor}
    unit = next((one for one in sorted(units, key=len, reverse=True) if text.endswith(one)), figure.unit)
    try:
        typed = float(text.removesuffix(unit).strip()) * units[unit] / figure.factor
    except ValueError:
        with_unit = f", with or without one of {', '.join(units)} behind it" if figure.others else ""
        return None, f"'{text[:20]}' is not a number with a decimal point{with_unit}. "
    if not math.isfinite(typed) or not figure.low <= typed <= figure.high:
        return None, f"{typed:g} {figure.unit} is not plausible ({figure.low:g} to {figure.high:g}{figure.hint}). "
    return typed * figure.factor, ""
