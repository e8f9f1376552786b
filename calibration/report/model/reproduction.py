"""The report of `spinbench reproduce`: figures, and the article's results beside ours, for eyes and for programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from calibration.report.model.paper_figures import CAPTIONS, draw_all
from calibration.report.render import render
from configs.units import BAR
from model.article.comparison import Comparison, compare
from model.article.reproduction import FRICTIONS, Reproduction
from model.solvers.published import TIME_STEP
from rig.recording.files import json_bytes

FORMAT = "reproduction/1"
JSON, HTML, PAGE = "reproduce.json", "reproduce.html", "reproduce.md"


def report(found: Reproduction, lap_deg: float) -> dict[str, bytes]:
    """Everything but the Markdown page.

    `lap_deg`: port lap of the motor, for the shading of Fig. 13 [deg].
    Returns PNG files, reproduce.json and reproduce.html by file name.
    """
    files = {f"{name}.png": content for name, content in draw_all(found, lap_deg).items()}
    return files | {
        JSON: json_bytes(tables(found)),
        HTML: _rendered("reproduction.html.j2", found, ""),
    }


def page(found: Reproduction, figures: str) -> bytes:
    """The Markdown page. `figures`: folder of the figures, relative to the page; empty when they are beside it."""
    return _rendered("reproduction.md.j2", found, f"{figures}/" if figures else "")


def tables(found: Reproduction) -> dict[str, Any]:
    """The tables as reproduction/1, units in the keys."""
    return {
        "format": FORMAT,
        "comparisons": [_comparison(one) for one in compare(found)],
        "plateaus": _plateaus(found),
        "steps": [asdict(row) for row in found.step_rows],
        "flow_peaks": [
            {
                "time_step_s": row.time_step_s,
                "outlet_peak_kg_s": row.outlet_peak,
                "outlet_lowest_kg_s": row.outlet_lowest,
                "inlet_peak_kg_s": row.inlet_peak,
                "inlet_mean_kg_s": row.inlet_mean,
            }
            for row in found.peak_rows
        ],
        "steady_speed_rpm": found.steady_rpm,
        "friction": {
            "pressure_bar_abs": _list(found.sweep_pa / BAR),
            "f_overall_n_m_s": list(FRICTIONS),
            "speed_rpm": found.friction_rpm.round(4).tolist(),
        },
        "diameter": {
            "pressure_bar_abs": _list(found.sweep_pa / BAR),
            "cylinder_diameter_mm": _list(found.diameters_mm),
            "speed_rpm": found.diameter_rpm.round(4).tolist(),
        },
    }


def _comparison(one: Comparison) -> dict[str, Any]:
    return asdict(one) | {"difference": one.difference}


def _plateaus(found: Reproduction) -> list[dict[str, float]]:
    """Table 3 beside the model, a row a plateau."""
    if found.measured is None:
        return []
    columns = {
        "pressure_bar_abs": found.measured.pressure_pa / BAR,
        "measured_speed_rpm": found.measured.speed_rpm,
        "averaged_speed_rpm": found.plateau_march_rpm,
        "steady_speed_rpm": found.plateau_rpm,
        "measured_flow_l_min": found.measured.flow_l_min,
        "flow_l_min": found.plateau_flow_l_min,
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*map(_list, columns.values()), strict=True)]


def _list(values: Any) -> list[float]:
    return [round(float(value), 6) for value in values]


def _rendered(template: str, found: Reproduction, figures: str) -> bytes:
    filled = {
        "comparisons": compare(found),
        "plateaus": _plateaus(found),
        "steps": found.step_rows,
        "peaks": found.peak_rows,
        "time_step": TIME_STEP,
        "steady": found.steady_rpm,
        "captions": CAPTIONS,
        "figures": figures,
        "number": number,
        "difference": difference,
        "published": published,
    }
    return render(template, filled)


def number(value: float) -> str:
    """A figure to four significant digits, without an exponent; a zero is a plain 0."""
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def difference(one: Comparison) -> str:
    """Ours less the published figure, with its sign, to two significant digits; 0 inside a published range."""
    return f"{one.difference:+.2g}" if one.difference else "0"


def published(one: Comparison) -> str:
    """The published figure or range in words."""
    low, high = number(one.published_low), number(one.published_high)
    return low if low == high else f"{low} to {high}"
