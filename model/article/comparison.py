"""The article's printed results beside ours, each difference with its reason in one sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.article.reproduction import DIAMETER, FRICTIONS, GROWTH, Reproduction
from model.solvers.published import TIME_STEP


@dataclass(frozen=True)
class Comparison:
    """One printed result.

    `quantity`, `unit`: what is compared.
    `published_low`, `published_high`: as printed; the same figure twice where the article gives no range.
    `ours`: computed here.
    `why`: the reason of the difference, in one sentence.
    """

    quantity: str
    unit: str
    published_low: float
    published_high: float
    ours: float
    why: str

    @property
    def difference(self) -> float:
        """Ours less the published figure; 0 inside a published range."""
        return self.ours - min(max(self.ours, self.published_low), self.published_high)


def compare(found: Reproduction) -> tuple[Comparison, ...]:
    """Every result that the article prints in words, beside ours, in the article's order.

    `found`: what was computed.
    """
    return (_speed(found), *_best_friction(found), _friction_step(found), _growth(found), *_flows(found))


def _speed(found: Reproduction) -> Comparison:
    ours = found.run.mean_speed_rpm
    return Comparison(
        "speed at 2.0 bar, averaged over steps 5000-9000 (Fig. 9)",
        "rpm",
        395.0,
        395.0,
        ours,
        'The article rounds ("around 395"); '
        f"the steady speed is {found.steady_rpm:.1f} rpm, of which the average lacks "
        f"{100.0 * (1.0 - ours / found.steady_rpm):.1f} %, most of it unfinished spin-up.",
    )


def _best_friction(found: Reproduction) -> list[Comparison]:
    if found.measured is None or found.best_friction is None:
        return []
    miss = found.plateau_friction_rpm - found.measured.speed_rpm
    rms = ", ".join(f"{value:.1f}" for value in np.sqrt(np.mean(miss**2, axis=1)))
    return [
        Comparison(
            "f_overall that fits the speeds of Table 3 best (Fig. 11)",
            "N m s",
            FRICTIONS[0],
            FRICTIONS[0],
            found.best_friction,
            "The article chose among three values by eye; with "
            f"{', '.join(f'{f:.4f}' for f in FRICTIONS)} the root-mean-square miss is {rms} rpm here, "
            "at a port lap that was assumed to make 0.0625 fit speeds and flows.",
        )
    ]


def _friction_step(found: Reproduction) -> Comparison:
    loss = found.friction_rpm[1] - found.friction_rpm[2]
    return Comparison(
        "speed lost from f_overall 0.0633 to 0.0640, mean over Table 3's pressures (Fig. 11)",
        "rpm",
        3.0,
        4.0,
        float(loss.mean()),
        f"The loss goes with the speed, from {loss.min():.1f} rpm at 1.6 bar to {loss.max():.1f} rpm at 2.0 bar; "
        "the text's step of 0.007 can only be 0.0007 (erratum 6).",
    )


def _growth(found: Reproduction) -> Comparison:
    gain = found.diameter_rpm[-1] - found.diameter_rpm[0]
    return Comparison(
        f"speed gained from {DIAMETER:.3f} to {DIAMETER + GROWTH:.3f} mm cylinder diameter, mean over Table 3's "
        "pressures (Fig. 12)",
        "rpm",
        50.0,
        50.0,
        float(gain.mean()),
        f"The article rounds; the gain grows from {gain.min():.0f} rpm at "
        f"1.6 bar to {gain.max():.0f} rpm at 2.0 bar, and goes on growing with the diameter: 25.8 mm is the largest "
        "tried, not an optimum.",
    )


def _flows(found: Reproduction) -> tuple[Comparison, ...]:
    printed = next(row for row in found.peak_rows if row.time_step_s == TIME_STEP)
    coarse = found.peak_rows[-1]
    return (
        Comparison(
            "peak outlet flow of all seven cylinders (Fig. 14)",
            "kg/s",
            0.02,
            0.02,
            printed.outlet_peak,
            "A blow-down is one step long in this model, so its peak is the mass over the step: half the step doubles "
            f"it, and {coarse.time_step_s * 1e6:.0f} µs give {coarse.outlet_peak:.3f} kg/s, as would a plot "
            "of the mean of every four steps.",
        ),
        Comparison(
            "peak outlet flow over peak inlet flow (Fig. 14)",
            "1",
            5.0,
            5.0,
            printed.outlet_peak / printed.inlet_peak,
            "The inlet's peak, the filling of one clearance, is one step long too and shares the dependence: "
            f"{coarse.outlet_peak / coarse.inlet_peak:.1f} at {coarse.time_step_s * 1e6:.0f} µs; which inlet flow "
            f"the article means is not said (over the mean one it is {printed.outlet_peak / printed.inlet_mean:.0f}).",
        ),
        Comparison(
            "lowest outlet flow over mean inlet flow (Fig. 14)",
            "1",
            0.5,
            0.5,
            printed.outlet_lowest / printed.inlet_mean,
            "The article rounds to a half; between blow-downs the flow is the pistons' displacement alone, and the "
            "figure does not depend on the step.",
        ),
    )
