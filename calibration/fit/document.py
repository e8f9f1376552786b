"""A fit as posterior/1."""

from __future__ import annotations

from typing import Any

from calibration.data import rows_used
from calibration.data.dates import as_text
from calibration.fit import posterior
from calibration.fit.fit import Fit
from calibration.fit.whole import WholeFit
from calibration.systems.several.comparison import Several


def as_json(found: Fit | WholeFit) -> dict[str, Any]:
    """A fit as a mapping."""
    if isinstance(found, Fit):
        return posterior.as_json(found.posterior, found.quality, rows_used.by_fit(found.recording, found.measured))
    told = posterior.as_json(found.posterior, found.quality, found.comparison.rows_used())
    if not isinstance(found.comparison, Several):
        return told
    problem = found.comparison.problem
    days = [{"recording": day, "date": as_text(problem.dates[day])} for day in problem.along_dates()]
    return told | {"recordings": days}
