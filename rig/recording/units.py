"""Units that others write, each with its factor to the unit of the column that it belongs to.

A unit is said, never guessed, and a pressure's says absolute or gauge. A value in the column's unit is
``value * factor + offset``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container
from dataclasses import dataclass

from configs.units import BAR, IN_BAR, IN_L_MIN, IN_RPM, STANDARD_BAR, ZERO_C


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
    "sccm": 1e-3,
}
DATED = {"Y-M-D h:m:s": (0, 1, 2), "D.M.Y h:m:s": (2, 1, 0), "M/D/Y h:m:s": (2, 0, 1)}  # places of year, month, day
_KG_S = {"kg/s": 1.0, "g/s": 1e-3, "kg/min": 1.0 / 60.0, "g/min": 1e-3 / 60.0, "kg/h": 1.0 / 3600.0}
# By the density of dry air at 0 degC and 1.01325 bar, which an import takes it as referred to.
_MASS_FLOW = {name: factor * 6e4 * 287.05 * ZERO_C / (STANDARD_BAR * BAR) for name, factor in _KG_S.items()}
_OTHERS = {
    "speed": IN_RPM,
    "pulse rate": {"Hz": 60.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "time of day": dict.fromkeys(("ISO", "hh:mm:ss", *DATED, "Excel days"), 1.0),
    "torque": {"N m": 1.0, "mN m": 1e-3, "N mm": 1e-3, "N cm": 1e-2, "kN m": 1000.0, "lbf ft": 1.3558179483},
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


QUANTITIES_OF = {  # that a column may come in
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

# How others write a unit.
_SAME = {
    "L/min": ("lpm", "l min", "liter/min", "liters/min", "litre/min", "litres/min", "l/minute"),
    "sL/min": ("slpm", "slm", "sl min", "std l/min", "sl/min", "standard l/min"),
    "NL/min": ("ln/min", "nlpm", "nl min", "norm l/min"),
    "m3/h": ("m^3/h", "cbm/h"),
    "mL/min": ("milliliter/min", "millilitre/min"),
    "Nm3/h": ("nm^3/h", "mn3/h"),
    "cfm": ("ft3/min", "ft^3/min"),
    "scfm": ("std cfm", "standard cfm", "std ft3/min", "sft3/min"),
    "rpm": ("1/min", "u/min", "min-1", "min^-1", "rev/min", "r/min", "upm"),
    "rev/s": ("u/s", "rps", "r/s", "1/s", "s-1", "s^-1"),
    "deg/s": ("°/s",),
    "degC": ("°c", "celsius", "grad c"),
    "degF": ("°f",),
    "N m": ("nm", "n*m", "n·m"),
    "mN m": ("mnm",),
    "N cm": ("ncm",),
    "N mm": ("nmm",),
    "lbf ft": ("lb ft",),
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
PRESSURE_UNITS = {name.removesuffix(" abs") for name in UNITS if name.endswith(" abs")}


# By the end of a channel's name: what its unit is called.
_OF_NAMES = {
    "bar_abs": ("bar", "bar abs"),
    "bar_gauge": ("bar", "bar gauge"),
    "l_min": ("L/min", "sL/min", "NL/min"),
    "_rpm": ("rpm",),
    "_c": ("degC",),
}
_RAISED = str.maketrans("¹²³⁻−–", "123---")


def _compact(text: str) -> str:
    return text.replace(" ", "").replace("_", "").translate(_RAISED)


def _aliases() -> dict[str, str]:
    """Every way to write a unit, without spaces: the known unit, or a pressure that says neither absolute nor gauge."""
    known = {_compact(name): name for name in UNITS if name != "words"}
    known |= {_compact(other): name for name, others in _SAME.items() for other in others}
    for name in PRESSURE_UNITS:
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


def not_of_the_name(name: str, unit: str) -> str:
    """Why a unit is not that of a channel's name, and what to do; or nothing.

    `name`: with its unit at the end, such as ``pressure_bar_abs``; with another end every unit will do.
    """
    own = next((own for end, own in _OF_NAMES.items() if name.endswith(end)), ())
    called = unit_called(unit)
    if not own or called in own:
        return ""
    above = called.rpartition(" ")[2]
    if above in ("abs", "gauge") and not own[-1].endswith(above):
        return f"the name says {own[-1]}: give the channel the name of what the instrument shows"
    other = UNITS.get(called) or UNITS.get(f"{called} {own[-1].rpartition(' ')[2]}")
    write = f"scale the numbers{'' if other else ', if they are in another unit'}, and write {own[0]} here"
    if other is None or other.quantity not in {UNITS[one].quantity for one in own if one in UNITS} or other.offset:
        return f"the name says {own[0]}: {write}"
    plain = called.removesuffix(" abs").removesuffix(" gauge")
    return f"the name says {own[0]}, and 1 {plain} is {other.factor:.6g} {own[0]}: {write}"


def unit_in_a_name(text: str, quantities: Container[str]) -> Unit | None:
    """The unit of one of some quantities that stands in a column's name: "kpa", "rad_s"; None where there is none."""
    plain = _letters(text)
    for alias, name in _EXACT.items():
        if _letters(alias) == plain and name in UNITS and UNITS[name].quantity in quantities:
            return UNITS[name]
    return None


def _letters(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


def advice(unit: Unit) -> str:
    """What to do with numbers in a unit, to bring them to the column's."""
    if unit.quantity == "standard flow":
        return "bring standard litres to the inlet's pressure and temperature"
    if unit.quantity == "mass flow":
        return f"divide by the air's density at the inlet, then {times(unit.factor / UNITS['kg/s'].factor * 6e4)}"
    if unit.offset:
        shifted = f"subtract {-unit.offset / unit.factor:.6g}"
        return shifted if unit.factor == 1.0 else f"{shifted}, then {times(unit.factor)}"
    stay = unit.factor == 1.0
    if unit.quantity == "flow" and stay:
        return "the numbers stay, if they are at the inlet's pressure and temperature"
    return "the numbers stay" if stay else times(unit.factor)


def times(factor: float, what: str = "") -> str:
    """A factor as what to do: multiply by it, or divide where that is the rounder number. `what`: behind the verb."""
    inverse = 1.0 / factor
    if factor < 1.0 and math.isclose(inverse, round(inverse, 1), rel_tol=1e-9):
        return f"divide {what}by {round(inverse, 1):.10g}"
    return f"multiply {what}by {factor:.6g}"
