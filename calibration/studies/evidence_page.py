"""A check of the evidence as a table, a page and a picture: each case's Bayes factor three ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calibration.studies.evidence_numbers import AGREE, KINDS, NUMBERS, Rows, kind, numbers, reference, summary

PAGE = ("evidence.json", "evidence.md", "evidence.png")
SHORT = {"stall": "a level at a stall", "zero": "amplitude near its bound 0", "other": "all others"}
SLOWEST_SHOWN, LARGEST_SHOWN = 0.1, 30.0  # rad/s, nats
OFF_TICKS, RATIO_TICKS = (-20, -5, -2, -1, -0.5, 0, 0.5, 1, 2, 5, 20), (-3, 0, 3, 10, 30, 100)


def verdict(found: Mapping[str, Any]) -> str:
    """In how many cases Laplace agrees, as a table in Markdown."""
    lines = [
        _line(["cases", "number", f"within {AGREE:g}", "within it or 2 errors", "median", "rms", "largest"]),
        _line(["---"] * 7),
    ]
    for name, group in (*found["groups"].items(), ("all", found["all"])):
        words = KINDS.get(name, "all")
        if not group["cases"]:
            lines.append(_line([words, "0", *["-"] * 5]))
            continue
        counts = [str(group[key]) for key in ("cases", "within", "within_errors")]
        lines.append(_line([words, *counts, *(f"{group[key]:+.2f}" for key in ("median", "rms", "largest"))]))
    return "\n".join(lines).replace("+-", "-")


def page(found: Mapping[str, Any], rows: Rows) -> str:
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
        f"{verdict(found)}\n\n"
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
        f"{table(rows)}\n\n"
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
    lines = [_line(head), _line(["---"] * len(head))]
    for row in rows:
        first = [
            str(row["seed"]),
            row["noise"],
            row["concealed"] or "-",
            _number(row["size"], "g"),
            row["effect"] or "-",
        ]
        if row["laplace"] is None:
            lines.append(_line([*first, "failed", *["-"] * 9]))
            continue
        off = row["laplace"] - reference(row)[0]
        cells = [_number(row["laplace"]), _number(row["laplace_noise"])]
        cells += [_with_error(row["nested"], row["nested_error"]), _number(row["nested_again"])]
        cells += [_with_error(row["importance"], row["importance_error"])]
        cells += [f"**{off:+.2f}**" if abs(off) > AGREE else f"{off:+.2f}"]
        cells += [_number(row["base_off"], "+.2f"), _number(row["effect_off"], "+.2f")]
        cells += [_with_error(row["amplitude"], row["amplitude_sd"])]
        lines.append(_line([*first, *cells, f"{max(row['slowest_rad_s'], 0.0):.1f}{'*' if row['not_read'] else ''}"]))
    return "\n".join(lines)


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


def _own(found: Mapping[str, Any]) -> str:
    """How many models' own ln Z agree, by group."""
    parts = [
        f"{group['own_within']} of {group['own']} ({SHORT[name]})"
        for name, group in found["groups"].items()
        if group["cases"]
    ]
    return f"Of the models' own ln Z, with the noise scales integrated, within {AGREE:g}: {', '.join(parts)}. "


def _agreement(found: Mapping[str, Any]) -> str:
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


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


__all__ = ["NUMBERS", "PAGE", "numbers", "page", "picture", "summary", "table", "verdict"]
