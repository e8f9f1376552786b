"""What the readings of a plateau amount to: a mean, its standard error, and what is to be said of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rig.plateaus.plan import Step
from rig.plateaus.series import line_through, standard_error
from rig.readings import NS, Quality, with_error
from rig.recording.columns import OF_CHANNEL

LEAST_FOR_DRIFT = 5  # readings
CENSORED_SHARE = 0.1  # of the readings: above it the mean is a limit, and not a value


@dataclass(frozen=True)
class Mean:
    """What one channel read over a plateau.

    `mean`: in the channel's unit; None without readings. When ``censored``, the limit that the true mean lies beyond.
    `se`: standard error of the mean by scatter alone [own unit]; the instrument's own errors and its resolution are not
        in it. None from fewer than two readings, and when censored.
    `n_eff`: as many independent ones would have done as well [-].
    `censored`: -1 when the true mean is below, 1 when it is above [-].
    `drift`, `drift_se`: change over the plateau by a straight line, and its error [own unit].
    """

    mean: float | None
    se: float | None
    n: int
    n_eff: float = 0.0
    censored: int = 0
    drift: float | None = None
    drift_se: float | None = None
    qualities: dict[str, int] = field(default_factory=dict)
    note: str = ""

    @property
    def shown_censored(self) -> int:
        """``censored`` as a table holds it: a speed of 0 says by itself that it is below what can be seen [-]."""
        return 0 if self.mean == 0.0 and self.censored < 0 else self.censored

    @property
    def cell(self) -> float | str | None:
        """The mean as a table holds it: a number, or ``<10``, ``>100`` beyond the scale."""
        if self.mean is None or not self.shown_censored:
            return self.mean
        return f"{'<' if self.censored < 0 else '>'}{self.mean:.6g}"

    def cells(self, column: str) -> dict[str, Any]:
        """All that a run's table holds of it."""
        return {
            column: self.cell,
            f"{column}_se": self.se,
            f"{column}_n_eff": self.n_eff or None,
            f"{column}_n": self.n,
        }

    def text(self, unit: str) -> str:
        """The mean with its standard error, for a person."""
        if self.mean is None:
            return f"no {unit}"
        sign = {-1: "<", 0: "", 1: ">"}[self.shown_censored]
        return f"{sign}{with_error(self.mean, self.se)} {unit}"


def mean_of(
    time_s: np.ndarray, value: np.ndarray, censored: np.ndarray | None = None, quality: Sequence[Quality] = ()
) -> Mean:
    """What one channel's readings amount to.

    `time_s`, `value`, shape (n,): times [s] and values [own unit], oldest first.
    `censored`, shape (n,), or None: -1 and 1 where a reading was below or above the scale [-].
    With the limits of off-scale readings in place of their values, a mean is a bound of the true one; where more than a
    tenth were off, it is given as that.
    """
    n = int(value.size)
    qualities = dict(Counter(str(one) for one in quality))
    if n == 0:
        return Mean(None, None, 0, qualities=qualities, note="no reading")
    off = np.zeros(n, dtype=np.int64) if censored is None else censored
    below, above = int(np.sum(off < 0)), int(np.sum(off > 0))
    mean = float(value.mean())
    if below and above:
        return Mean(None, None, n, qualities=qualities, note=f"{below} readings below and {above} above the scale")
    if max(below, above) > CENSORED_SHARE * n:
        sign = -1 if below else 1
        return Mean(mean, None, n, 0.0, sign, qualities=qualities, note=_off_scale(below, above, n))
    se, n_eff = standard_error(value)
    drift, drift_se = _drift(time_s, value)
    return Mean(mean, se, n, n_eff, 0, drift, drift_se, qualities, _off_scale(below, above, n))


def _drift(time_s: np.ndarray, value: np.ndarray) -> tuple[float | None, float | None]:
    if value.size < LEAST_FOR_DRIFT or time_s[-1] <= time_s[0]:
        return None, None
    span_s = float(time_s[-1] - time_s[0])
    slope, slope_se, _ = line_through(time_s, value)
    return slope * span_s, slope_se * span_s


def _off_scale(below: int, above: int, n: int) -> str:
    if not below and not above:
        return ""
    return f"{below or above} of {n} readings {'below' if below else 'above'} the scale"


@dataclass(frozen=True)
class Plateau:
    """One plateau as it was taken.

    `start_ns`, `end_ns`: of the dwell [ns].
    `settled`: whether it had settled before; if not, ``note`` says why.
    """

    number: int
    step: Step
    start_ns: int
    end_ns: int
    settled: bool
    means: dict[str, Mean]
    note: str = ""

    def row(self, columns: Mapping[str, str]) -> dict[str, Any]:
        """The plateau as a row of the run's table; a mean beyond the scale is ``<10`` or ``>100``."""
        row: dict[str, Any] = {
            "n": self.number,
            "level_bar_abs": self.step.level_bar_abs,
            "direction": self.step.direction,
            "repeat": self.step.repeat,
            "start_s": self.start_ns / NS,
            "end_s": self.end_ns / NS,
            "settled": self.settled,
            "note": self.note,
        }
        for role, mean in self.means.items():
            if role in columns and mean.mean is not None:
                row |= mean.cells(columns[role])
        return row

    def sentence(self) -> str:
        """The plateau in one line, for a person."""
        parts = [f"{self.step.level_bar_abs:g} bar abs {self.step.direction}"]
        roles = ("pressure", "flow", "speed")
        parts += [self.means[role].text(OF_CHANNEL[role].unit) for role in roles if role in self.means]
        if not self.settled:
            parts.append("not settled")
        return ", ".join(parts)
