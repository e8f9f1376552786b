"""Shares of cases with exact intervals, and how stated probabilities keep what they promise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

LEVEL = 0.95
BINS = 10


def clopper_pearson(hits: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Exact binomial interval of a share; (0, 1) where there is nothing to count."""
    from scipy.stats import beta

    tail = (1.0 - level) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(1.0 - tail, hits + 1, n - hits))
    return low, high


def share(hits: Iterable[bool]) -> dict[str, Any]:
    """How many of how many, with the interval."""
    counted = [bool(hit) for hit in hits]
    k, n = sum(counted), len(counted)
    low, high = clopper_pearson(k, n)
    return {"hits": k, "n": n, "share": k / n if n else None, "low": low, "high": high}


def reliability(stated: Sequence[float], hits: Sequence[bool]) -> dict[str, Any]:
    """Stated probability against hit rate.

    Returns ``bins`` (those that hold anything: edges, the mean of what was stated, the share that came true), ``brier``
    (the mean squared error) and ``ece`` (the mean distance of both over the bins, weighed by their cases); None without
    cases.
    """
    if not len(stated):
        return {"n": 0, "bins": [], "brier": None, "ece": None}
    p, hit = np.clip(np.asarray(stated, dtype=float), 0.0, 1.0), np.asarray(hits, dtype=bool)
    at = np.minimum((p * BINS).astype(int), BINS - 1)
    bins = []
    for i in range(BINS):
        mine = at == i
        if mine.any():
            bins.append({"from": i / BINS, "to": (i + 1) / BINS, "stated": float(p[mine].mean()), **share(hit[mine])})
    ece = sum(one["n"] * abs(one["stated"] - one["share"]) for one in bins) / p.size
    return {"n": int(p.size), "bins": bins, "brier": float(np.mean((p - hit) ** 2)), "ece": float(ece)}


def half_width_50(sd: float) -> float:
    """Half of a normal's central 50 % interval. `sd`: standard deviation [any]."""
    return 0.6744897501960817 * sd
