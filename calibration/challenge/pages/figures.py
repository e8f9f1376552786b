"""The pictures of a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calibration.challenge.scoring.goals import COVERED
from calibration.report import style

CONFUSION, SIGNAL, RELIABILITY, COVERAGE = "confusion.png", "signal.png", "reliability.png", "coverage.png"


def pictures(found: Mapping[str, Any]) -> dict[str, bytes]:
    """All of them, by file name."""
    return {
        CONFUSION: confusion(found["confusion"]["main"]),
        SIGNAL: signal(found["by_signal"]),
        RELIABILITY: reliability(found["reliability"]),
        COVERAGE: covered(found["coverage"]),
    }


def confusion(matrix: Mapping[str, Any]) -> bytes:
    """The confusion matrix: shade by share of the row, counts written in."""
    rows, columns, counts = matrix["rows"], matrix["columns"], matrix["counts"]
    with style.drawing(height_in=1.6 + 0.24 * max(len(rows), 4)) as (figure, axes):
        shown = [[n / max(sum(row), 1) for n in row] for row in counts] or [[0.0]]
        axes.imshow(shown, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axes.grid(False)
        axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=6.5)
        axes.set_yticks(range(len(rows)), rows, fontsize=6.5)
        for y, row in enumerate(counts):
            for x, n in enumerate(row):
                if n:
                    ink = "white" if shown[y][x] > 0.6 else style.INK
                    axes.text(x, y, str(n), ha="center", va="center", fontsize=6.5, color=ink)
        axes.set_xlabel("said")
        axes.set_ylabel("concealed")
        return style.png(figure)


def signal(bins: Sequence[Mapping[str, Any]]) -> bytes:
    """Rates against D with their intervals."""
    filled = [one for one in bins if one["n"]]
    words = [f"{one['from']:g}-{one['to']:g}" if one["to"] else f"{one['from']:g} up" for one in filled]
    series = (("detected", "mismatch detected"), ("right", "right name"), ("wrong", "wrong name"))
    with style.drawing() as (figure, axes):
        for i, (key, said) in enumerate(series):
            _rates(axes, [x + 0.06 * (i - 1) for x in range(len(filled))], [one[key] for one in filled], i, said)
        axes.set_xticks(range(len(filled)), [f"{w}\n({one['n']})" for w, one in zip(words, filled, strict=True)])
        axes.set_ylim(-0.02, 1.02)
        style.name_axes(axes, ("signal-to-noise ratio D (cases)", "1"), ("share of cases", "1"))
        if filled:
            figure.legend(loc="outside upper center", ncols=3)
        return style.png(figure)


def reliability(found: Mapping[str, Any]) -> bytes:
    """Stated probability against what came true."""
    with style.drawing() as (figure, axes):
        axes.plot([0.0, 1.0], [0.0, 1.0], color=style.FAINT, linewidth=0.8)
        for i, (key, words) in enumerate((("sets", "whole sets"), ("effects", "single effects"))):
            bins = found[key]["bins"]
            if bins:
                _rates(axes, [one["stated"] for one in bins], bins, i, words)
        style.name_axes(axes, ("probability stated", "1"), ("share that came true", "1"))
        if found["sets"]["bins"]:
            figure.legend(loc="outside upper center", ncols=3)
        return style.png(figure)


def covered(found: Mapping[str, Any]) -> bytes:
    """Coverage of the 50 and 90 % intervals with the band that was the goal."""
    parts = [*found["f_overall"].items(), ("an effect's size", found["effect_size"])]
    parts = [(name, one) for name, one in parts if one["90"]["n"]]
    with style.drawing(height_in=1.2 + 0.32 * max(len(parts), 2)) as (figure, axes):
        axes.axvspan(*COVERED, color=style.SHADE)
        axes.axvline(0.5, color=style.FAINT, linewidth=0.8)
        for i, level in enumerate(("50", "90")):
            for y, (_, one) in enumerate(parts):
                got = one[level]
                axes.plot([got["low"], got["high"]], [y, y], **style.series(i))
                axes.plot(
                    [got["share"]], [y], "o", color=style.COLOURS[i], label=f"{level} % interval" if y == 0 else None
                )
        axes.set_yticks(range(len(parts)), [f"{name} ({one['90']['n']})" for name, one in parts])
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("share of intervals that hold the truth")
        if parts:
            figure.legend(loc="outside upper center", ncols=3)
        return style.png(figure)


def _rates(axes: Any, x: Sequence[float], got: Sequence[Mapping[str, Any]], index: int, words: str) -> None:
    share = [one["share"] for one in got]
    below = [s - one["low"] for s, one in zip(share, got, strict=True)]
    above = [one["high"] - s for s, one in zip(share, got, strict=True)]
    axes.errorbar(x, share, [below, above], marker="o", markersize=4, capsize=2, label=words, **style.series(index))
