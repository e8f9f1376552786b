"""The published page of scored campaigns, and what lies beside it: pictures, tables as JSON, a line a case as CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from calibration.challenge.campaign.layout import canonical
from calibration.challenge.pages import figures, tables
from calibration.challenge.pages.tables import Grid, as_markdown, cell_text
from calibration.challenge.record import ledger
from calibration.challenge.record.opening import Scored
from calibration.challenge.scoring import cases
from rig.recording.files import json_bytes

PAGE, SUMMARY, CASES = "result.md", "result.json", "cases.csv"
MOST_FAILURES = 80
FAILURE_COLUMNS = ("case", "concealed", "D", "separable", "verdict", "said", "set_probability", "outcome", "why")
PICTURES = {
    "Outcomes": (figures.CONFUSION, "what was concealed against what was said"),
    "Rates against the signal-to-noise ratio": (figures.SIGNAL, "rates against D"),
    "Intervals that hold the truth": (figures.COVERAGE, "coverage of intervals"),
}


def files(scored: Scored, book: Sequence[Mapping[str, Any]]) -> dict[str, bytes]:
    """Everything by file name."""
    campaigns = [one.entry | {"thresholds": one.frozen["thresholds"]} for one in scored.opened]
    campaigns = json.loads(canonical(campaigns))  # in one order, wherever they were read
    found = scored.summary | {"failures": cases.failures(scored.cases), "campaigns": campaigns}
    data = json_bytes(found)
    return {PAGE: page(scored, book).encode(), SUMMARY: data, CASES: cases.as_csv(scored.cases)} | figures.pictures(
        found
    )


def page(scored: Scored, book: Sequence[Mapping[str, Any]]) -> str:
    """The page, in Markdown."""
    found, failed = scored.summary, cases.failures(scored.cases)
    parts = ["# The blind record", _intro(scored)]
    for grid in tables.all_grids(found):
        parts += [f"## {cell_text(grid.title)}", as_markdown(grid)]
        if grid.title in PICTURES:
            name, words = PICTURES[grid.title]
            parts.append(f"![{words}]({name})\n")
        if grid.title == "Outcomes":
            for which, title in (
                ("main", "Concealed against said"),
                ("other_form", "The same, where the effect has another form than the library's"),
                ("near_nuisance", "The same, where the effect is at most 4 declared standard deviations of a nuisance"),
            ):
                if found["confusion"][which]["rows"]:
                    parts += [f"### {title}", as_markdown(tables.confusion(found, which, title))]
    parts.append(f"![stated probability against what came true]({figures.RELIABILITY})\n")
    parts += ["## Verdicts against the truth", _failures(failed)]
    parts += ["## The ledger", as_markdown(ledger_grid(book))]
    return "\n".join(parts)


def ledger_grid(book: Sequence[Mapping[str, Any]]) -> Grid:
    """Every campaign that was ever scored."""
    rows: list[tuple[str, ...]] = []
    for line in ledger.scored(book):
        got = {goal["goal"]: goal for goal in line["result"]["goals"]}
        met = [goal["met"] for goal in got.values()]
        rows.append(
            (
                str(line["number"]),
                line["scored_utc"][:10],
                line["campaign"] + (" (with follow-ups)" if line["follow_ups"] else ""),
                line["family"],
                str(line["seed"]),
                str(line["cases"]),
                (line["commit"] or "none")[:8] + (", changed" if line["dirty"] else ""),
                line["diagnosis_sha256"][:8],
                _counts(got["wrong names in all"]["got"]),
                _counts(got["right set of effects where separable"]["got"]),
                f"{met.count('met')} met, {met.count('missed')} missed",
                "opened before" if line["truths_opened_before"] else "blind",
            )
        )
    for line in ledger.only_opened(book):
        empty = ("",) * 3
        cases_of = (str(line["cases"]), *empty, "opened, never scored", "", "opened")
        rows.append((str(line["number"]), line["opened_utc"][:10], line["campaign"], "", "", *cases_of))
    header = ("no.", "scored", "campaign", "family", "seed", "cases", "commit", "code", "wrong names")
    return Grid("Ledger", (*header, "right set where separable", "goals", "truths"), rows)


def _counts(got: Mapping[str, Any]) -> str:
    return f"{got['hits']} of {got['n']}"


def _intro(scored: Scored) -> str:
    found, lines = scored.summary, []
    for entry in scored.entries:
        state = "changed against it" if entry["dirty"] else "clean"
        lines.append(
            f"- **{cell_text(entry['campaign'])}**: {entry['cases']} cases of family {cell_text(entry['family'])}, "
            f"seed {entry['seed']}, commit {entry['commit'] or 'none'} ({state}), sources of the diagnosis "
            f"`{entry['diagnosis_sha256'][:16]}`, truths `{entry['truth_sha256'][:16]}`, verdicts "
            f"`{entry['verdicts_sha256'][:16]}`."
        )
    seconds = found["seconds"]
    took = f"{found['core_hours']:.2f} core-hours" if found["core_hours"] >= 0.01 else "under a core-minute"
    times = f"; {seconds['median']:.1f} s a case (median), {seconds['longest']:.1f} s at most" if seconds else ""
    return (
        "Made by `spinbench challenge`; nothing on this page is typed in. "
        "[How a campaign is made, sealed and scored](../challenge.md). Intervals are Clopper-Pearson, 95 %.\n\n"
        + "\n".join(lines)
        + "\n\n"
        f"{found['cases']} cases. The diagnoses took {took}{times}. Every case is in [{CASES}]({CASES}), every figure "
        f"in [{SUMMARY}]({SUMMARY}).\n"
    )


def _failures(failed: Sequence[Mapping[str, Any]]) -> str:
    if not failed:
        return "None.\n"
    rows = [tuple(_shown(one[key]) for key in FAILURE_COLUMNS) for one in failed[:MOST_FAILURES]]
    rest = f"\n{len(failed) - MOST_FAILURES} more are in [{CASES}]({CASES}).\n" if len(failed) > MOST_FAILURES else ""
    return as_markdown(Grid("", FAILURE_COLUMNS, rows)) + rest


def _shown(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
