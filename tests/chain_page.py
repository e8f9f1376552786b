"""The tables of `tests.chain`: a line a case, and how many came out as they should."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

BENCH_COLUMNS = (
    *("bench", "regulator [s]", "volume [L]", "valve [ms]", "gauge [Hz]", "tachometer", "noise declared", "rate"),
    *("fit's f_overall [N m s]", "diagnosis", "p", "f_overall [N m s]", "diagnosis took [s]"),
)
CONCEALED_COLUMNS = ("case", "faults", "concealed", "told apart", "verdict", "named", "score", "p", "f_overall", "true")


def write_page(which: str, done: Sequence[dict[str, Any]], folder: Path | None) -> str:
    """The counts and the table of a campaign, as Markdown; in a folder too, with the cases.

    Parameters
    ----------
    which : str
        ``benches`` or ``concealed``.
    done : sequence of dict
        Its cases.
    folder : Path or None
        Where to write; None writes nothing.
    """
    counts, columns, row = {
        "benches": (_of_benches, BENCH_COLUMNS, _bench_row),
        "concealed": (_of_concealed, CONCEALED_COLUMNS, _concealed_row),
    }[which]
    whole = [one for one in done if "failed" not in one]
    failed = [f"- case {one['case']}: {one['failed']}" for one in done if "failed" in one]
    lines = [*counts(whole), "", *_table(columns, [row(one) for one in whole]), *(["", *failed] if failed else [])]
    text = "\n".join(lines) + "\n"
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{which}.md").write_text(text, encoding="utf-8")
        cases = "".join(json.dumps(one) + "\n" for one in done)
        (folder / f"{which}.jsonl").write_text(cases, encoding="utf-8")
    return text


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (columns, ["---"] * len(columns), *rows)]


def _holds(figure: dict[str, float], true: float) -> bool:
    return figure["q05"] is not None and figure["q05"] <= true <= figure["q95"]


def _of_benches(done: Sequence[dict[str, Any]]) -> list[str]:
    n = len(done)
    took = sorted(one["diagnose_s"] for one in done) or [0.0]
    return [
        f"- consistent: {sum(one['verdict'] == 'consistent' for one in done)} of {n}; "
        f"p below 0.01: {sum(one['p_value'] < 0.01 for one in done)}",
        f"- the fit's 90 % interval of f_overall holds the true one in {sum(_holds(o['fit'], o['true']) for o in done)}"
        f" of {n}, the diagnosis' in {sum(_holds(o['f_overall'], o['true']) for o in done)}",
        f"- a diagnosis took {took[len(took) // 2]:.0f} s at the median, {took[-1]:.0f} s at most",
    ]


def _of_concealed(done: Sequence[dict[str, Any]]) -> list[str]:
    nothing = [one for one in done if not one["revealed"]["concealed"]]
    apart = [one for one in done if one["separable"]["separable"]]
    scores = Counter(one["revealed"]["score"] for one in apart)
    every = Counter(one["revealed"]["score"] for one in done)
    holds = sum(bool((one["revealed"]["f_overall"] or {}).get("holds")) for one in done)
    took = sorted(one["diagnose_s"] for one in done) or [0.0]
    return [
        f"- nothing concealed: {len(nothing)}; called consistent: "
        f"{sum(one['verdict'] == 'consistent' for one in nothing)}; a name where there is none: {every['false name']}",
        f"- can be told apart: {len(apart)}; right: {scores['right']}, listed: {scores['listed']}",
        f"- of all: {', '.join(f'{name} {count}' for name, count in sorted(every.items()))}",
        f"- the 90 % interval of f_overall holds the true one in {holds} of {len(done)}",
        f"- a diagnosis took {took[len(took) // 2]:.0f} s at the median, {took[-1]:.0f} s at most",
    ]


def _figure(figure: dict[str, float]) -> str:
    return "none" if figure["mean"] is None else f"{figure['mean']:.4f} ± {figure['sd']:.4f}"


def _bench_row(one: dict[str, Any]) -> list[str]:
    bench = one["bench"]
    tachometer = bench["tachometer"]
    if bench["window_s"]:
        tachometer = f"mean over {1e3 * bench['window_s']:.0f} ms"
    return [
        *(str(one["case"]), f"{bench['regulator_s']:.3f}", f"{bench['volume_l']:.2f}", f"{1e3 * bench['valve_s']:.0f}"),
        *(f"{1.0 / bench['gauge_s']:.0f}", tachometer, f"{bench['declared']:.2f}", f"{bench['rate']:.1f}"),
        *(_figure(one["fit"]), one["verdict"], f"{one['p_value']:.2g}", _figure(one["f_overall"])),
        f"{one['diagnose_s']:.0f}",
    ]


def _concealed_row(one: dict[str, Any]) -> list[str]:
    told = one["revealed"]
    friction = told["f_overall"] or {"mean": None}
    return [
        *(str(one["case"]), "yes" if one["faults"] else "no", ", ".join(told["concealed"]) or "nothing"),
        *("yes" if one["separable"]["separable"] else "no", one["verdict"], ", ".join(told["named"]) or "nothing"),
        *(
            told["score"],
            f"{one['p_value']:.2g}",
            _figure(friction),
            f"{friction['true']:.4f}" if told["f_overall"] else "",
        ),
    ]
