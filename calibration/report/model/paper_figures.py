"""The article's figures in our plot style, drawn from what `model.article.reproduction` computed."""

from __future__ import annotations

import numpy as np

from calibration.report import style
from configs.units import BAR
from model import layout as at
from model.article.reproduction import FRICTIONS, Reproduction

PRESSURE = ("absolute inlet pressure", "bar")
SPEED = ("speed", "rpm")

# File name (without suffix) and caption, in the order of the article.
CAPTIONS = {
    "fig05_volume": "Fig. 5: volume of one cylinder over one turn, four lobes.",
    "fig09_spin_up": "Fig. 9: spin-up from rest at 2.0 bar, by the published steps of 75 µs and resolved in angle.",
    "fig11_friction": "Fig. 11: averaged speed against inlet pressure for three f_overall, with the points of Table 3.",
    "fig12_diameter": "Fig. 12: averaged speed against inlet pressure for cylinder diameters up to 25.8 mm.",
    "fig13_cycle": "Fig. 13: mass and pressure of one cylinder over a cycle at 2.0 bar; closed phases are shaded.",
    "fig14_flows": "Fig. 14: inlet and outlet flow of all seven cylinders at 2.0 bar; a peak lasts one step of 75 µs.",
}


def draw_all(found: Reproduction, lap_deg: float) -> dict[str, bytes]:
    """All figures. `lap_deg`: port lap, for the shading [deg]. Returns PNG files by the names of `CAPTIONS`."""
    return {
        "fig05_volume": volume(found),
        "fig09_spin_up": spin_up(found),
        "fig11_friction": friction(found),
        "fig12_diameter": diameter(found),
        "fig13_cycle": cycle(found, lap_deg),
        "fig14_flows": flows(found),
    }


def volume(found: Reproduction) -> bytes:
    """Fig. 5 as a PNG file."""
    with style.drawing() as (figure, axes):
        axes.plot(np.degrees(found.angle_rad), found.volume_m3 * 1e6, **style.series(0))
        axes.set_xlim(0, 360)
        axes.set_xticks(range(0, 361, 45))
        axes.set_ylim(0, None)
        style.name_axes(axes, ("rotor angle", "deg"), ("cylinder volume", "cm³"))
        return style.png(figure)


def spin_up(found: Reproduction) -> bytes:
    """Fig. 9 as a PNG file."""
    with style.drawing() as (figure, axes):
        run, transient = found.run, found.transient
        axes.axhline(found.steady_rpm, color=style.FAINT, linewidth=0.8)
        axes.text(
            0.005, found.steady_rpm + 5, f"steady speed {found.steady_rpm:.1f} rpm", color=style.INK, fontsize=8.5
        )
        axes.plot(
            run.time_s, run.speed_rad_s * at.RPM, label="published algorithm, 75 µs", color="#9CC9E6", linewidth=3.5
        )
        axes.plot(
            transient.time_s, transient.speed_rad_s * at.RPM, label="resolved in angle", color=style.INK, linewidth=1.0
        )
        axes.set_xlim(0, run.time_s[-1])
        axes.set_ylim(0, 1.12 * found.steady_rpm)
        axes.legend(loc="lower right")
        style.name_axes(axes, ("time", "s"), SPEED)
        return style.png(figure)


def friction(found: Reproduction) -> bytes:
    """Fig. 11 as a PNG file: speeds, and below them what is left of the measured ones."""
    with style.drawing(2, 1, height_in=5.2, sharex=True, height_ratios=(3, 1.6)) as (figure, (axes, rest)):
        for i, f in enumerate(FRICTIONS):
            axes.plot(found.sweep_pa / BAR, found.friction_rpm[i], label=f"f_overall {f:.4f} N m s", **style.series(i))
        if found.measured is not None:
            pressure = found.measured.pressure_pa / BAR
            axes.plot(pressure, found.measured.speed_rpm, label="measured (Table 3)", **style.MEASURED)
            for i in range(len(FRICTIONS)):
                miss = found.measured.speed_rpm - found.plateau_friction_rpm[i]
                rest.plot(pressure, miss, marker="o", markersize=3.5, **style.series(i))
        rest.axhline(0.0, color=style.FAINT, linewidth=0.8)
        axes.legend(loc="upper left")
        axes.set_ylabel(style.label(*SPEED))
        style.name_axes(rest, PRESSURE, ("measured less\nmodel", "rpm"))
        return style.png(figure)


def diameter(found: Reproduction) -> bytes:
    """Fig. 12 as a PNG file."""
    with style.drawing() as (figure, axes):
        for i in reversed(range(len(found.diameters_mm))):
            name = f"{found.diameters_mm[i]:.3f} mm" + (" (as built)" if i == 0 else "")
            axes.plot(found.sweep_pa / BAR, found.diameter_rpm[i], label=name, **style.series(i))
        axes.legend(title="cylinder diameter", alignment="left", loc="upper left")
        style.name_axes(axes, PRESSURE, SPEED)
        return style.png(figure)


def cycle(found: Reproduction, lap_deg: float) -> bytes:
    """Fig. 13 as a PNG file. `lap_deg`: port lap [deg]."""
    with style.drawing(2, 1, height_in=5.2, sharex=True) as (figure, (upper, lower)):
        angle = np.degrees(found.cycle.angle_rad)
        upper.plot(angle, found.cycle.mass_kg * 1e6, **style.series(0))
        lower.plot(angle, found.cycle.pressure_pa / BAR, **style.series(0))
        for axes in (upper, lower):
            for start, end in ((0.0, lap_deg), (45.0 - lap_deg, 45.0 + lap_deg), (90.0 - lap_deg, 90.0)):
                axes.axvspan(start, end, color=style.SHADE, zorder=0)
            axes.set_xlim(0, 90)
            axes.set_xticks(range(0, 91, 15))
        upper.set_ylim(0, None)
        for middle, name in ((22.5, "discharge"), (67.5, "suction")):
            upper.text(middle, 1.02, name, transform=upper.get_xaxis_transform(), ha="center", fontsize=8.5)
        upper.set_ylabel(style.label("mass in one cylinder", "mg"))
        style.name_axes(lower, ("cylinder angle", "deg"), ("pressure", "bar"))
        return style.png(figure)


def flows(found: Reproduction) -> bytes:
    """Fig. 14 as a PNG file: the whole scale, and what lies below the peaks."""
    with style.drawing(2, 1, height_in=5.2, sharex=True) as (figure, (whole, low)):
        angle = np.degrees(found.cycle.angle_rad)
        for axes in (whole, low):
            axes.plot(angle, found.cycle.outlet_kg_s * 1e3, label="outlet", color=style.COLOURS[1], linewidth=1.0)
            axes.plot(angle, found.cycle.inlet_kg_s * 1e3, label="inlet", color=style.COLOURS[0], linewidth=1.0)
            axes.set_xlim(0, 90)
            axes.set_xticks(range(0, 91, 15))
        whole.set_ylim(0, None)
        low.set_ylim(0, 5)
        whole.legend(loc="upper right", bbox_to_anchor=(1.0, 1.18), ncols=2)
        whole.set_ylabel(style.label("flow", "g/s"))
        style.name_axes(low, ("rotor angle within a lobe", "deg"), ("flow below the peaks", "g/s"))
        return style.png(figure)
