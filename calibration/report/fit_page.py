"""The report of a fit."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from calibration.fit import Fit
from calibration.posterior import Posterior


def report(found: Fit, variants: list[tuple[str, Posterior]]) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``."""
    return {}


def table(found: Fit) -> Table:
    """The unknowns, for the terminal."""
    shown = Table("parameter", "unit", "mean", "sd", "5 %", "50 %", "95 %", "sd/prior")
    for e in found.posterior.estimates:
        q: Any = e.quantiles
        shown.add_row(
            e.unknown.name,
            e.unknown.unit,
            f"{e.mean:.5g}",
            f"{e.sd:.2g}",
            *(f"{q[k]:.5g}" for k in ("q05", "q50", "q95")),
            f"{e.sd_of_prior:.2f}",
        )
    return shown


def remarks(found: Fit) -> list[str]:
    """What a person should know beside the table, in sentences."""
    return list(found.measured.notes)
