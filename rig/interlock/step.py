"""What the guard takes and gives: plateaus measured, the speed expected at the next, and whether it may be ordered."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """One plateau: its mean absolute pressure and speed, and the standard deviations of both."""

    pressure_pa: float
    speed_rad_s: float
    speed_sd: float
    pressure_sd: float


@dataclass(frozen=True)
class Prediction:
    """What is expected at a level [rpm].

    `mean_rpm`, `upper99_rpm`, `lower99_rpm`: mean, and the speeds that are passed from above and below with 1 % each.
    """

    mean_rpm: float
    upper99_rpm: float
    lower99_rpm: float
    text: str


@dataclass(frozen=True)
class Verdict:
    """Whether a level may be ordered, and why.

    `highest_pa_abs`: the highest pressure that would be allowed now [Pa]; the level itself when it is allowed.
    """

    allowed: bool
    text: str
    highest_pa_abs: float
