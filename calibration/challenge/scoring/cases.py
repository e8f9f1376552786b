"""A line a case: for the list of what failed, and for the table of all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from calibration.challenge.scoring import judging
from calibration.challenge.scoring.judging import ASTRAY, MISSED, NONE, WRONG, Case
from calibration.work import many_table


def failures(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Every wrong name and every other verdict against the truth, worst first."""
    order = {WRONG: 0, judging.FAILED: 1, ASTRAY: 2, judging.ALARM: 3, judging.PART: 4, MISSED: 5, judging.REFUSED: 6}
    wrong = [case for case in cases if case.outcome in order]
    return [row(case) for case in sorted(wrong, key=lambda c: (order[c.outcome], -(c.size or 0.0), c.name))]


def row(case: Case) -> dict[str, Any]:
    """A case in a line."""
    found = case.diagnosis or {}
    signatures = case.signatures or {}
    sets = judging.listed_sets(found) if case.verdict == "confounded" else [case.named] if case.named else []
    return {
        "case": case.name,
        "group": case.group,
        "concealed": " + ".join(sorted(case.truth["ids"])) or NONE,
        "with_transients": case.truth.get("with_transients"),
        "misdeclared": case.truth.get("misdeclared"),
        "D": case.size,
        "rho": signatures.get("rho"),
        "rival": _text(signatures.get("rival")),
        "rival_form": signatures.get("form"),
        "separable": case.separable,
        "verdict": case.verdict,
        "said": " or ".join(" + ".join(sorted(one)) or "nothing" for one in sets),
        "set_probability": found.get("set_probability"),
        "p_value": (found.get("mismatch") or {}).get("p_value"),
        "outcome": case.outcome,
        "why": case.error or found.get("why", ""),
        "seconds": case.seconds,
    }


def as_csv(cases: Sequence[Case]) -> bytes:
    """A line a case."""
    rows = [row(case) for case in cases]
    return many_table.as_csv(rows, dict.fromkeys(rows[0] if rows else ["case"], many_table.TEXT))


def _text(value: Any) -> str:
    if not value:
        return ""
    return value if isinstance(value, str) else " + ".join(value)
