"""A set of effects that was weighed against others, and why it may not be named."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from calibration.likelihood.mode import Mode


class Reason(Enum):
    """Why a set cannot be named."""

    AT_BOUND = auto()  # a size at the bound of what is believable
    VANISHES = auto()
    TOO_LOUD = auto()  # it asks for noise far above the declared
    NO_LARGER = auto()  # all that it says is that an instrument's error is as large as declared


@dataclass(frozen=True)
class Refusal:
    """Why a set cannot be named, for the program and in words."""

    reason: Reason
    words: str

    def __str__(self) -> str:
        return self.words


def at_bound(name: str, parameter: str) -> Refusal:
    """The size of an effect is at its bound."""
    return Refusal(Reason.AT_BOUND, f"{name}: {parameter} is at the bound of what is believable")


def vanishes(name: str) -> Refusal:
    """Nothing is left of an effect."""
    return Refusal(Reason.VANISHES, f"{name} vanishes")


def no_larger(name: str) -> Refusal:
    """An effect is its instrument's declared error."""
    return Refusal(Reason.NO_LARGER, f"{name} is no larger than declared")


@dataclass(frozen=True)
class Candidate:
    """A set of effects, refitted.

    `names`: ids, sorted; empty for the base model.
    `log_evidence`: conditional on its nuisance-like members being beyond three sd [-].
    `log_probability`: natural logarithm: sets may be thousands of nats apart [-].
    `refused`: why it cannot be named; None where it can.
    """

    names: tuple[str, ...]
    mode: Mode
    log_evidence: float
    log_probability: float
    refused: Refusal | None = None

    @property
    def probability(self) -> float:
        return math.exp(self.log_probability)


def alone(mode: Mode) -> Candidate:
    """A set that stands against no other."""
    return Candidate(mode.names, mode, mode.log_evidence, 0.0)
