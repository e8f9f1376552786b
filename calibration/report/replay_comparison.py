"""A replayed run beside the model that was driven with its pressure: speed and flow in time, and what is left over."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from calibration.report import style
from model.layout import L_MIN, RPM
from model.operation.replayed import Simulated

if TYPE_CHECKING:
    from rich.table import Table


class Measured(Protocol):
    """What a run measured: `rig.replay.channels.Measured`."""

    @property
    def speed_time_s(self) -> np.ndarray: ...

    @property
    def speed_rad_s(self) -> np.ndarray: ...

    @property
    def flow_time_s(self) -> np.ndarray: ...

    @property
    def flow_m3_s(self) -> np.ndarray: ...


@dataclass(frozen=True)
class Residuals:
    """Readings less the simulated values at their times.

    `time_s`, `measured`, `simulated`, shape (n,): time [s], and values in the unit.
    """

    name: str
    unit: str
    time_s: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Measured less simulated, shape (n,), in the unit."""
        return self.measured - self.simulated


def compare(measured: Measured, simulated: Simulated) -> list[Residuals]:
    """Speed and flow at the times of their readings. Of the channels with anything to compare, which may be none."""
    found = []
    for name, unit, factor, time_s, values, modelled in (
        ("speed", "rpm", RPM, measured.speed_time_s, measured.speed_rad_s, simulated.speed_rad_s),
        ("flow", "L/min", L_MIN, measured.flow_time_s, measured.flow_m3_s, simulated.flow_m3_s),
    ):
        inside = (time_s >= simulated.time_s[0]) & (time_s <= simulated.time_s[-1])
        if not inside.any():
            continue
        at = np.interp(time_s[inside], simulated.time_s, modelled)
        known = np.isfinite(at)
        if not known.any():  # the flow of a vented line
            continue
        found.append(Residuals(name, unit, time_s[inside][known], values[inside][known] * factor, at[known] * factor))
    return found


def table(compared: list[Residuals]) -> Table:
    """Mean and scatter of what is left over."""
    from rich.table import Table

    made = Table("channel", "readings", "mean of measured less simulated", "root mean square", "largest")
    for one in compared:
        left = one.residual
        figures = (np.mean(left), np.sqrt(np.mean(left**2)), left[np.argmax(np.abs(left))])
        made.add_row(one.name, str(left.size), *(f"{figure:+.3g} {one.unit}" for figure in figures))
    return made


def report(name: str, simulated: Simulated, compared: list[Residuals]) -> dict[str, bytes]:
    """The picture and its figures, file name to content."""
    return {"replay.png": picture(name, simulated, compared), "replay.csv": figures(compared)}


def picture(name: str, simulated: Simulated, compared: list[Residuals]) -> bytes:
    """Measured and simulated speed and flow against time, and the residuals; a PNG file."""
    lines = {"speed": simulated.speed_rad_s * RPM, "flow": simulated.flow_m3_s * L_MIN}
    rows = 2 * len(compared)
    with style.drawing(rows, 1, height_in=2.1 * rows, sharex=True, squeeze=False) as (figure, axes):
        for i, one in enumerate(compared):
            upper, lower = axes[2 * i, 0], axes[2 * i + 1, 0]
            upper.plot(simulated.time_s, lines[one.name], label="model", **style.series(1))
            upper.plot(one.time_s, one.measured, ".", color=style.INK, markersize=2, label="measured")
            lower.plot(one.time_s, one.residual, ".", color=style.INK, markersize=2)
            lower.axhline(0.0, color=style.FAINT, linewidth=0.8)
            upper.set_ylabel(style.label(one.name, one.unit))
            lower.set_ylabel(style.label("measured - model", one.unit))
            if i == 0:
                upper.legend(loc="best")
        axes[0, 0].set_title(style.plain(name))
        axes[-1, 0].set_xlabel(style.label("time of the run", "s"))
        return style.png(figure)


def figures(compared: list[Residuals]) -> bytes:
    """Every reading with its simulated value as CSV."""
    text = io.StringIO()
    text.write("channel,unit,time_s,measured,simulated,residual\n")
    for one in compared:
        for at, read, modelled in zip(one.time_s, one.measured, one.simulated, strict=True):
            text.write(f"{one.name},{one.unit},{at:.6f},{read:.6g},{modelled:.6g},{read - modelled:.6g}\n")
    return text.getvalue().encode()
