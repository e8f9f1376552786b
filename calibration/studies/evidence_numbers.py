"""The figures of a check of the evidence: how far Laplace is off, case by case and by kind of case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from model.effects import effects

AGREE = 0.5  # nats
NEAR_ZERO = 2.0  # sds: a one-sided amplitude below it has its bound in its posterior
NEAR_STALL = 1.0  # rad/s: with a level this slow in it a sweep is at the edge of a stall
NUMBERS = (
    "laplace",
    "laplace_noise",
    "nested",
    "nested_error",
    "nested_again",
    "importance",
    "importance_error",
    "effective",
    "base_off",
    "effect_off",
    "amplitude",
    "amplitude_sd",
    "slowest_rad_s",
    "not_read",
    "unknowns",
    "calls",
)

Row = Mapping[str, Any]
Rows = Sequence[Row]


def numbers(value: Mapping[str, Any]) -> dict[str, float | None]:
    """The figures of a case.

    By the names of NUMBERS. ``laplace``, ``nested`` and ``importance`` are ln Bayes factors, of the effect over the
    base model; ``laplace_noise`` is Laplace's with the noise scales integrated too; ``base_off`` and ``effect_off`` are
    by how much each model's ln Z is higher by that than by importance sampling. ``effective`` is the smaller sample.
    """
    base, full = value["base"], value["with_effect"]

    laplace = full["laplace"] - base["laplace"]
    off: dict[str, float | None] = {"laplace_noise": None, "base_off": None, "effect_off": None}
    if base["noise_log_volume"] is not None and full["noise_log_volume"] is not None:
        whole = [one["laplace"] + one["noise_log_volume"] for one in (base, full)]
        less = [at - one["importance"]["log_evidence"] for at, one in zip(whole, (base, full), strict=True)]
        off = {"laplace_noise": whole[1] - whole[0], "base_off": less[0], "effect_off": less[1]}
    runs = [
        (b["log_evidence"] - a["log_evidence"], math.hypot(a["error"], b["error"]))
        for a, b in zip(base["nested"], full["nested"], strict=True)
    ]
    return off | {
        "laplace": laplace,
        "nested": runs[0][0] if runs else None,
        "nested_error": runs[0][1] if runs else None,
        "nested_again": runs[1][0] if len(runs) > 1 else None,
        "importance": full["importance"]["log_evidence"] - base["importance"]["log_evidence"],
        "importance_error": math.hypot(*(one["importance"]["error"] for one in (base, full))),
        "effective": min(one["importance"]["effective"] for one in (base, full)),
        "amplitude": value["amplitude"],
        "amplitude_sd": value["amplitude_sd"],
        "slowest_rad_s": value["slowest_rad_s"],
        "not_read": value["not_read"],
        "unknowns": full["unknowns"],
        "calls": base["calls"] + full["calls"],
    }


def reference(row: Row) -> tuple[float, float]:
    """A case's ln Bayes factor by sampling, and its error: by nested sampling, or by importance sampling [-]."""
    name = "importance" if row["nested"] is None else "nested"
    return row[name], row[f"{name}_error"]


def kind(row: Row) -> str:
    """Which of the groups of KINDS a case belongs to."""
    if row["not_read"] or row["slowest_rad_s"] < NEAR_STALL:
        return "stall"
    one_sided = effects()[row["effect"]].amplitude.low == 0.0
    return "zero" if one_sided and row["amplitude"] < NEAR_ZERO * row["amplitude_sd"] else "other"


KINDS = {
    "stall": f"a level that stalls, or turns at less than {NEAR_STALL:g} rad/s",
    "zero": f"no such level; a one-sided amplitude found within {NEAR_ZERO:g} sds of 0",
    "other": "all others",
}


def summary(rows: Rows, first_seed: int, code: str) -> dict[str, Any]:
    """How far Laplace is off, by group.

    `rows`: a case each; the figures None where it failed.
    Returns ``groups`` and ``all``, each with its counts, how nested and importance sampling agree, and what it was made
    with.
    """
    made = [row for row in rows if row["laplace"] is not None]
    both = [row for row in made if row["nested"] is not None]
    twice = [row["nested_again"] - row["nested"] for row in both if row["nested_again"] is not None]
    against = [
        (row["nested"] - row["importance"]) / math.hypot(row["nested_error"], row["importance_error"]) for row in both
    ]
    return {
        "format": "evidence/1",
        "cases": len(rows),
        "failed": len(rows) - len(made),
        "errors": {row["name"]: row["error"] for row in rows if row["error"]},
        "nested": len(both),
        "all": _of_group(made),
        "groups": {name: _of_group([row for row in made if kind(row) == name]) for name in KINDS},
        "nested_less_importance": _spread([row["nested"] - row["importance"] for row in both]),
        "the_same_in_errors": _spread(against),
        "nested_again_less_nested": _spread(twice),
        "nested_error": _median([row["nested_error"] for row in both]),
        "importance_error": _median([row["importance_error"] for row in made]),
        "effective": _median([row["effective"] for row in made]),
        "seconds_median": _median([row["seconds"] for row in rows]),
        "first_seed": first_seed,
        "sources_sha256": code,
    }


def _of_group(rows: Rows) -> dict[str, Any]:
    off = np.array([row["laplace"] - reference(row)[0] for row in rows])
    error = np.array([reference(row)[1] for row in rows])
    own = np.array([row[which] for row in rows for which in ("base_off", "effect_off") if row[which] is not None])
    if not rows:
        return {"cases": 0}
    return {
        "cases": len(rows),
        "within": int(np.sum(np.abs(off) <= AGREE)),
        "within_errors": int(np.sum(np.abs(off) <= np.maximum(AGREE, 2.0 * error))),
        "median": float(np.median(off)),
        "rms": float(np.sqrt(np.mean(off**2))),
        "largest": float(off[np.argmax(np.abs(off))]),
        "own": len(own),
        "own_within": int(np.sum(np.abs(own) <= AGREE)),
        "smaller": int(np.sum(off < -AGREE)),
        "larger": int(np.sum(off > AGREE)),
    }


def _spread(values: Sequence[float]) -> dict[str, Any] | None:
    if not values:
        return None
    found = np.array(values)
    return {"number": found.size, "mean": float(found.mean()), "rms": float(np.sqrt(np.mean(found**2)))}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
