"""simulation/1, sensitivity/1 and reproduction/1."""

from __future__ import annotations

from typing import Any, Literal, get_type_hints

from pydantic import RootModel, create_model

from model.article.comparison import Comparison as OfArticle
from model.article.reproduction import StepRow
from model.motor import Readings
from model.operation.performance import OperatingPoint
from spinbench.documents.parts import Document


def _with_fields(name: str, base: type[Document], kind: type) -> Any:
    """A document with the keys of another, and with the fields of a dataclass beside them."""
    fields: dict[str, Any] = {field: (annotation, ...) for field, annotation in get_type_hints(kind).items()}
    return create_model(name, __base__=base, **fields)


class OfMotor(Document):
    """The motor: its parameters, each with its unit in the name, and how equations were read."""

    motor: str
    parameters: dict[str, float]
    readings: Readings


class _Simulated(OfMotor):
    format: Literal["simulation/1"]


_Point = _with_fields("Point", _Simulated, OperatingPoint)


class Sweep(_Simulated):
    """Several operating points."""

    points: list[OperatingPoint]


class InTime(_Simulated):
    """A run in time: lists by time."""

    transient: Literal["spin-up", "coast-down"]
    pressure_bar_abs: float
    time_s: list[float]
    speed_rpm: list[float]
    mean_speed_rpm: list[float]
    angle_rad: list[float]
    inlet_kg: list[float]
    outlet_kg: list[float]


class Simulation(RootModel):  # type: ignore[type-arg]
    """simulation/1: what `spinbench simulate` writes."""

    root: _Point | Sweep | InTime  # type: ignore[valid-type]


class Ranked(Document):
    """What a parameter does, a number for each pressure; null where the motor would stall, or there is no prior."""

    name: str
    unit: str
    value: float
    prior_step: str
    speed_rpm_per_percent: list[float | None]
    flow_l_min_per_percent: list[float | None]
    speed_rpm_per_prior_sd: list[float | None] | None
    flow_l_min_per_prior_sd: list[float | None] | None


class Sensitivity(OfMotor):
    """sensitivity/1: what `spinbench sensitivity` writes."""

    format: Literal["sensitivity/1"]
    pressure_bar_abs: list[float]
    ranking: list[Ranked]


class _Differing(Document):
    difference: float


_Compared = _with_fields("Compared", _Differing, OfArticle)


class Reproduction(Document):
    """reproduction/1: what `spinbench reproduce` writes; rows as docs/reproduction.md has them, units in the keys."""

    format: Literal["reproduction/1"]
    comparisons: list[_Compared]  # type: ignore[valid-type]
    plateaus: list[dict[str, float]]
    steps: list[StepRow]
    flow_peaks: list[dict[str, float]]
    steady_speed_rpm: float
    friction: dict[str, list[Any]]
    diameter: dict[str, list[Any]]
