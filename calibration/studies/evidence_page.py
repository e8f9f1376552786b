"""A check of the evidence: how far Laplace is off, by case and by kind of case, as tables, a page, a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.challenge.pages.tables import Grid, as_markdown
from calibration.studies.campaigns import Row, Rows
from model.effects import effects
from rig.recording.files import json_bytes

AGREE = 0.5  # nats
SHORT = {"stall": "a level at a stall", "zero": "amplitude near its bound 0", "other": "all others"}
SLOWEST_SHOWN, LARGEST_SHOWN = 0.1, 30.0  # rad/s, nats
OFF_TICKS, RATIO_TICKS = (-20, -5, -2, -1, -0.5, 0, 0.5, 1, 2, 5, 20), (-3, 0, 3, 10, 30, 100)
NEAR_ZERO = 2.0  # sds: a one-sided amplitude below it has its bound in its posterior
NEAR_STALL = 1.0  # rad/s: with a level this slow in it a sweep is at the edge of a stall
NUMBERS = (
    "laplace",
    "laplace_noise",
    "nested",
    "nested_error",
    "nested_again",
    "importance",
    "importance_error",
    "effective",
    "base_off",
    "effect_off",
    "amplitude",
    "amplitude_sd",
    "slowest_rad_s",
    "not_read",
    "unknowns",
    "calls",
)


def numbers(value: Mapping[str, Any]) -> dict[str, float | None]:
    """The figures of a case.

    By the names of NUMBERS. ``laplace``, ``nested`` and ``importance`` are ln Bayes factors, of the effect over the
    base model; ``laplace_noise`` is Laplace's with the noise scales integrated too; ``base_off`` and ``effect_off`` are
    by how much each model's ln Z is higher by that than by importance sampling. ``effective`` is the smaller sample.
    """
    base, full = value["base"], value["with_effect"]
    laplace = full["laplace"] - base["laplace"]
    off: dict[str, float | None] = {"laplace_noise": None, "base_off": None, "effect_off": None}
    if base["noise_log_volume"] is not None and full["noise_log_volume"] is not None:
        whole = [one["laplace"] + one["noise_log_volume"] for one in (base, full)]
        less = [at - one["importance"]["log_evidence"] for at, one in zip(whole, (base, full), strict=True)]
        off = {"laplace_noise": whole[1] - whole[0], "base_off": less[0], "effect_off": less[1]}
    runs = [
        (b["log_evidence"] - a["log_evidence"], math.hypot(a["error"], b["error"]))
        for a, b in zip(base["nested"], full["nested"], strict=True)
    ]
    return off | {
        "laplace": laplace,
        "nested": runs[0][0] if runs else None,
        "nested_error": runs[0][1] if runs else None,
        "nested_again": runs[1][0] if len(runs) > 1 else None,
        "importance": full["importance"]["log_evidence"] - base["importance"]["log_evidence"],
        "importance_error": math.hypot(*(one["importance"]["error"] for one in (base, full))),
        "effective": min(one["importance"]["effective"] for one in (base, full)),
        "amplitude": value["amplitude"],
        "amplitude_sd": value["amplitude_sd"],
        "slowest_rad_s": value["slowest_rad_s"],
        "not_read": value["not_read"],
        "unknowns": full["unknowns"],
        "calls": base["calls"] + full["calls"],
    }


def reference(row: Row) -> tuple[float, float]:
    """A case's ln Bayes factor by sampling, and its error: by nested sampling, or by importance sampling [-]."""
    name = "importance" if row["nested"] is None else "nested"
    return row[name], row[f"{name}_error"]


def kind(row: Row) -> str:
    """Which of the groups of KINDS a case belongs to."""
    if row["not_read"] or row["slowest_rad_s"] < NEAR_STALL:
        return "stall"
    one_sided = effects()[row["effect"]].amplitude.low == 0.0
    return "zero" if one_sided and row["amplitude"] < NEAR_ZERO * row["amplitude_sd"] else "other"


KINDS = {
    "stall": f"a level that stalls, or turns at less than {NEAR_STALL:g} rad/s",
    "zero": f"no such level; a one-sided amplitude found within {NEAR_ZERO:g} sds of 0",
    "other": "all others",
}


def summary(rows: Rows, first_seed: int, code: str) -> dict[str, Any]:
    """How far Laplace is off, by group.

    `rows`: a case each; the figures None where it failed.
    Returns ``groups`` and ``all``, each with its counts, how nested and importance sampling agree, and what it was made
    with.
    """
    made = [row for row in rows if row["laplace"] is not None]
    both = [row for row in made if row["nested"] is not None]
    twice = [row["nested_again"] - row["nested"] for row in both if row["nested_again"] is not None]
    against = [
        (row["nested"] - row["importance"]) / math.hypot(row["nested_error"], row["importance_error"]) for row in both
    ]
    return {
        "format": "evidence/1",
        "cases": len(rows),
        "failed": len(rows) - len(made),
        "errors": {row["name"]: row["error"] for row in rows if row["error"]},
        "nested": len(both),
        "all": _of_group(made),
        "groups": {name: _of_group([row for row in made if kind(row) == name]) for name in KINDS},
        "nested_less_importance": _spread([row["nested"] - row["importance"] for row in both]),
        "the_same_in_errors": _spread(against),
        "nested_again_less_nested": _spread(twice),
        "nested_error": _median([row["nested_error"] for row in both]),
        "importance_error": _median([row["importance_error"] for row in made]),
        "effective": _median([row["effective"] for row in made]),
        "seconds_median": _median([row["seconds"] for row in rows]),
        "first_seed": first_seed,
        "sources_sha256": code,
    }


def _of_group(rows: Rows) -> dict[str, Any]:
    off = np.array([row["laplace"] - reference(row)[0] for row in rows])
    error = np.array([reference(row)[1] for row in rows])
    own = np.array([row[which] for row in rows for which in ("base_off", "effect_off") if row[which] is not None])
    if not rows:
        return {"cases": 0}
    return {
        "cases": len(rows),
        "within": int(np.sum(np.abs(off) <= AGREE)),
        "within_errors": int(np.sum(np.abs(off) <= np.maximum(AGREE, 2.0 * error))),
        "median": float(np.median(off)),
        "rms": float(np.sqrt(np.mean(off**2))),
        "largest": float(off[np.argmax(np.abs(off))]),
        "own": len(own),
        "own_within": int(np.sum(np.abs(own) <= AGREE)),
        "smaller": int(np.sum(off < -AGREE)),
        "larger": int(np.sum(off > AGREE)),
    }


def _spread(values: Sequence[float]) -> dict[str, Any] | None:
    if not values:
        return None
    found = np.array(values)
    return {"number": found.size, "mean": float(found.mean()), "rms": float(np.sqrt(np.mean(found**2)))}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def verdict(found: Row) -> str:
    """In how many cases Laplace agrees, as a table in Markdown."""
    header = ("cases", "number", f"within {AGREE:g}", "within it or 2 errors", "median", "rms", "largest")
    rows = []
    for name, group in (*found["groups"].items(), ("all", found["all"])):
        words = KINDS.get(name, "all")
        if not group["cases"]:
            rows.append((words, "0", *["-"] * 5))
            continue
        counts = [str(group[key]) for key in ("cases", "within", "within_errors")]
        rows.append((words, *counts, *(f"{group[key]:+.2f}" for key in ("median", "rms", "largest"))))
    return as_markdown(Grid("", header, rows))


def documents(found: Row, rows: Rows) -> dict[str, bytes]:
    """The result as a document, a page and a picture, by file name."""
    return {
        "evidence.json": json_bytes({**found, "cases": rows}),
        "evidence.md": page(found, rows).encode(),
        "evidence.png": picture(rows),
    }


def page(found: Row, rows: Rows) -> str:
    """A page for the docs."""
    failed = "".join(f"- {name}: {words}\n" for name, words in found["errors"].items())
    return (
        "# The evidence against nested sampling\n\n"
        "A diagnosis weighs sets of effects by their evidence in Laplace's approximation. Here it is held against "
        f"sampling of the same posterior, in {found['cases']} sweeps drawn from the model: in every other one an "
        "effect is concealed, and it is the one that is weighed; in the rest it is the one that the diagnosis finds "
        "most probable. What counts is the ln Bayes factor of the effect over the base model.\n\n"
        "Off: Laplace less the reference, which is nested sampling, and importance sampling where that was left out "
        f"({found['cases'] - found['failed'] - found['nested']} cases).\n\n"
        f"{verdict(found)}\n"
        "![Laplace against the reference](evidence.png)\n\n"
        f"{_own(found)}What follows for a diagnosis is in [diagnosis.md](../diagnosis.md#the-evidence).\n\n"
        "## The reference\n\n"
        "The integral of exp(-`minus_log_posterior`) over every unknown and the noise scales, effects within their "
        "bounds. Laplace as it stands holds the noise scales at their best: *with scales* integrates them by the same "
        "approximation. *Base* and *effect* are the two models' own ln Z by that, less importance sampling's.\n\n"
        "Nested sampling is dynesty's, in coordinates about where the posterior was found; its prior there is a wide "
        "law that the integrand is divided by, so the integral is the same. That search begins at the diagnosis's own "
        "mode and its covariance: another mode far away would be missed by all three, and a covariance that is far too "
        "narrow misleads them. Importance sampling draws afresh "
        f"from a Student's t law of the posterior's mean and covariance. {_agreement(found)}\n\n"
        "## Every case\n\n"
        f"{table(rows)}\n"
        "*Size*: of what is concealed, in ordinary sizes. *Amplitude*: at the mode, in prior sds. *Slowest*: "
        "predicted by the base model, of the levels whose speed was read; an asterisk: a level read 0. **Bold**: off "
        f"by more than {AGREE:g}.\n\n"
        + (f"Failed:\n\n{failed}\n" if failed else "")
        + "Runs in time are left aside: a call of "
        "the model takes fifteen times as long there.\n\n"
        f"Seeds: {found['first_seed']} and those after it. Median of {found['seconds_median']:.0f} s a case. Sources: "
        f"{found['sources_sha256'][:12]}. `make evidence` makes it anew, with nested sampling in every "
        "case.\n"
    )


def table(rows: Rows) -> str:
    """Every case in a line, as a table in Markdown."""
    head = ["seed", "noise", "concealed", "size", "weighed", "Laplace", "with scales", "nested", "again", "importance"]
    head += ["off", "base", "effect", "amplitude", "slowest"]
    lines = []
    for row in rows:
        first = [
            str(row["seed"]),
            row["noise"],
            row["concealed"] or "-",
            _number(row["size"], "g"),
            row["effect"] or "-",
        ]
        if row["laplace"] is None:
            lines.append((*first, "failed", *["-"] * 9))
            continue
        off = row["laplace"] - reference(row)[0]
        cells = [_number(row["laplace"]), _number(row["laplace_noise"])]
        cells += [_with_error(row["nested"], row["nested_error"]), _number(row["nested_again"])]
        cells += [_with_error(row["importance"], row["importance_error"])]
        cells += [f"**{off:+.2f}**" if abs(off) > AGREE else f"{off:+.2f}"]
        cells += [_number(row["base_off"], "+.2f"), _number(row["effect_off"], "+.2f")]
        cells += [_with_error(row["amplitude"], row["amplitude_sd"])]
        lines.append((*first, *cells, f"{max(row['slowest_rad_s'], 0.0):.1f}{'*' if row['not_read'] else ''}"))
    return as_markdown(Grid("", tuple(head), lines))


def picture(rows: Rows) -> bytes:
    """PNG of how far Laplace is off: in each model's ln Z by the slowest level, and in the ln Bayes factor."""
    from calibration.report import style

    made = [row for row in rows if row["laplace"] is not None]
    with style.drawing(1, 2, height_in=3.6, squeeze=False) as (figure, ((own, ratio),)):
        for axis in (own, ratio):
            axis.axhspan(-AGREE, AGREE, color=style.FAINT, alpha=0.3, linewidth=0)
        for i, name in enumerate(KINDS):
            mine = [row for row in made if kind(row) == name]
            look = {"color": style.series(i)["color"], "marker": "osD"[i], "markersize": 3.5, "linestyle": "none"}
            for which in ("base_off", "effect_off"):
                shown = [
                    (max(row["slowest_rad_s"], SLOWEST_SHOWN), row[which]) for row in mine if row[which] is not None
                ]
                fill = {"markerfacecolor": "none"} if which == "base_off" else {}
                own.plot([x for x, _ in shown], [y for _, y in shown], **look, **fill)
            off = [row["laplace"] - reference(row)[0] for row in mine]
            error = [2.0 * reference(row)[1] for row in mine]
            at = [reference(row)[0] for row in mine]
            ratio.errorbar(at, off, error, **look, elinewidth=0.7, label=SHORT[name])
        own.set_xscale("log")
        ratio.set_xscale("symlog", linthresh=3.0)
        ratio.set_xticks(RATIO_TICKS, [f"{tick:g}" for tick in RATIO_TICKS])
        for axis in (own, ratio):
            axis.set_yscale("symlog", linthresh=1.0)
            axis.set_ylim(-LARGEST_SHOWN, LARGEST_SHOWN)
            axis.set_yticks(OFF_TICKS, [f"{tick:g}" for tick in OFF_TICKS])
            axis.minorticks_off()
        style.name_axes(own, ("slowest level read", "rad/s"), ("ln Z, Laplace less importance", "1"))
        style.name_axes(ratio, ("ln Bayes factor, reference", "1"), ("ln Bayes factor, Laplace less reference", "1"))
        own.set_title("each model (open: the base model)")
        ratio.set_title("the effect over the base model")
        if made:
            ratio.legend(loc="lower left")
        return style.png(figure)


def _own(found: Row) -> str:
    """How many models' own ln Z agree, by group."""
    parts = [
        f"{group['own_within']} of {group['own']} ({SHORT[name]})"
        for name, group in found["groups"].items()
        if group["cases"]
    ]
    return f"Of the models' own ln Z, with the noise scales integrated, within {AGREE:g}: {', '.join(parts)}. "


def _agreement(found: Row) -> str:
    words = (
        f"Errors are one standard deviation as each sampler has it: the median is {found['importance_error']:.2f} for "
        f"importance sampling, with an effective {found['effective']:.0f} draws"
        if found["importance_error"] is not None
        else "No case was made"
    )
    if found["nested"]:
        both, sigma = found["nested_less_importance"], found["the_same_in_errors"]
        words += (
            f"; {found['nested_error']:.2f} for nested sampling. In the {found['nested']} cases that have both, nested "
            f"less importance sampling is {both['mean']:+.2f} on average, {both['rms']:.2f} rms: {sigma['rms']:.1f} of "
            "their joint error"
        )
    if found["nested_again_less_nested"]:
        again = found["nested_again_less_nested"]
        words += f". With another seed nested sampling moves by {again['rms']:.2f} rms, in {again['number']} cases"
    return words + "."


def _number(value: float | None, form: str = ".2f") -> str:
    return "-" if value is None else f"{value:{form}}"


def _with_error(value: float | None, error: float | None) -> str:
    return "-" if value is None or error is None else f"{value:.2f} ± {error:.2f}"
