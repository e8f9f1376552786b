"""The motor's parameters: read from configs/motors, validated, in one place for every solver, the fit and the CLI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pydantic

import configs
from configs import ConfigError, Strict, close_to
from model import geometry, layout

MOTORS = configs.FOLDER / "motors"


@dataclass(frozen=True)
class Quantity:
    """What a parameter is: its unit, the factor to SI, and the bounds outside which it is a mistake."""

    unit: str
    to_si: float
    low: float
    high: float


# The order is the order of the compiled solvers' parameter vector (model.layout names the same indices).
QUANTITIES: dict[str, Quantity] = {
    "concave_diameter": Quantity("mm", 1e-3, 1.0, 1e4),
    "convex_diameter": Quantity("mm", 1e-3, 1.0, 1e4),
    "cylinder_surface_radius": Quantity("mm", 1e-3, 1.0, 1e4),
    "roller_diameter": Quantity("mm", 1e-3, 0.1, 1e4),
    "concave_reach": Quantity("mm", 1e-3, 1.0, 1e4),
    "cylinder_diameter": Quantity("mm", 1e-3, 0.1, 1e4),
    "piston_length": Quantity("mm", 1e-3, 0.1, 1e4),
    "port_lap": Quantity("deg", np.pi / 180.0, 0.5, 20.0),
    "roller_friction": Quantity("1", 1.0, 0.0, 0.5),
    "f_overall": Quantity("N m s", 1.0, 1e-4, 10.0),
    "inertia": Quantity("kg m2", 1.0, 1e-6, 10.0),
    "ambient_pressure": Quantity("Pa", 1.0, 5e4, 1.2e5),
    "ambient_temperature": Quantity("K", 1.0, 230.0, 400.0),
    "inlet_temperature": Quantity("K", 1.0, 230.0, 400.0),
    "relative_humidity": Quantity("1", 1.0, 0.0, 1.0),
    "inlet_pressure_drop": Quantity("Pa", 1.0, 0.0, 1e5),
    "outlet_pressure_drop": Quantity("Pa", 1.0, 0.0, 1e5),
    "ambient_heat_transfer": Quantity("W/(m2 K)", 1.0, 0.0, 1e5),
    "wall_thickness": Quantity("mm", 1e-3, 0.0, 1e3),
    "wall_conductivity": Quantity("W/(m K)", 1.0, 1e-3, 1e4),
    "housing_diameter": Quantity("mm", 1e-3, 1.0, 1e4),
    "speed_limit": Quantity("rpm", np.pi / 30.0, 1.0, 1e5),
}
SUFFIX = {"mm": "mm", "deg": "deg", "1": "", "N m s": "n_m_s", "kg m2": "kg_m2", "Pa": "pa", "K": "k", "rpm": "rpm"}
SUFFIX |= {"W/(m2 K)": "w_m2k", "W/(m K)": "w_mk"}
ROUND = ("cylinder_diameter", "roller_diameter")  # what stands side by side in the star


class Prior(Strict):
    """What is known of a parameter before the recording; the figures are in the parameter's unit."""

    kind: Literal["normal", "lognormal", "loguniform"]
    sd: float | None = pydantic.Field(default=None, gt=0)
    factor: float | None = pydantic.Field(default=None, gt=1)
    low: float | None = pydantic.Field(default=None, gt=0)
    high: float | None = pydantic.Field(default=None, gt=0)

    @pydantic.model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Prior:
        needs = {"normal": {"sd"}, "lognormal": {"factor"}, "loguniform": {"low", "high"}}[self.kind]
        given = {name for name in ("sd", "factor", "low", "high") if getattr(self, name) is not None}
        if needs != given:
            raise ValueError(f"a {self.kind} prior has {' and '.join(sorted(needs))}, and nothing else")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low} is not below high {self.high}")
        return self


class Parameter(Strict):
    """One figure of the motor: value, unit, where it comes from, and its prior where it is not certain."""

    symbol: str = pydantic.Field(max_length=40)
    value: float
    unit: str = pydantic.Field(max_length=20)
    source: str = pydantic.Field(min_length=3, max_length=300)
    prior: Prior | None = None


class Readings(Strict):
    """Where the article can be read in two ways (docs/model.md, errata): the reading taken."""

    torque: Literal["published", "virtual_work"]
    piston_length: Literal["roller_surface", "roller_centre"]
    wall_resistance: Literal["per_area", "as_printed"]
    roller_friction: Literal["opposing", "as_printed"]
    air: Literal["moist", "constant"]
    heat_transfer: bool

    def vector(self) -> np.ndarray:
        """The readings as the compiled solvers take them, shape (5,), 1.0 or 0.0 each [-]."""
        return np.array(
            [
                self.torque == "virtual_work",
                self.wall_resistance == "as_printed",
                self.roller_friction == "as_printed",
                self.air == "constant",
                self.heat_transfer,
            ],
            dtype=np.float64,
        )


# A name of this module, so that a motor can be sent to another process.
if TYPE_CHECKING:
    Parameters = Strict
else:
    Parameters = pydantic.create_model(
        "Parameters",
        __base__=Strict,
        __module__=__name__,
        __doc__="The parameters of a motor, each a value with its prior and its source.",
        **dict.fromkeys(QUANTITIES, Parameter),
    )


class Motor(Strict):
    """A radial piston motor: its counts and parameters, and how the article is read."""

    format: Literal["motor/1"]
    name: str = pydantic.Field(pattern=r"^[a-z0-9_\-]{1,40}$")
    kind: Literal["radial_piston"]
    description: str = pydantic.Field(default="", max_length=300)
    n_pistons: int = pydantic.Field(default=7, ge=3, le=15)
    n_lobes: int = pydantic.Field(default=4, ge=2, le=8)
    readings: Readings
    parameters: Parameters

    @pydantic.model_validator(mode="after")
    def _is_a_motor(self) -> Motor:
        problems = [*self._count_problems(), *(text for name in QUANTITIES for text in self._problems_of(name))]
        if not problems:
            problems = self._geometry_problems()
        if problems:
            raise ValueError("\n".join(problems))
        return self

    def _count_problems(self) -> list[str]:
        shared = math.gcd(self.n_pistons, self.n_lobes)
        if shared == 1:
            return []
        return [
            f"n_pistons: {self.n_pistons} pistons on {self.n_lobes} lobes share the divisor {shared}, so {shared} "
            "pistons would move as one; the model is for counts without a common divisor"
        ]

    def _problems_of(self, name: str) -> list[str]:
        quantity, parameter = self.quantity(name), self[name]
        if parameter.unit != quantity.unit:
            return [f"parameters.{name}: the unit is '{quantity.unit}', not '{parameter.unit}'; convert the value"]
        if not quantity.low <= parameter.value <= quantity.high:
            return [
                f"parameters.{name}: {parameter.value:g} {quantity.unit} is outside "
                f"{quantity.low:g}..{quantity.high:g} {quantity.unit}"
            ]
        return []

    def _geometry_problems(self) -> list[str]:
        inmost = f"{180 / self.n_lobes:g} deg"
        if self.readings.piston_length == "roller_centre":
            lowest = geometry.lowest_volume(self.vector()) - np.pi / 4 * self.si("cylinder_diameter") ** 2 * (
                self.si("roller_diameter") / 2
            )
            if lowest <= 0:
                return [
                    f"readings.piston_length: Eq. 11 as printed gives a volume of {lowest * 1e6:.2f} cm3 at {inmost}; "
                    "use 'roller_surface' (erratum 1)"
                ]
        lowest = geometry.lowest_volume(self.vector())
        if not lowest > 0:
            return [
                f"parameters: these lengths give no curve, or a cylinder volume that is not positive at {inmost} "
                f"({lowest * 1e6:.3g} cm3); check the diameters, concave_reach and piston_length"
            ]
        return [
            f"parameters.{name}: {self.n_pistons} {what} of {self[name].value:g} mm do not fit side by side; "
            f"each has room for {1e3 * room:.1f} mm"
            for name, what, room in zip(ROUND, ("cylinders", "rollers"), geometry.rooms(self.vector()), strict=True)
            if self.si(name) >= room
        ]

    def quantity(self, name: str) -> Quantity:
        """Unit and bounds of a parameter in this motor: the port lap leaves each port a tenth of its half lobe."""
        quantity = QUANTITIES[name]
        return replace(quantity, high=min(quantity.high, 81.0 / self.n_lobes)) if name == "port_lap" else quantity

    def __getitem__(self, name: str) -> Parameter:
        """The parameter of that name."""
        return getattr(self.parameters, name)

    def si(self, name: str) -> float:
        """The value of a parameter in SI units."""
        return float(self[name].value * QUANTITIES[name].to_si)

    def vector(self) -> np.ndarray:
        """All parameters in SI units, shape (27,): those of `QUANTITIES` in order, `layout.NEUTRAL`, and the counts."""
        return np.array([*(self.si(name) for name in QUANTITIES), *layout.NEUTRAL, self.n_pistons, self.n_lobes])

    def with_values(self, values: Mapping[str, float]) -> Motor:
        """A motor with some values changed.

        It is validated again. Raises ConfigError when a value is outside its bounds or the geometry is impossible.

        Parameters
        ----------
        values : mapping of str to float
            New values by parameter name, each in the parameter's own unit.
        """
        data = self.model_dump()
        for name, value in values.items():
            data["parameters"][name]["value"] = float(value)
        return configs.validate(Motor, data, f"motor {self.name}")

    def with_flywheel(self, added_inertia_kg_m2: float) -> Motor:
        """The motor with a flywheel on its shaft; ConfigError when it is too heavy."""
        total, high = self["inertia"].value + added_inertia_kg_m2, QUANTITIES["inertia"].high
        if total > high:
            raise ConfigError(
                f"added_inertia_kg_m2: a flywheel of {added_inertia_kg_m2:g} kg m2 is too heavy to be simulated; with "
                f"the rotor there may be {high:g} kg m2 on the shaft"
            )
        return self.with_values({"inertia": total})

    def with_readings(self, **readings: str | bool) -> Motor:
        """A motor read in another way, for example ``torque="virtual_work"``; ConfigError when unknown."""
        data = self.model_dump()
        data["readings"] |= readings
        return configs.validate(Motor, data, f"motor {self.name}")


def read_motor(path: Path | str | Mapping[str, Any]) -> Motor:
    """Read a motor file, or take what stands in one.

    Raises ConfigError: every mistake of the file in one line each, with its place.

    Parameters
    ----------
    path : Path, str or mapping
        A TOML file, the name of one in the project or in configs/motors, or its content.
    """
    if isinstance(path, Mapping):
        return configs.validate(Motor, dict(path), f"motor {str(path.get('name', 'without a name'))[:60]}")
    if isinstance(path, str):
        if not re.fullmatch(r"[A-Za-z0-9_\-]{1,40}", path):
            raise ConfigError(f"motor '{path[:60]}': a motor is named by letters, digits, '-' and '_' alone")
        path = configs.find("motors", path) or MOTORS / f"{path}.toml"
    return configs.validate(Motor, configs.read_toml(path), str(path))


def set_values(motor: Motor, assignments: list[str]) -> Motor:
    """Apply ``NAME=VALUE`` overrides as the command line takes them.

    Raises ConfigError for an unknown name (the nearest is suggested), a value that is no number, or one out of bounds.

    Parameters
    ----------
    motor : Motor
        The motor to change.
    assignments : list of str
        Each a parameter (``f_overall=0.064``), a parameter with its unit (``cylinder_diameter_mm=25.8``) or a reading
        (``torque=virtual_work``, ``heat_transfer=false``).
    """
    names = {alias: name for name in QUANTITIES for alias in (name, name_with_unit(name))}
    values: dict[str, float] = {}
    readings: dict[str, str | bool] = {}
    for assignment in assignments:
        key, equals, text = (part.strip() for part in assignment.partition("="))
        if not equals or not text:
            raise ConfigError(f"--set {assignment[:60]!r}: write NAME=VALUE, for example f_overall=0.0633")
        if key in Readings.model_fields and (key not in names or not _is_number(text)):
            readings[key] = {"true": True, "false": False}.get(text, text)
        elif key in names:
            values[names[key]] = _number(key, text)
        else:
            known = [*names, *Readings.model_fields]
            close = close_to(key, known)
            hint = f"did you mean '{close}'?" if close else f"known: {', '.join(known)}"
            raise ConfigError(f"--set {key[:60]}: no such parameter or reading; {hint}")
    return motor.with_values(values).with_readings(**readings)


def name_with_unit(name: str) -> str:
    """The parameter's name with its unit, as the command line and tables show it: ``cylinder_diameter_mm``."""
    suffix = SUFFIX[QUANTITIES[name].unit]
    return f"{name}_{suffix}" if suffix else name


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(key: str, text: str) -> float:
    try:
        value = float(text.replace("_", "no number"))  # Python takes 1_0 for 10
    except ValueError:
        raise ConfigError(f"--set {key}: {text[:40]!r} is not a number") from None
    if not np.isfinite(value):
        raise ConfigError(f"--set {key}: {text[:40]!r} is not a finite number")
    return value
