"""What p-values of nulls say: rates with their intervals, a table, a page, and a picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.challenge.intervals import clopper_pearson
from calibration.challenge.pages.tables import Grid, as_markdown
from calibration.studies.campaigns import Row, Rows
from calibration.studies.nulls_draw import CORRELATION, DEGREES, MISDECLARED
from rig.recording.files import json_bytes

ALPHAS = (0.01, 0.05)
BAND = 0.99  # of a binomial count of a test that keeps its word
INTERVAL = 0.95  # Clopper-Pearson, of the rate seen
SMALLEST_SHOWN = 1e-3
IN_WORDS = {
    "declared": "Gaussian, as declared",
    "misdeclared": f"Gaussian, each channel's off by a log-normal factor of {MISDECLARED:g}",
    "correlated": f"Gaussian, correlated by {CORRELATION:g} from row to row",
    "coarse": "Gaussian, read in steps as large as it",
    "heavy": f"Student's t with {DEGREES} degrees of freedom, of the declared standard deviation",
}
RUNS = "_with_runs"


def summary(rows: Rows, first_seed: int, code: str) -> dict[str, Any]:
    """Rates and uniformity of each class.

    `rows`: a null each: ``class``, ``p_value`` (None where it failed), ``seconds``, ``error``.
    Returns ``classes``, each with its counts, and what they were made with.
    """
    classes = {}
    for name in dict.fromkeys(row["class"] for row in rows):
        mine = [row for row in rows if row["class"] == name]
        classes[name] = _of_class(mine) | {"noise": IN_WORDS[name.removesuffix(RUNS)], "with_runs": name.endswith(RUNS)}
    return {"format": "nulls/1", "classes": classes, "first_seed": first_seed, "sources_sha256": code, "band": BAND}


def binomial_band(n: int, alpha: float) -> tuple[int, int]:
    """Fewest and most of n p-values below alpha that a calibrated test gives in 99 % of campaigns [-]."""
    from scipy.stats import binom

    low, high = binom.ppf([0.5 * (1.0 - BAND), 0.5 * (1.0 + BAND)], n, alpha)
    return int(low), int(high)


def table(found: Row) -> str:
    """The classes as a table in Markdown."""
    head = ["class", "nulls", "failed"]
    for alpha in ALPHAS:
        head += [f"p below {alpha:g}", f"within {100 * BAND:g} %"]
    rows = []
    for name, one in found["classes"].items():
        cells = [name, str(one["nulls"]), str(one["failed"])]
        for alpha in ALPHAS:
            rate = one["rates"].get(f"{alpha:g}")
            cells += [_share(rate), ("yes" if rate["inside"] else "**no**") if rate else "-"]
        uniform = one["ks_p_value"]
        rows.append((*cells, "-" if uniform is None else f"{uniform:.2g}", f"{one['seconds_median']:.1f}"))
    return as_markdown(Grid("", (*head, "KS p", "s each"), rows))


def documents(found: Row, rows: Rows) -> dict[str, bytes]:
    """The result as a document, a page and a picture, by file name."""
    return {"nulls.json": json_bytes(found), "nulls.md": page(found).encode(), "nulls.png": picture(rows)}


def page(found: Row) -> str:
    """A page for the docs."""
    noises = dict.fromkeys((n.removesuffix(RUNS), one["noise"]) for n, one in found["classes"].items())
    errors = {name: one["errors"] for name, one in found["classes"].items() if one["errors"]}
    failed = "".join(f"- {name}: {count} times {words}\n" for name, e in errors.items() for words, count in e.items())
    return (
        "# How often a mismatch is seen where there is none\n\n"
        "Recordings are drawn from the model itself, every nuisance from its prior, with nothing concealed; the first "
        "steps of a diagnosis (base model, test) give each a p-value. A calibrated test gives p < 0.01 in 1 % of them "
        "and p < 0.05 in 5 %.\n\n"
        f"{table(found)}\n"
        f"Shares are of the nulls that did not fail, with {100 * INTERVAL:g} % Clopper-Pearson intervals. *Within "
        f"{100 * BAND:g} %*: the count lies in the central {100 * BAND:g} % of the binomial law of a calibrated test. "
        "*KS p*: of a Kolmogorov-Smirnov test of the p-values against uniform. *s each*: median time in a worker.\n\n"
        "![Distribution of the p-values](nulls.png)\n\n"
        "Noise by class:\n\n"
        + "".join(f"- {name}: {words}\n" for name, words in noises)
        + f"\nThe sweep goes from 1.2 to 2.4 bar in steps of 0.1 bar, up and down. Classes that end in `{RUNS}` have "
        "a spin-up and a coast-down at 2.0 bar besides; there the whole diagnosis goes on to a second look before it "
        "says consistent, which is not measured here. The test models correlated noise, not heavy-tailed noise.\n\n"
        + (f"Failed:\n\n{failed}\n" if failed else "")
        + f"Seeds: {found['first_seed']} and those after it, in each class. Sources: {found['sources_sha256'][:12]}. "
        "`python -m calibration.studies.nulls` with these numbers makes it anew; `make nulls` makes more.\n"
    )


def picture(rows: Rows) -> bytes:
    """PNG of the distribution of p by class: whole, and its small values on logarithmic axes."""
    from calibration.report import style

    kinds = [kind for kind in (False, True) if any(row["class"].endswith(RUNS) == kind for row in rows)]
    with style.drawing(len(kinds), 2, height_in=3.1 * len(kinds), squeeze=False) as (figure, axes):
        for (whole, small), with_runs in zip(axes, kinds, strict=True):
            mine = [row for row in rows if row["class"].endswith(RUNS) == with_runs]
            for axis in (whole, small):
                axis.plot([SMALLEST_SHOWN, 1.0], [SMALLEST_SHOWN, 1.0], color=style.FAINT, linewidth=0.8)
                style.name_axes(axis, ("p-value", "1"), ("share below it", "1"))
            for i, name in enumerate(dict.fromkeys(row["class"] for row in mine)):
                p = np.sort([row["p_value"] for row in mine if row["class"] == name and row["p_value"] is not None])
                if not p.size:
                    continue
                share = np.arange(1, p.size + 1) / p.size
                label = name.removesuffix(RUNS)
                whole.step([0.0, *p, 1.0], [0.0, *share, 1.0], where="post", label=label, **style.series(i))
                small.step(np.maximum(p, SMALLEST_SHOWN), share, where="post", **style.series(i))
            small.set_xscale("log")
            small.set_yscale("log")
            small.set_xlim(SMALLEST_SHOWN, 1.0)
            small.set_ylim(SMALLEST_SHOWN, 1.0)
            for alpha in ALPHAS:
                small.axvline(alpha, color=style.FAINT, linewidth=0.6)
            whole.set_title("sweep with runs in time" if with_runs else "sweep alone")
            small.set_title("small values")
            if whole.get_legend_handles_labels()[0]:
                whole.legend(loc="lower right")
        return style.png(figure)


def _of_class(rows: Rows) -> dict[str, Any]:
    from scipy.stats import kstest

    p = np.array([row["p_value"] for row in rows if row["p_value"] is not None])
    errors: dict[str, int] = {}
    for row in rows:
        if row["error"]:
            errors[row["error"]] = errors.get(row["error"], 0) + 1
    return {
        "nulls": len(rows),
        "failed": len(rows) - int(p.size),
        "errors": errors,
        "rates": {f"{alpha:g}": _rate(p, alpha) for alpha in ALPHAS} if p.size else {},
        "ks_p_value": float(kstest(p, "uniform").pvalue) if p.size else None,
        "smallest_p_value": float(p.min()) if p.size else None,
        "seconds_median": float(np.median([row["seconds"] for row in rows])),
    }


def _rate(p: np.ndarray, alpha: float) -> dict[str, Any]:
    hits, n = int(np.sum(p < alpha)), int(p.size)
    low, high = clopper_pearson(hits, n, INTERVAL)
    fewest, most = binomial_band(n, alpha)
    return {
        "hits": hits,
        "of": n,
        "share": hits / n,
        "low": low,
        "high": high,
        "band": [fewest, most],
        "inside": fewest <= hits <= most,
    }


def _share(rate: Mapping[str, Any] | None) -> str:
    if not rate:
        return "-"
    return f"{100 * rate['share']:.1f} % ({100 * rate['low']:.1f}-{100 * rate['high']:.1f})"
