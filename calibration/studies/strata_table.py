"""What ranks in strata say: coverage, uniformity, Laplace's figures against emcee's, as a table and pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.challenge.intervals import share
from calibration.challenge.pages.tables import Grid, as_markdown
from calibration.studies.campaigns import Row, Rows, StudyError
from calibration.studies.strata_draw import STRATA
from rig.recording.files import json_bytes

QUANTITIES = {"f_overall": "f_overall", "size": "an effect's size", "log_likelihood": "log likelihood"}
MISSED = 3.0  # nats behind the truth, from which a search is said to have missed the most probable point
BAND, SIMULATIONS, GRID = 0.99, 4000, 40  # of the ranks' ECDF: simultaneous level, draws of it, places looked at
Keeps = Callable[[Row], bool]


def summary(rows: Rows, first_seed: int, code: str) -> dict[str, Any]:
    """Coverage and uniformity in each stratum and in parts of it, by Laplace and by emcee, and both held together.

    Returns ``strata``, each with its ``words``, counts and ``parts``; ``emcee``, the cases that both have.
    Raises StudyError when no case was made at all.
    """
    made = _made(rows)
    if not made:
        raise StudyError(f"none of the {len(rows)} cases was made; the first says: {rows[0]['error']}")
    strata = {}
    for name in dict.fromkeys(row["stratum"] for row in made):
        mine = [row for row in made if row["stratum"] == name]
        strata[name] = {
            "words": STRATA[name].words,
            "cases": len(mine),
            "failed": sum(row["error"] != "" and row["name"].rpartition("-")[0] == name for row in rows),
            "truths_drawn": sum(row["tries"] for row in mine),
            "missed": share(row["behind"] > MISSED for row in mine),
            "seconds_median": float(np.median([row["laplace"]["seconds"] for row in mine])),
            "parts": {words: _of_part(mine, keeps) for words, keeps in _parts(mine).items()},
        }
    both = [row for row in made if row["emcee"]]
    return {
        "format": "sbc_strata/1",
        "strata": strata,
        "emcee": {
            "cases": len(both),
            "without": {row["name"]: row["why"] for row in made if row["why"]},
            "seconds": float(sum(row["emcee"]["seconds"] for row in both)),
            "ranks": {name: _ranked([row["emcee"] for row in both], name) for name in QUANTITIES},
            "ranks_of_laplace": {name: _ranked([row["laplace"] for row in both], name) for name in QUANTITIES},
            "against": [one for row in both for one in _against(row)],
        },
        "seconds": float(sum(row["seconds"] for row in made)),
        "first_seed": first_seed,
        "sources_sha256": code,
        "band": BAND,
    }


def _parts(rows: Rows) -> dict[str, Keeps]:
    """Parts of a stratum: all of it, those whose search did not miss, those at a bound or not, each effect."""
    found: dict[str, Keeps] = {"all": lambda row: True}
    if any(row["behind"] > MISSED for row in rows):
        found["search not behind the truth"] = lambda row: row["behind"] <= MISSED
    if any(row["effect"] for row in rows):
        found["size at a bound"] = lambda row: row["at_bound"]
        found["size at no bound"] = lambda row: not row["at_bound"]
    for effect in dict.fromkeys(row["effect"] for row in rows if row["effect"]):
        found[effect] = lambda row, effect=effect: row["effect"] == effect  # type: ignore[misc]
    return found


def _of_part(rows: Rows, keeps: Keeps) -> dict[str, Any]:
    return {name: _ranked([row["laplace"] for row in rows if keeps(row)], name) for name in QUANTITIES}


def _ranked(results: Rows, name: str) -> dict[str, Any] | None:
    """Coverage of the central 50 and 90 % intervals, p-value of the ranks' uniformity, width; None without cases."""
    from scipy import stats

    mine = [one[name] for one in results if name in one]
    if not mine:
        return None
    ranks = np.array([one["rank"] for one in mine])
    found: dict[str, Any] = {str(p): share(np.abs(ranks - 0.5) < p / 200.0) for p in (50, 90)}
    found["uniformity_p"] = float(stats.kstest(ranks, "uniform").pvalue)
    found["mean_rank"] = float(ranks.mean())
    if "sd" in mine[0]:
        found["sd_of_prior_median"] = float(np.median([one["sd"] for one in mine]))
    return found


def _against(row: Row) -> list[dict[str, Any]]:
    """Laplace's figures of a case against emcee's: difference of means in emcee's sds, ratio of the sds [-]."""
    found = []
    for name in ("f_overall", "size"):
        if name in row["emcee"]:
            ours, theirs = row["laplace"][name], row["emcee"][name]
            found.append(
                {
                    "name": row["name"],
                    "stratum": row["stratum"],
                    "effect": row["effect"],
                    "of": name,
                    "at_bound": row["at_bound"],
                    "missed": row["behind"] > MISSED,
                    "laplace": ours,
                    "emcee": theirs,
                    "means_apart": (ours["mean"] - theirs["mean"]) / theirs["sd"],
                    "sd_ratio": ours["sd"] / theirs["sd"],
                }
            )
    return found


def table(found: Row) -> str:
    """The strata, and Laplace against emcee, as tables in Markdown."""
    head = ("stratum", "part", "of", "cases", "50 % holds it in", "90 % holds it in", "uniform p", "sd / prior's")
    rows = []
    for name, one in found["strata"].items():
        for words, part in one["parts"].items():
            for of, got in part.items():
                if got is not None:
                    rows.append((name, words, QUANTITIES[of], *_cells(got)))
    both = found["emcee"]
    for words, part in (("by emcee", both["ranks"]), ("the same by Laplace", both["ranks_of_laplace"])):
        rows += [("all sampled", words, QUANTITIES[of], *_cells(got)) for of, got in part.items() if got is not None]
    text = as_markdown(Grid("", head, rows))
    missed = [
        (name, str(one["cases"]), str(one["truths_drawn"]), str(one["missed"]["hits"]), f"{one['seconds_median']:.1f}")
        for name, one in found["strata"].items()
    ]
    text += "\n" + as_markdown(Grid("", ("stratum", "cases", "truths drawn", "searches that missed", "s each"), missed))
    for of in ("f_overall", "size"):
        mine = [one for one in both["against"] if one["of"] == of]
        if mine:
            text += f"\n{QUANTITIES[of]}, Laplace against emcee in {len(mine)} cases: {_spread(mine)}\n"
    return text


def _cells(got: Row) -> tuple[str, ...]:
    shares = [
        f"{100 * one['share']:.0f} % ({100 * one['low']:.0f} to {100 * one['high']:.0f} %)"
        for one in (got["50"], got["90"])
    ]
    width = f"{got['sd_of_prior_median']:.2g}" if "sd_of_prior_median" in got else "-"
    return (str(got["50"]["n"]), *shares, f"{got['uniformity_p']:.2g}", width)


def _spread(mine: Rows) -> str:
    apart = np.quantile([abs(one["means_apart"]) for one in mine], (0.5, 0.9, 1.0))
    ratio = np.quantile([one["sd_ratio"] for one in mine], (0.0, 0.1, 0.5, 0.9, 1.0))
    return (
        f"means {apart[0]:.2f} sd apart (median; nine in ten below {apart[1]:.2f}, at most {apart[2]:.2f}); ratio of "
        f"the sds {ratio[2]:.2f} (median; four in five within {ratio[1]:.2f} to {ratio[3]:.2f}, all within "
        f"{ratio[0]:.2f} to {ratio[4]:.2f})"
    )


def band(n: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge of the band that holds the whole ECDF of n uniform ranks in 99 % of campaigns [-].

    Source: Säilynoja, Bürkner and Vehtari 2022, arXiv:2103.10522: binomial quantiles at each place, at the level that a
    simulation asks for.

    `places`, shape (k,): where it is looked at, inside 0 to 1 [-].
    """
    from scipy.stats import binom

    rng = np.random.default_rng(0)
    ranks = np.sort(rng.uniform(size=(SIMULATIONS, n)), axis=1)
    counts = np.array([np.searchsorted(one, places, side="right") for one in ranks])
    tail = np.minimum(binom.cdf(counts, n, places), binom.sf(counts - 1, n, places)).min(axis=1)
    level = float(np.quantile(tail, 1.0 - BAND))
    return binom.ppf(level, n, places) / n, binom.isf(level, n, places) / n


def documents(found: Row, rows: Rows) -> dict[str, bytes]:
    """The result as a document, a page and pictures, by file name."""
    made = _made(rows)
    result = {
        "sbc_strata.json": json_bytes(found),
        "sbc_strata.png": ecdf_plot(made),
        "sbc_strata_coverage.png": coverage_plot(found, made),
    }
    if found["emcee"]["against"]:
        result["sbc_strata_emcee.png"] = against_plot(found["emcee"]["against"])
    return result


def ecdf_plot(results: Rows) -> bytes:
    """PNG of the ranks' ECDF less uniform, a panel a stratum, with the 99 % simultaneous band."""
    from calibration.report import style

    names = list(dict.fromkeys(row["stratum"] for row in results))
    places = np.arange(1, GRID) / GRID
    across = 2
    down = -(-len(names) // across)
    with style.drawing(down, across, height_in=2.1 * down, sharex=True, sharey=True, squeeze=False) as (figure, axes):
        for axis in axes.flat[len(names) :]:
            axis.set_visible(False)
        for axis, name in zip(axes.flat, names, strict=False):
            mine = [row["laplace"] for row in results if row["stratum"] == name]
            low, high = band(len(mine), places)
            axis.fill_between(places, low - places, high - places, color="#DDDDDD", linewidth=0)
            for i, of in enumerate(QUANTITIES):
                ranks = np.sort([one[of]["rank"] for one in mine if of in one])
                if ranks.size:
                    ecdf = np.searchsorted(ranks, places, side="right") / ranks.size
                    axis.plot([0, *places, 1], [0, *(ecdf - places), 0], label=QUANTITIES[of], **style.series(i))
            axis.set_title(f"{_label(name)}: {len(mine)} cases", fontsize=9)
        axes[-1, 0].set_xlabel("rank of the truth", fontsize=8)
        axes[0, 0].set_ylabel("ECDF less uniform", fontsize=8)
        figure.legend(
            *axes.flat[min(1, len(names) - 1)].get_legend_handles_labels(), loc="outside lower right", ncols=3
        )
        return style.png(figure)


def coverage_plot(found: Row, results: Rows) -> bytes:
    """PNG of the shares of truths inside the 50 and 90 % intervals, and of posterior widths against the prior's."""
    from calibration.report import style

    shown = [
        (name, of) for name, one in found["strata"].items() for of in ("f_overall", "size") if one["parts"]["all"][of]
    ]
    places = np.arange(len(shown))[::-1]
    with style.drawing(1, 2, height_in=0.9 + 0.28 * len(shown), sharey=True) as (figure, (covered, widths)):
        for i, level in enumerate((50, 90)):
            got = [found["strata"][name]["parts"]["all"][of][str(level)] for name, of in shown]
            middle = np.array([100.0 * one["share"] for one in got])
            ends = np.array([[100.0 * one["low"], 100.0 * one["high"]] for one in got]).T
            of_level = style.COLOURS[i]
            covered.errorbar(
                middle, places, xerr=np.abs(ends - middle), fmt="os"[i], color=of_level, label=f"{level} %"
            )
            covered.axvline(level, color=of_level, linewidth=0.8)
        for place, (name, of) in zip(places, shown, strict=True):
            sds = [row["laplace"][of]["sd"] for row in results if row["stratum"] == name and of in row["laplace"]]
            widths.plot(sds, np.full(len(sds), place), "|", color=style.COLOURS[0], alpha=0.4)
        covered.set_yticks(places, [f"{_label(name)}: {QUANTITIES[of]}" for name, of in shown])
        covered.set_xlim(0.0, 100.0)
        covered.set_xlabel("truths inside, with 95 % intervals (%)", fontsize=8)
        covered.legend(loc="lower left", fontsize=7)
        widths.set_xscale("log")
        widths.set_xlabel("sd over the prior's, each case (-)", fontsize=8)
        return style.png(figure)


def against_plot(against: Rows) -> bytes:
    """PNG of Laplace against emcee: how far the means are apart, and the ratio of the sds."""
    from calibration.report import style

    with style.drawing(1, 2, height_in=3.4, sharey=True) as (figure, axes):
        for axis, of in zip(axes, ("f_overall", "size"), strict=True):
            mine = [one for one in against if one["of"] == of]
            for i, name in enumerate(dict.fromkeys(one["stratum"] for one in against)):
                x = [one["means_apart"] for one in mine if one["stratum"] == name]
                y = [one["sd_ratio"] for one in mine if one["stratum"] == name]
                axis.plot(
                    x,
                    y,
                    "os^vDPX"[i % 7],
                    color=style.COLOURS[i % len(style.COLOURS)],
                    label=_label(name),
                    markersize=4,
                )
            axis.axhline(1.0, color=style.FAINT, linewidth=0.8)
            axis.axvline(0.0, color=style.FAINT, linewidth=0.8)
            axis.set_title(f"{QUANTITIES[of]}: {len(mine)} cases", fontsize=9)
            axis.set_xlabel("Laplace's mean less emcee's (emcee's sd)", fontsize=8)
        axes[0].set_ylabel("Laplace's sd over emcee's", fontsize=8)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return style.png(figure)


def _label(stratum: str) -> str:
    return stratum.replace("_", " ")


def _made(rows: Rows) -> Rows:
    return [row for row in rows if not row["error"]]
