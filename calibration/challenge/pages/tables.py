"""A summary as tables of text: for the terminal, and for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from calibration.challenge.scoring.judging import OUTCOMES

if TYPE_CHECKING:
    from rich.table import Table

GROUP_WORDS = {
    "none": "nothing concealed",
    "single": "one effect",
    "pair": "two effects",
    "other_form": "one effect, other form",
    "not_in_library": "in no library",
    "near_nuisance": "near a nuisance's size",
}
LOCATED_WORDS = {
    "right": "all of it, first place given",
    "any_of_those_listed": "all of it, any place given",
    "where_noticed": "all of it, where a mismatch was noticed",
    "balance": "balance",
    "channel": "channel",
    "coordinate": "coordinate, or in its group",
    "range": "range, where coordinates agree",
}


@dataclass(frozen=True)
class Grid:
    """A table. `header`: of its columns; the first holds words, the others figures."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def percent(got: Mapping[str, Any] | None) -> str:
    """A share as 93.1 % (27 of 29; 77.2 to 99.2 %)."""
    if not got or not got["n"]:
        return "no cases"
    low, high = 100.0 * got["low"], 100.0 * got["high"]
    return f"{100.0 * got['share']:.1f} % ({got['hits']} of {got['n']}; {low:.1f} to {high:.1f} %)"


def words(group: str) -> str:
    """A group as a person calls it."""
    return GROUP_WORDS.get(group, group)


def goals(found: Mapping[str, Any]) -> Grid:
    """Goals beside what was got."""
    return Grid("Goals", ("goal", "wanted", "got", ""), [_goal(one) for one in found["goals"]])


def outcomes(found: Mapping[str, Any]) -> Grid:
    """What became of the cases of each group."""
    present = [o for o in OUTCOMES if any(o in mine for mine in found["outcomes"].values())]
    rows = [
        (words(group), *(str(mine.get(one, 0)) for one in present), str(sum(mine.values())))
        for group, mine in found["outcomes"].items()
    ]
    return Grid("Outcomes", ("concealed", *present, "cases"), rows)


def confusion(found: Mapping[str, Any], which: str, title: str) -> Grid:
    """A confusion matrix."""
    matrix = found["confusion"][which]
    rows = [
        (row, *(str(n) if n else "" for n in counts))
        for row, counts in zip(matrix["rows"], matrix["counts"], strict=True)
    ]
    return Grid(title, ("concealed \\ said", *matrix["columns"]), rows)


def by_signal(found: Mapping[str, Any]) -> Grid:
    """Rates against D."""
    keys = ("detected", "right", "right_or_listed", "wrong")
    rows = [
        (
            f"{b['from']:g} to {b['to']:g}" if b["to"] is not None else f"{b['from']:g} up",
            *(percent(b[k]) for k in keys),
        )
        for b in found["by_signal"]
        if b["n"]
    ]
    header = ("D", "mismatch detected", "right name", "right name or truth listed", "wrong name")
    return Grid("Rates against the signal-to-noise ratio", header, rows)


def shares(title: str, pairs: Sequence[tuple[str, Mapping[str, Any] | None]]) -> Grid:
    """Shares with their names."""
    return Grid(title, ("of", "share (95 % interval)"), [(name, percent(got)) for name, got in pairs])


def all_grids(found: Mapping[str, Any]) -> list[Grid]:
    """Every table of the page, in order."""
    nulls = [(name, percent(one["false_names"]), percent(one["false_alarms"])) for name, one in found["nulls"].items()]
    near = [(name, *(percent(got) for got in one.values())) for name, one in found["near"].items()]
    return [
        goals(found),
        outcomes(found),
        _accuracy(found["accuracy"]),
        _separable(found["separable"]),
        by_signal(found),
        Grid("Where nothing is concealed", ("noise", "false names", "false alarms of any kind"), nulls),
        Grid("Near a nuisance's size", ("concealed", "right", "named", "consistent", "wrong name"), near),
        shares("Wrong names", [(words(group), got) for group, got in found["wrong_names"].items()]),
        shares("Effects in no library", [(key.replace("_", " "), got) for key, got in found["not_in_library"].items()]),
        _located(found["located"]),
        *_confounded(found["confounded"]),
        _coverage(found["coverage"]),
        *(
            _reliability(found["reliability"][key], title)
            for key, title in (
                ("sets", "Stated probability of sets"),
                ("sets_named", "Stated probability of sets named"),
                ("effects", "Stated probability of effects"),
            )
        ),
        _held_out(found["held_out"]),
    ]


def _accuracy(found: Mapping[str, Any]) -> Grid:
    columns = ("unconditional", "with_truth_listed", "given_a_name")
    return Grid(
        "Accuracy, of all cases and of those with a name",
        ("concealed", "right, of all", "right or truth listed, of all", "right, where something was named"),
        [(words(group), *(percent(one[key]) for key in columns)) for group, one in found.items()],
    )


def _separable(found: Mapping[str, Any]) -> Grid:
    return shares(
        f"Separable by the scorer's account ({found['not_computed']} not computed)",
        [
            ("separable, of one and two effects", found["share"]),
            ("right set where separable", found["right_set"]),
            ("... one effect", found["right_set_single"]),
            ("... two effects", found["right_set_pair"]),
            ("... one effect in another form", found["right_set_other_form"]),
            ("... the same, truth listed counted", found["right_or_listed_other_form"]),
        ],
    )


def _located(found: Mapping[str, Any]) -> Grid:
    rows = [
        (words(group), *(percent(one[key]) for key in LOCATED_WORDS), _sizes(one["by_group_size"]))
        for group, one in found.items()
    ]
    return Grid("Located", ("concealed", *LOCATED_WORDS.values(), "right, by the group's size"), rows)


def _confounded(found: Mapping[str, Any]) -> tuple[Grid, Grid]:
    """Confounded verdicts, and what they became with the recommended test."""
    said = shares(
        f"Not separable though D is 7 or more: {found['not_separable_above_7']} cases",
        [
            ("said to be confounded, truth listed", found["flagged"]),
            ("... the scorer's rival listed too", found["flagged_with_the_rival"]),
            ("named rightly all the same", found["named_all_the_same"]),
        ],
    )
    followed_up = shares(
        f"With the recommended test added: {found['followed_up']} of {found['truth_listed']} cases",
        [
            ("resolved rightly", found["resolved"]),
            ("resolved wrongly", found["resolved_wrongly"]),
            ("still confounded, truth listed", found["still_confounded"]),
            ("none of these", found["neither"]),
            ("ended in an error", found["ended_in_an_error"]),
        ],
    )
    return said, followed_up


def _coverage(found: Mapping[str, Any]) -> Grid:
    intervals = {**found["f_overall"], "an effect's size, rightly named": found["effect_size"]}
    rows = [(name, percent(one["50"]), percent(one["90"])) for name, one in intervals.items()]
    return Grid("Intervals that hold the truth", ("f_overall", "50 % interval", "90 % interval"), rows)


def as_rich(grid: Grid) -> Table:
    """For the terminal."""
    from rich.markup import escape
    from rich.table import Table

    made = Table(title=escape(grid.title), title_justify="left")
    for i, head in enumerate(grid.header):
        made.add_column(escape(head), justify="left" if i == 0 else "right")
    for row in grid.rows:
        made.add_row(*(escape(cell) for cell in row))
    return made


def as_markdown(grid: Grid) -> str:
    """For the page."""
    if not grid.rows:
        return "none\n"
    lines = ["| " + " | ".join(cell_text(c) for c in row) + " |" for row in (grid.header, *grid.rows)]
    lines.insert(1, "|" + "---|" * len(grid.header))
    return "\n".join(lines) + "\n"


def cell_text(text: str) -> str:
    """Text of a file or a rig, fit for a cell of Markdown: bounded, one line, no markup."""
    line = " ".join(str(text).split())[:300]
    for mark, safe in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "&#124;"), ("`", "&#96;"), ("[", "&#91;")):
        line = line.replace(mark, safe)
    return line


def _goal(one: Mapping[str, Any]) -> tuple[str, ...]:
    low, high = one["low"], one["high"]
    bounds = f"{100 * low:g} to {100 * high:g} %" if low is not None and high is not None else ""
    wanted = bounds or (f"at least {100 * low:g} %" if low is not None else f"at most {100 * high:g} %")
    got = (
        percent(one["got"]) if one["got"] else "not computed" if one["ratio"] is None else f"{100 * one['ratio']:.1f} %"
    )
    certain = ""
    if one["met"] == "met" and one["certain"] is not None:
        certain = ", with its whole interval" if one["certain"] else ", its interval reaches beyond"
    return one["goal"], wanted, got, "not computed" if got == "not computed" else one["met"] + certain


def _held_out(found: Mapping[str, Any]) -> Grid:
    """The gain on held-out readings beside the oracle's, in log predictive density."""
    title = f"Held-out gain against the oracle's: {found['cases']} cases"
    shown = (("sum of gains, nats", "gain"), ("sum of the oracle's, nats", "oracle_gain"))
    rows = [(words, f"{found[key]:.1f}") for words, key in shown]
    ratios = (("ratio of the sums", "ratio"), ("median of the cases' ratios", "median_ratio"))
    rows += [(words, f"{100.0 * found[key]:.1f} %") for words, key in ratios if found[key] is not None]
    return Grid(title, ("of", "got"), rows if found["cases"] else [])


def _sizes(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{size}: {n}" for size, n in counts.items()) or "-"


def _reliability(found: Mapping[str, Any], title: str) -> Grid:
    rows = [(f"{b['from']:.1f} to {b['to']:.1f}", f"{b['stated']:.3f}", percent(b)) for b in found["bins"]]
    if found["n"]:
        title += f": Brier score {found['brier']:.3f}, expected calibration error {found['ece']:.3f}"
    return Grid(title, ("stated between", "stated on average", "came true"), rows)
