"""What each column of an import may come in: units are said, never guessed."""

from __future__ import annotations

from configs import close_to
from configs.units import RPM
from rig.recording.mistakes import shown
from rig.recording.units import PRESSURE_UNITS, QUANTITIES_OF, UNITS, Unit, unit_called
from rig.runlog.folder import RunError

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
    quantities = (INTEGRALS.get(column, ""),) if differentiate else QUANTITIES_OF[column]
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
    called = name if name in UNITS else unit_called(name) or close_to(name, known)
    said = f"'{shown(name)}'"
    if called in PRESSURE_UNITS:
        raise RunError(f"the unit {said} does not say absolute or gauge; write '{called} abs' or '{called} gauge'")
    if called and called not in known:
        said += f", read as '{called}'," * (called != name)
        raise RunError(f"{said} is a unit of {UNITS[called].quantity}, and {column} comes in one of {listed}")
    meant = f"did you mean '{called}'? Known" if called else "known"
    raise RunError(f"the unit {said} is not known; {meant} for {column}: {listed}")
