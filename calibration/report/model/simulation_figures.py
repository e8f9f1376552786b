"""The plots of `spinbench simulate`: where the power goes, a sweep, a run in time."""

from __future__ import annotations

from collections.abc import Sequence

from calibration.report import style
from model import layout as at
from model.operation.performance import OperatingPoint
from model.solvers.transient import Transient


def sweep_plot(points: Sequence[OperatingPoint], limit_rpm: float) -> bytes:
    """Speed and flow against pressure, a PNG file.

    `limit_rpm`: the manufacturer's limit, drawn where the speeds come near [rpm].
    """
    pressure = [point.pressure_bar_abs for point in points]
    speed = [point.speed_rpm for point in points]
    with style.drawing(2, 1, height_in=5.2, sharex=True) as (figure, (upper, lower)):
        upper.plot(pressure, speed, marker=".", **style.series(0))
        if max(speed) > 0.8 * limit_rpm:
            upper.axhline(limit_rpm, color=style.INK, linewidth=0.8)
            upper.text(pressure[0], limit_rpm, "manufacturer's limit", va="bottom", fontsize=8.5)
        lower.plot(pressure, [point.flow_l_min for point in points], marker=".", **style.series(0))
        upper.set_ylabel(style.label("speed", "rpm"))
        style.name_axes(lower, ("absolute inlet pressure", "bar"), ("inlet flow", "L/min"))
        for axes in (upper, lower):
            axes.set_ylim(0, None)
        return style.png(figure)


def transient_plot(run: Transient) -> bytes:
    """Speed against time, a PNG file."""
    with style.drawing() as (figure, axes):
        axes.plot(run.time_s, run.speed_rad_s * at.RPM, **style.series(0))
        axes.set_xlim(run.time_s[0], run.time_s[-1])
        if run.speed_rad_s.min() < 0.0:  # trapped air pushes the rotor back before it rests
            axes.axhline(0.0, color=style.FAINT, linewidth=0.8)
        else:
            axes.set_ylim(0, None)
        style.name_axes(axes, ("time", "s"), ("speed", "rpm"))
        return style.png(figure)


def power_plot(point: OperatingPoint) -> bytes:
    """Where the power of the compressed air goes at one point, a PNG file."""
    losses = (
        ("f_overall friction", point.f_overall_loss_w),
        ("roller friction", point.roller_loss_w),
        ("blow-down, filling, heat", point.blow_down_loss_w),
        ("outlet pressure drop", point.outlet_drop_loss_w),
        ("inlet pressure drop", point.inlet_drop_loss_w),
        ("(added by the torque reading)", -point.torque_reading_surplus_w),
    )
    with style.drawing(height_in=2.9) as (figure, axes):
        names, watts = zip(*losses, strict=True)
        bars = axes.barh(names[::-1], watts[::-1], color=style.COLOURS[0], height=0.6)
        axes.bar_label(bars, fmt="%.1f", padding=3)
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.12)
        axes.axvline(0.0, color=style.FAINT, linewidth=0.8)
        axes.set_title(f"{point.pressure_bar_abs:g} bar: {point.isentropic_power_w:.1f} W isentropic power")
        axes.set_xlabel(style.label("power taken", "W"))
        return style.png(figure)
