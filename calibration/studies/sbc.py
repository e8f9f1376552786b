"""Simulation-based calibration of the whole fit: draw from the prior, simulate a recording, fit it, rank the truth.

If the fit is right, the rank of the truth among posterior draws is uniform for every unknown (Talts et al. 2018,
arXiv:1804.06788). Each simulated recording has the plateaus, instruments and priors of the published sweep, its true
pressures drawn anew; noise, rounding, offsets, scales and single bad readings are drawn as the likelihood says.

    python -m calibration.studies.sbc --fits 300 -o out/sbc      # resumable: a fit that is there is not made again
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import Any

import numpy as np

from calibration.studies.campaigns import Row, Rows, Study, StudyError, main, whole_number
from calibration.work.many import Item
from rig.recording.files import json_bytes

DRAWS = 127  # posterior draws that a truth is ranked among: 128 possible ranks
SETTINGS = {"effective_samples": 2000, "most_steps": 1500, "times_tau": 12.0}
PRESSURES_BAR = (1.3, 2.3)  # true pressures of the simulated plateaus
PLATEAUS = 7
FITS = 300


def simulate_and_rank(seed: int, **changed: float) -> dict[str, Any]:
    """One recording from the prior, its fit, and the rank of each truth.

    Returns ``seed``, ``converged``, ``ranks`` (unknown to rank, 0..127), ``scores`` (the truth's distance from the mean
    in posterior sds), ``truth`` and ``inside`` (whether the central 50 and 90 % intervals of f_overall hold it).
    """
    from calibration.fit import fit, proposed
    from calibration.fit.sampling import Settings

    rng = np.random.default_rng(seed)
    recording, truth = simulated_recording(rng)
    _, _, likelihood = fit.prepare(recording)
    settings = Settings(seed=seed, **{**SETTINGS, **changed})  # type: ignore[arg-type]
    chain = proposed.draw(likelihood, settings)
    flat = chain.flat()
    drawn = flat[rng.choice(len(flat), DRAWS, replace=False)]
    names = [unknown.name for unknown in likelihood.unknowns]
    f = flat[:, names.index("f_overall")]
    inside = {
        str(level): bool(np.quantile(f, 0.5 - level / 200) < truth["f_overall"] < np.quantile(f, 0.5 + level / 200))
        for level in (50, 90)
    }
    ranks = {name: int(np.sum(drawn[:, i] < truth[name])) for i, name in enumerate(names)}
    scores = {name: float((truth[name] - flat[:, i].mean()) / flat[:, i].std()) for i, name in enumerate(names)}
    found = {"seed": seed, "converged": chain.converged, "ranks": ranks, "scores": scores}
    return found | {"truth": truth, "inside": inside}


def simulated_recording(rng: np.random.Generator) -> tuple[Any, dict[str, float]]:
    """A recording drawn from the prior predictive distribution.

    Returns `recording`: like the published sweep, with readings of its own; it is nowhere on disk; `truth`: the
    standard normal number of each unknown [-].
    """
    import configs
    from calibration.fit import fit
    from calibration.likelihood.bad_reading import BAD, BAD_SHARE, BAD_WIDTH
    from calibration.unknowns import priors
    from configs.units import BAR
    from model.layout import L_MIN, RPM
    from model.solvers import steady
    from rig.recording import Column, read_recording

    template = read_recording(configs.FOLDER.parent / "logs" / "published_sweep")
    motor, _, machinery = fit.prepare(template)
    z = priors.draw(machinery.unknowns, rng, 1)
    parameters, errors = machinery.split(z)
    true = np.sort(rng.uniform(*PRESSURES_BAR, PLATEAUS))
    P = true * BAR
    state = steady.unpack(steady.solve(parameters, motor.readings.vector(), P[None, :], steady.gas_table(motor, P)))
    names = ("pressure_bar_abs", "flow_l_min", "speed_rpm")
    columns = {}
    for i, (name, exact) in enumerate(
        zip(names, (true, state.flow_m3_s[0] * L_MIN, state.speed_rad_s[0] * RPM), strict=True)
    ):
        figures = template.channels[name]
        offset, scale, noise_scale = errors[0, i]
        shown = exact * (1.0 + scale) + offset
        sd = np.full(PLATEAUS, figures.noise_sd * noise_scale)
        good = np.hypot(sd, figures.resolution / np.sqrt(12.0))
        bad = rng.uniform(size=PLATEAUS) < BAD
        sd = np.where(bad, BAD_WIDTH * good + BAD_SHARE * np.abs(shown), sd)
        reading = np.round((shown + sd * rng.standard_normal(PLATEAUS)) / figures.resolution) * figures.resolution
        censor = np.zeros(PLATEAUS, dtype=np.int8)
        if name == "speed_rpm":
            censor[reading <= 0.0] = -1
            reading = np.maximum(reading, 0.0)
        columns[name] = Column(reading, censor)
    file = dataclasses.replace(template.files[0], rows=PLATEAUS, columns=columns, direction=None, extra={})
    recording = dataclasses.replace(template, files=(file,), sha256="simulated")
    truth = {unknown.name: float(z[0, i]) for i, unknown in enumerate(machinery.unknowns)}
    return recording, truth


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every fit of a campaign."""
    return [Item(f"fit-{seed}", seed, code) for seed in range(given.first_seed, given.first_seed + given.fits)]


def summary(rows: Rows, first_seed: int, _code: str) -> dict[str, Any]:
    """Uniformity of the ranks and coverage of f_overall's intervals.

    Returns fits, the share converged, coverage with its binomial 95 % interval, and for every unknown the p-value of a
    Kolmogorov-Smirnov test of its ranks against uniform; beside it that of the drawn truths against the prior, for
    ranks of what a recording does not inform are the luck of the draw. Raises StudyError when no fit was made at all.
    """
    from scipy import stats

    results = _made(rows)
    if not results:
        raise StudyError(f"none of the {len(rows)} fits was made; the first says: {rows[0]['error']}")
    n = len(results)
    coverage = {}
    for level in ("50", "90"):
        hits = sum(result["inside"][level] for result in results)
        low, high = stats.binomtest(hits, n).proportion_ci(0.95)
        coverage[level] = {"share": hits / n, "low": float(low), "high": float(high)}
    rng = np.random.default_rng(0)  # ranks are whole numbers; spread within their step before the continuous test
    uniform = {
        name: float(stats.kstest([(r["ranks"][name] + rng.uniform()) / (DRAWS + 1) for r in results], "uniform").pvalue)
        for name in results[0]["ranks"]
    }
    return {
        "fits": n,
        "converged": sum(result["converged"] for result in results) / n,
        "coverage_of_f_overall": coverage,
        "uniformity_p_value": uniform,
        "smallest_p_value": min(uniform.values()),
        "truths_p_value": {
            name: float(stats.kstest([r["truth"][name] for r in results], "norm").pvalue) for name in uniform
        },
        "settings": SETTINGS,
        "first_seed": first_seed,
        "failed": len(rows) - n,
    }


def documents(found: Row, rows: Rows) -> dict[str, bytes]:
    """The result as a document and a picture, by file name."""
    return {"sbc.json": json_bytes(found), "sbc_ranks.png": rank_plot(_made(rows))}


def rank_plot(results: Rows) -> bytes:
    """PNG of the rank histograms, one panel an unknown, with the band that holds 99 % of uniform histograms' bars."""
    from scipy import stats

    from calibration.report import style

    names = list(results[0]["ranks"])
    bins, n = 16, len(results)
    low, high = stats.binom.ppf([0.005, 0.995], n, 1.0 / bins)
    rows = -(-len(names) // 4)
    with style.drawing(rows, 4, height_in=1.7 * rows, sharex=True, sharey=True) as (figure, axes):
        for axis in axes.flat[len(names) :]:
            axis.set_visible(False)
        for axis, name in zip(axes.flat, names, strict=False):
            ranks = [result["ranks"][name] for result in results]
            axis.axhspan(low, high, color="#DDDDDD")
            axis.hist(ranks, bins=bins, range=(0, DRAWS + 1), color=style.COLOURS[0])
            axis.set_title(name, fontsize=9)
            axis.set_xlabel(f"rank of the truth (0-{DRAWS})", fontsize=8)
        axes.flat[0].set_ylabel("fits", fontsize=8)
        return style.png(figure)


def _made(rows: Rows) -> Rows:
    return [row for row in rows if not row["error"]]


STUDY = Study(
    name="sbc",
    words=__doc__,
    roots=("calibration.studies.sbc", "calibration.fit.fit"),
    task=simulate_and_rank,
    items=items_of,
    first_seed=100_000,
    options={
        "--fits": {"type": whole_number, "default": FITS, "help": "recordings drawn and fitted (%(default)s)"},
    },
    summary=summary,
    documents=documents,
    told=lambda found: json_bytes(found).decode().rstrip(),
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
