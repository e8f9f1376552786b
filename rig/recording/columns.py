"""The columns known by name: a column is defined here once, and everything else looks it up.

An instrument that states no figures is taken for a modest one: a gauge of class 0.6 to 6 bar, a rotameter to 100 L/min,
an optical tachometer, a thermocouple, transducers to 10 N m and 200 N, encoders. Its figures are one standard deviation
each, in the column's unit (scale_sd is relative).
"""

from __future__ import annotations

import math
import re
from collections.abc import Container
from dataclasses import dataclass

from configs import close_to
from configs.units import BAR, M3_S, RAD_S
from rig.recording import units

FIGURES = ("noise_sd", "bias_sd", "scale_sd", "resolution")
HUGE = 1e12  # beyond it no column here has a physical meaning


@dataclass(frozen=True)
class Known:
    """A column known by name.

    `low`, `high`: plausible limits [unit].
    `figures`: of an instrument that states none.
    `channel`: the quantity that it holds, which several columns may share; empty for a flag.
    `si`, `to_si`: the unit that is computed with, and the factor to it; a temperature stays in degrees Celsius.
    """

    column: str
    says: str
    low: float
    high: float
    figures: tuple[float, float, float, float] | None = None
    channel: str = ""
    unit: str = "1"
    si: str = "1"
    to_si: float = 1.0

    @property
    def name_si(self) -> str:
        """The quantity's name with the unit that is computed with: ``speed_rad_s``."""
        unit = self.si.removeprefix("deg").replace(" ", "").replace("/", "_").lower()
        return f"{self.channel}_{unit}" if unit else self.channel


PRESSURE = ("pressure_bar_abs", "pressure_bar_gauge")
FLAGS = ("supply_open", "rotor_locked")
ROLES = ("pressure", "flow", "speed", "temperature")  # channels that a bench may have

_GAUGE, _BAR = (0.005, 0.02, 0.005, 0.01), ("pressure", "bar", "Pa", BAR)
_ALL = (
    Known("time_s", "seconds on the file's clock", -HUGE, HUGE, None, "time", "s", "s"),
    Known("pressure_bar_abs", "absolute inlet pressure, 0.01 to 40 bar", 0.01, 40.0, _GAUGE, *_BAR),
    Known("pressure_bar_gauge", "gauge inlet pressure, -1.1 to 40 bar", -1.1, 40.0, _GAUGE, *_BAR),
    Known("flow_l_min", "L/min at the inlet's state, up to 100000", -math.inf, 1e5, (1.0, 1.0, 0.03, 1.0),
          "flow", "L/min", "m3/s", M3_S),
    Known("speed_rpm", "rpm, 0 to 200000, never negative", 0.0, 2e5, (0.5, 0.1, 0.0005, 0.1),
          "speed", "rpm", "rad/s", RAD_S),
    Known("supply_open", "0 or 1", 0.0, 1.0),
    Known("rotor_locked", "0 or 1", 0.0, 1.0),
    Known("inlet_temperature_c", "degrees Celsius, -80 to 200", -80.0, 200.0, (0.2, 0.5, 0.0, 0.1),
          "temperature", "degC", "degC"),
    Known("torque_nm", "measured drive in N m", -HUGE, HUGE, (0.02, 0.02, 0.01, 0.01), "torque", "N m", "N m"),
    Known("force_n", "measured drive in N", -HUGE, HUGE, (0.5, 0.5, 0.01, 0.1), "force", "N", "N"),
    Known("velocity_m_s", "m/s", -HUGE, HUGE, (0.002, 0.001, 0.002, 0.001), "velocity", "m/s", "m/s"),
    Known("angle_rad", "rad", -HUGE, HUGE, (0.002, 0.01, 0.0, 0.001), "angle", "rad", "rad"),
)  # fmt: skip
NUMERIC = {known.column: known for known in _ALL}
OF_CHANNEL = {known.channel: known for known in reversed(_ALL) if known.channel}  # a pressure's: the absolute one
IN_SI = {known.name_si: known for known in OF_CHANNEL.values()}
MEASURED = tuple(known.column for known in _ALL if known.figures)
NAMES = (*NUMERIC, "direction")

# Of the columns that are named by their quantity: units in which they come under another name.
_FOREIGN = {
    "pressure": "bar pa hpa mbar kpa mpa psi psia psig atm",
    "speed": "rad_s hz rps rev_s rev_min 1_min deg_s krpm",
    "flow": "lpm l_s l_h ml_min m3_h m3_min m3_s cfm kg_s kg_h g_s nl_min sl_min ln_min slpm nlpm sccm",
    "time": "ms us min h",
    "torque": "nmm mnm ncm knm lbft",
    "force": "kn mn kgf lbf",
    "velocity": "mm_s cm_s m_min km_h",
    "angle": "deg rev",
    "inlet_temperature": "k f",
}


def quantity(channel: str) -> Known:
    """What a channel is measured in; without a unit where no column holds such a quantity."""
    return OF_CHANNEL.get(channel) or Known("", "", -HUGE, HUGE, None, channel, "", "")


def pressure_in(columns: Container[str]) -> tuple[str, bool]:
    """The column of the supply's pressure, and whether it is above the room's; the absolute one where there is none."""
    gauge = PRESSURE[1] in columns
    return PRESSURE[gauge], gauge


def siblings(column: str) -> tuple[str, ...]:
    """The known columns of the same quantity as a column, under whatever name or unit it comes."""
    plain = _plain(column)
    quantity = next((word for word in _FOREIGN if plain == word or plain.startswith(f"{word}_")), None)
    return tuple(name for name in NAMES if name.startswith(f"{quantity}_")) if quantity else (column,)


def other_spelling(name: str) -> tuple[str, str] | None:
    """What a column that holds a known quantity under another name or unit should be called.

    Returns the expected column (or columns), and what to do with the numbers; None when no known quantity is
    recognised.
    """
    plain = _plain(name)
    if plain in NAMES:
        return plain, "the numbers stay"
    for quantity, foreign in _FOREIGN.items():
        if plain != quantity and not plain.startswith(f"{quantity}_"):
            continue
        unit, reference = _unit_and_reference(plain.removeprefix(quantity).strip("_"), quantity)
        if not unit or unit in foreign.split():
            return _expected(quantity, reference), _advice(quantity, unit)
    return None


def _advice(quantity: str, unit: str) -> str:
    """What to do with the numbers of a quantity in a unit; where the name has none, to say it."""
    is_pressure = quantity == "pressure"
    if not unit:
        return "name unit and reference" if is_pressure else "name the unit"
    if is_pressure and unit == "bar":
        return "say whether it is absolute or gauge"
    held = {one for name in siblings(quantity) for one in units.QUANTITIES_OF[name]}
    known = units.unit_in_a_name(unit, held) or units.unit_in_a_name(f"{unit}_abs", held)
    return units.advice(known) if known else "name the unit"


def _plain(name: str) -> str:
    """A column's name in lower case, whatever stands between its words made one underscore."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _unit_and_reference(rest: str, quantity: str) -> tuple[str, str]:
    """Split "kpa_abs" into its unit and, for a pressure, "abs" or "gauge"."""
    parts = rest.split("_")
    if quantity != "pressure":
        return rest, ""
    known = {"abs": "abs", "absolute": "abs", "a": "abs", "gauge": "gauge", "g": "gauge", "rel": "gauge"}
    references = [known[part] for part in parts if part in known]
    return "_".join(part for part in parts if part not in known), references[0] if references else ""


def _expected(quantity: str, reference: str) -> str:
    if quantity == "pressure":
        return f"pressure_bar_{reference}" if reference else " or ".join(PRESSURE)
    return next(name for name in NAMES if name.startswith(f"{quantity}_"))


def nearest(name: str, known: tuple[str, ...] = NAMES) -> str:
    """A suggestion for a misspelt column, as the end of a sentence; empty when nothing is near."""
    close = close_to(name, known)
    return f"; did you mean '{close}'?" if close else ""
