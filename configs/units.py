"""Units at the rim, in SI: one table for all who convert."""

from __future__ import annotations

import math
from collections.abc import Mapping

BAR = 1e5  # Pa
STANDARD_BAR = 1.01325  # bar abs: of a room whose pressure nobody told
ZERO_C = 273.15  # K
RPM = 30.0 / math.pi  # rpm in one rad/s
RAD_S = math.pi / 30.0  # rad/s in one rpm
L_MIN = 60_000.0  # L/min in one m3/s
M3_S = 1.0 / 60_000.0  # m3/s in one L/min

# Other units, by what one of them is in ours.
IN_BAR = {
    "bar": 1.0,
    "mbar": 1e-3,
    "hPa": 1e-3,
    "kPa": 1e-2,
    "Pa": 1e-5,
    "MPa": 10.0,
    "psi": 0.0689475729,
    "atm": STANDARD_BAR,
}
IN_L_MIN = {
    "L/min": 1.0,
    "L/s": 60.0,
    "L/h": 1.0 / 60.0,
    "m3/h": 1000.0 / 60.0,
    "m3/min": 1000.0,
    "m3/s": 60_000.0,
    "cfm": 28.316846592,
    "mL/min": 1e-3,
}
IN_RPM = {"rpm": 1.0, "krpm": 1000.0, "rad/s": RPM, "rev/s": 60.0, "deg/s": 1.0 / 6.0}
# By the end of a channel's name: its unit, from where it counts, and what else may stand on an instrument's face.
FACES: dict[str, tuple[str, str, Mapping[str, float]]] = {
    "_bar_abs": ("bar", " abs", IN_BAR),
    "_bar_gauge": ("bar", " gauge", IN_BAR),
    "_l_min": ("L/min", "", IN_L_MIN),
    "_rpm": ("rpm", "", IN_RPM),
    "_c": ("degC", "", {"degC": 1.0}),
}

# By the end of a name: its unit, the least that is meant, and other units that it is often given in, each with the
# factor from it and what is added.
_OTHERS = {
    "bar_abs": (" bar", 0.3, (("mbar", 1e-3, 0.0), ("kPa", 1e-2, 0.0), ("Pa", 1e-5, 0.0))),
    "_c": (" degC", -60.0, (("K", 1.0, -ZERO_C),)),
    "humidity": ("", 0.0, (("%", 1e-2, 0.0),)),
}


def as_in_another_unit(name: str, value: float, high: float) -> str:
    """What a value above `high` would be, if it was meant in another unit: "1009 mbar is 1.009 bar"; or nothing.

    `name`: with its unit at the end, such as ``pressure_bar_abs``.
    """
    for end, (own, low, others) in _OTHERS.items():
        for unit, factor, added in others if name.endswith(end) else ():
            meant = value * factor + added
            if low <= meant <= high:
                return f"{value:g} {unit} is {meant:.6g}{own}"
    return ""


def end_of(name: str) -> str:
    """The end of a channel's name that says its unit; empty where there is none."""
    return next((end for end in FACES if name.endswith(end)), "")
