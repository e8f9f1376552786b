"""The units that an import knows. A unit is said, never guessed, and a pressure's says absolute or gauge.

A value in the column's unit is ``value * factor + offset``.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

from configs.units import IN_BAR, IN_L_MIN, IN_RPM, RPM, ZERO_C
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError


@dataclass(frozen=True)
class Unit:
    """A unit of one quantity, and how it becomes that of the recording/1 column."""

    quantity: str
    factor: float
    offset: float = 0.0


_STANDARD_FLOW = {
    "sL/min": 1.0,
    "NL/min": 1.0,
    "Nm3/h": 1000.0 / 60.0,
    "sm3/h": 1000.0 / 60.0,
    "scfm": 28.316846592,
}
DATED = {"Y-M-D h:m:s": (0, 1, 2), "D.M.Y h:m:s": (2, 1, 0), "M/D/Y h:m:s": (2, 0, 1)}  # places of year, month, day
_KG_S = {"kg/s": 1.0, "g/s": 1e-3, "kg/min": 1.0 / 60.0, "g/min": 1e-3 / 60.0, "kg/h": 1.0 / 3600.0}
# By the density of dry air at 0 degC and 1.01325 bar, to which `converted` takes it as referred.
_MASS_FLOW = {name: factor * 6e4 * 287.05 * ZERO_C / 101_325.0 for name, factor in _KG_S.items()}
_OTHERS = {
    "speed": IN_RPM,
    "pulse rate": {"Hz": 60.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "time of day": dict.fromkeys(("ISO", "hh:mm:ss", *DATED, "Excel days"), 1.0),
    "torque": {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "kN m": 1000.0, "lbf ft": 1.3558179483},
    "force": {"N": 1.0, "kN": 1000.0, "mN": 1e-3, "kgf": 9.80665, "lbf": 4.4482216153},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "m/min": 1.0 / 60.0, "km/h": 1.0 / 3.6},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "flag": {"0/1": 1.0},
    "words": {"words": 1.0},
}
UNITS = {
    **{f"{name} abs": Unit("absolute pressure", factor) for name, factor in IN_BAR.items()},
    **{f"{name} gauge": Unit("gauge pressure", factor) for name, factor in IN_BAR.items()},
    **{name: Unit("flow", factor) for name, factor in IN_L_MIN.items()},
    **{name: Unit("standard flow", factor) for name, factor in _STANDARD_FLOW.items()},
    **{name: Unit("mass flow", factor) for name, factor in _MASS_FLOW.items()},
    **{name: Unit(quantity, factor) for quantity, units in _OTHERS.items() for name, factor in units.items()},
    "degC": Unit("temperature", 1.0),
    "K": Unit("temperature", 1.0, -ZERO_C),
    "degF": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0),
}
QUANTITIES = {
    "time_s": ("time", "time of day"),
    "pressure_bar_abs": ("absolute pressure",),
    "pressure_bar_gauge": ("gauge pressure",),
    "flow_l_min": ("flow", "standard flow", "mass flow"),
    "speed_rpm": ("speed", "pulse rate"),
    "inlet_temperature_c": ("temperature",),
    "supply_open": ("flag",),
    "rotor_locked": ("flag",),
    "direction": ("words",),
    "torque_nm": ("torque",),
    "force_n": ("force",),
    "velocity_m_s": ("velocity",),
    "angle_rad": ("angle",),
}
INTEGRALS = {"velocity_m_s": "length", "speed_rpm": "angle"}  # of what the column is the rate of change
# g/mol, of what a rotameter's scale may be made for.
MOLAR_MASS = {
    "air": 28.965,
    "nitrogen": 28.014,
    "oxygen": 31.998,
    "argon": 39.948,
    "carbon dioxide": 44.009,
    "helium": 4.0026,
}


def known_units(column: str, differentiate: bool = False) -> list[str]:
    """The units that a column may come in. `differentiate`: whether it is made from a length or an angle."""
    quantities = (INTEGRALS.get(column, ""),) if differentiate else QUANTITIES[column]
    return [name for name, unit in UNITS.items() if unit.quantity in quantities]


def unit_of(column: str, name: str, differentiate: bool = False) -> Unit:
    """The unit of a column's source.

    `differentiate`: whether the column is the rate of change of what the source holds.
    Raises RunError when the unit is missing, unknown, or of another quantity. The text lists those that would do.
    """
    known = known_units(column, differentiate)
    listed = ", ".join(known)
    if differentiate and not known:
        raise RunError(f"{column} is not made by differentiating; {' and '.join(INTEGRALS)} are")
    if not name:
        raise RunError(f"the unit is missing; units are said and never guessed: one of {listed}")
    if name in known:
        unit = UNITS[name]
        return Unit(unit.quantity, unit.factor * RPM) if differentiate and column == "speed_rpm" else unit
    called = name if name in UNITS else unit_called(name) or next(iter(difflib.get_close_matches(name, known, 1)), "")
    said = f"'{shown(name)}'"
    if called in PRESSURES:
        raise RunError(f"the unit {said} does not say absolute or gauge; write '{called} abs' or '{called} gauge'")
    if called and called not in known:
        said += f", read as '{called}'," * (called != name)
        raise RunError(f"{said} is a unit of {UNITS[called].quantity}, and {column} comes in one of {listed}")
    meant = f"did you mean '{called}'? Known" if called else "known"
    raise RunError(f"the unit {said} is not known; {meant} for {column}: {listed}")


# How others write a unit.
_SAME = {
    "L/min": ("lpm", "l min", "liter/min", "liters/min", "litre/min", "litres/min", "l/minute"),
    "sL/min": ("slpm", "std l/min", "sl/min", "standard l/min"),
    "NL/min": ("ln/min", "nlpm", "norm l/min"),
    "m3/h": ("m^3/h", "cbm/h"),
    "Nm3/h": ("nm^3/h", "mn3/h"),
    "cfm": ("ft3/min", "ft^3/min"),
    "scfm": ("std cfm", "standard cfm", "std ft3/min", "sft3/min"),
    "rpm": ("1/min", "u/min", "min-1", "min^-1", "rev/min", "r/min", "upm"),
    "rev/s": ("u/s", "rps", "r/s"),
    "deg/s": ("°/s",),
    "degC": ("°c", "celsius", "grad c"),
    "degF": ("°f",),
    "N m": ("nm", "n*m", "n·m"),
    "mN m": ("mnm",),
    "N cm": ("ncm",),
    "s": ("sec", "secs", "second", "seconds", "sek", "sekunden"),
    "ms": ("msec", "milliseconds", "millisekunden"),
    "us": ("µs", "μs", "microseconds"),
    "min": ("minutes", "minuten"),
    "h": ("hours", "stunden"),
    "deg": ("°",),
    "m/s": ("m/sec",),
}
_ABS = ("abs", "(abs)", "a", "(a)", "absolute")
_GAUGE = ("gauge", "(gauge)", "g", "(g)", "rel", "(rel)", "ü", "relative")
PRESSURES = {name.removesuffix(" abs") for name in UNITS if name.endswith(" abs")}


def _compact(text: str) -> str:
    return text.replace(" ", "").replace("_", "").replace("³", "3").replace("²", "2")


def _aliases() -> dict[str, str]:
    """Every way to write a unit, without spaces: the known unit, or a pressure that says neither absolute nor gauge."""
    known = {_compact(name): name for name in UNITS if name not in QUANTITIES["direction"]}
    known |= {_compact(other): name for name, others in _SAME.items() for other in others}
    for name in PRESSURES:
        known |= {name: name} | {_compact(name + end): f"{name} abs" for end in _ABS}
        known |= {_compact(name + end): f"{name} gauge" for end in _GAUGE}
    return known


_EXACT = _aliases()
_AS_WRITTEN = {"mpa", "mn", "mnm"}  # where a capital letter makes another unit
_FOLDED = {alias.casefold(): name for alias, name in _EXACT.items() if alias.casefold() not in _AS_WRITTEN}


def unit_called(text: str) -> str:
    """The unit that a text is, as the import knows it or a pressure's without abs or gauge; empty for none."""
    compact = _compact(text.strip().strip("[]"))
    return _EXACT.get(compact) or _FOLDED.get(compact.casefold(), "")
