"""Figures in the units that a person uses."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from model.layout import L_MIN, RPM

FAMILIAR = {"m3/s": ("L/min", L_MIN), "Pa": ("kPa", 1e-3), "rad/s": ("rpm", RPM)}  # unit of a person, and the factor
# What stands beneath every list of recommended tests.
CAUTION = (
    "A test gives as often more as less than it promises, if one of the explanations weighed is right (the range: "
    "which of them). The noise of the new readings is left out. Where none of them is right, it may give far less."
)
CERTAIN = 1e6  # odds that are told no further
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")  # of a power of ten


def powers(text: str) -> str:
    """Digits behind a letter raised, as in m3/s; names in braces are left alone."""
    return re.sub(r"\{[^}]*\}|(?<=[A-Za-z])\d\b", lambda m: m[0] if m[0][0] == "{" else m[0].translate(RAISED), text)


def for_people(mean: float, sd: float, unit: str, name: str) -> tuple[float, float, str]:
    """A figure, its uncertainty and its unit as a person uses them."""
    if unit == "-":
        return (100.0 * mean, 100.0 * sd, "%") if "share" in name or "scale" in name else (mean, sd, "")
    if unit == "s" and abs(mean) < 0.5:
        return 1e3 * mean, 1e3 * sd, "ms"
    unit, factor = FAMILIAR.get(unit, (powers(unit), 1.0))
    return factor * mean, factor * sd, unit


def in_a_table(unit: str) -> str:
    """A unit as a table tells it: 1 where there is none."""
    return "1" if unit == "-" else unit


def on_an_axis(unit: str, name: str) -> tuple[float, str]:
    """The factor on figures of one quantity, large and small, and their unit as a person uses it."""
    factor, _, familiar = for_people(1.0, 0.0, unit, name)
    return factor, familiar


def nats_in_words(nats: float) -> str:
    """What a test tells between explanations, as a person is told it: each nat multiplies the odds by e."""
    odds = math.exp(min(abs(nats), 99.0))
    rounded = float(f"{odds:.2g}")
    shown = "over a million" if odds > CERTAIN else f"{rounded:.0f}" if rounded >= 10.0 else f"{rounded:g}"
    return f"{nats:.1f} nats: odds of {shown} to 1".replace("-", "−") + " against it" * (nats < 0.0)


def promise_in_words(test: Mapping[str, Any]) -> str:
    """What a test of `next_tests` is expected to tell, and between what and what, by which explanation is right."""
    said, between = nats_in_words(test["information_nats"]), test.get("range_nats")
    if not between:
        return said
    return f"{said}; {between[0]:.1f} to {between[1]:.1f}, depending on which explanation is right".replace("-", "−")


def promise_in_short(test: Mapping[str, Any]) -> str:
    """The same in nats alone, for a table."""
    between = test.get("range_nats")
    also = f" ({between[0]:.1f} to {between[1]:.1f})" if between else ""
    return f"{test['information_nats']:.1f}{also}".replace("-", "−")


def times_to_take(test: Mapping[str, Any]) -> str:
    """How often a test of `next_tests` has to be taken until it decides."""
    repeats = test.get("repeats")
    if repeats is None:
        return "however often it is taken, some pair stays open"
    return (
        f"take it {'once' if repeats == 1 else f'{repeats} times'}: each two are then parted, on average with 150 : 1"
    )


def how_taken(test: Mapping[str, Any]) -> str:
    """The command that takes a test of `next_tests`, or why there is none."""
    if test.get("command"):
        return str(test["command"])
    return f"no command: it needs {test['needs']}" if test.get("needs") else "no command: take it by hand"
