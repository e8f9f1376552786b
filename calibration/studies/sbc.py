"""Simulation-based calibration of the whole fit: draw from the prior, simulate a recording, fit it, rank the truth.

If the fit is right, the rank of the truth among posterior draws is uniform for every unknown (Talts et al. 2018,
arXiv:1804.06788). Each simulated recording has the plateaus, instruments and priors of the published sweep, its true
pressures drawn anew; noise, rounding, offsets, scales and single bad readings are drawn as the likelihood says.

    python -m calibration.studies.sbc --fits 300 -o out/sbc      # resumable: a fit that is there is not made again
"""

from __future__ import annotations

import argparse
import concurrent.futures
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

DRAWS = 127  # posterior draws that a truth is ranked among: 128 possible ranks
SETTINGS = {"effective_samples": 2000, "most_steps": 1500, "times_tau": 12.0}
PRESSURES_BAR = (1.3, 2.3)  # true pressures of the simulated plateaus
PLATEAUS = 7
FIRST_SEED = 100_000


def simulate_and_rank(seed: int, **changed: float) -> dict[str, Any]:
    """One recording from the prior, its fit, and the rank of each truth.

    Returns
    -------
    dict
        ``seed``, ``converged``, ``ranks`` (unknown to rank, 0..127), ``scores`` (the truth's distance from the mean in
        posterior sds), ``truth`` and ``inside`` (whether the central 50 and 90 % intervals of f_overall hold it).
    """
    from calibration.fit import fit, sampling
    from calibration.fit.sampling import Settings

    rng = np.random.default_rng(seed)
    recording, truth = simulated_recording(rng)
    _, _, likelihood = fit.prepare(recording)
    settings = Settings(seed=seed, **{**SETTINGS, **changed})  # type: ignore[arg-type]
    chain = sampling.sample(likelihood.log_prob, len(likelihood.unknowns), likelihood.factors, settings)
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

    Returns
    -------
    recording : rig.recording.Recording
        Like the published sweep, with readings of its own; it is nowhere on disk.
    truth : dict of str to float
        The standard normal number of each unknown [-].
    """
    import configs
    from calibration.fit import fit
    from calibration.systems.radial_piston.batch import rows
    from calibration.unknowns import priors
    from model.layout import L_MIN, RPM
    from model.solvers import steady
    from rig.recording import Column, read_recording

    template = read_recording(configs.FOLDER.parent / "logs" / "published_sweep")
    motor, _, machinery = fit.prepare(template)
    z = priors.draw(machinery.unknowns, rng, 1)
    parameters, errors = machinery.split(z)
    true = np.sort(rng.uniform(*PRESSURES_BAR, PLATEAUS))
    P = true * priors.PASCAL_PER_BAR
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
        bad = rng.uniform(size=PLATEAUS) < rows.BAD
        sd = np.where(bad, rows.BAD_WIDTH * good + rows.BAD_SHARE * np.abs(shown), sd)
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


def run_campaign(fits: int, folder: Path, workers: int) -> list[dict[str, Any]]:
    """Make the fits that are not there yet, and return all.

    Parameters
    ----------
    folder : Path
        One JSON file a fit, written whole or not at all.

    Returns
    -------
    list of dict
        Of `simulate_and_rank`, by seed.
    """
    from rig.progress import TASK, Bar, Count, Elapsed, Left, bar_of

    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(FIRST_SEED, FIRST_SEED + fits)
    missing = [seed for seed in seeds if not _place(folder, seed).exists()]
    with (
        bar_of(TASK, Bar, Count, Elapsed, Left) as bar,
        concurrent.futures.ProcessPoolExecutor(workers, initializer=_one_thread) as pool,
    ):
        task = bar.add_task("fits", total=fits, completed=fits - len(missing))
        for done in concurrent.futures.as_completed([pool.submit(_keep, folder, seed) for seed in missing]):
            done.result()
            bar.advance(task)
    return [json.loads(_place(folder, seed).read_text(encoding="utf-8")) for seed in seeds]


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Uniformity of the ranks and coverage of f_overall's intervals.

    Returns
    -------
    dict
        Fits, the share converged, coverage with its binomial 95 % interval, and for every unknown the p-value of a
        Kolmogorov-Smirnov test of its ranks against uniform; beside it that of the drawn truths against the prior, for
        ranks of what a recording does not inform are the luck of the draw.
    """
    from scipy import stats

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
        "first_seed": FIRST_SEED,
    }


def rank_plot(results: list[dict[str, Any]]) -> bytes:
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


def main() -> None:
    """Run the campaign and write ``ranks.png`` and ``summary.json`` beside the fits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--fits", type=int, default=300)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--page", type=Path, help="folder of the docs' figures: gets sbc_ranks.png and sbc.json")
    arguments = parser.parse_args()
    from calibration.work import files

    results = run_campaign(arguments.fits, arguments.out / "fits", arguments.workers)
    found = (json.dumps(summary(results), indent=1) + "\n").encode()
    picture = rank_plot(results)
    files.write_files(arguments.out, {"ranks.png": picture, "summary.json": found})
    if arguments.page:
        files.write_files(arguments.page, {"sbc_ranks.png": picture, "sbc.json": found})
    print(found.decode())


def _one_thread() -> None:
    """Workers share the cores already."""
    import numba

    numba.set_num_threads(1)


def _place(folder: Path, seed: int) -> Path:
    return folder / f"{seed}.json"


def _keep(folder: Path, seed: int) -> None:
    from calibration.work import files

    files.write_file(_place(folder, seed), json.dumps(simulate_and_rank(seed)).encode())


if __name__ == "__main__":
    main()
