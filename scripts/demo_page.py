"""The page of `make demo`: what was said of a bench that conceals something, what it was, and the way to everything.

python scripts/demo_page.py out/demo
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.challenge.concealed.revealing import in_words, score_in_words
from calibration.report.diagnosis.words import sentence
from calibration.report.render import render
from model.layout import L_MIN, RPM
from rig.recording.files import write_file

LINKS = (
    (
        "diagnosis/report.html",
        "the diagnosis: where the model does not close, and what is missing",
    ),
    ("replay/replay.png", "the run replayed, beside the model driven with its pressure"),
    ("recording/recording.toml", "the recording that was exported from the run"),
    ("logs", "the run itself: every byte, sample and event"),
    ("revealed.json", "what was sealed before the bench served"),
    ("published_fit/report.html", "besides: the article's published sweep, fitted"),
)


def filled(folder: Path) -> dict[str, Any]:
    """What the page says.

    Parameters
    ----------
    folder : Path
        Of the demo.
    """
    diagnosis, revealed = (
        json.loads((folder / name).read_text(encoding="utf-8"))
        for name in ("diagnosis/diagnosis.json", "revealed.json")
    )
    true = revealed["score"]["f_overall"]["true"]
    rows = [
        ("the diagnosis, before anything is added", diagnosis["f_overall_before"]),
        ("the diagnosis, with what it found", diagnosis["f_overall_after"]),
    ]
    return {
        "verdict": sentence(diagnosis),
        "revealed": in_words(revealed),
        "score": score_in_words(revealed["score"]),
        "friction": [(name, figure(one), one["q05"] <= true <= one["q95"]) for name, one in rows],
        "true": f"{true:.4f}",
        "held_out": _held_out(diagnosis["improvement"]),
        "links": [(place, words) for place, words in LINKS if (folder / place).exists()],
    }


def figure(friction: Mapping[str, float]) -> str:
    """A mean with its standard deviation."""
    return f"{friction['mean']:.4f} ± {friction['sd']:.4f}"


def _held_out(improvement: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    found = (improvement or {}).get("held_out")
    if not found:
        return []
    before, after = found["rmse_before"], found["rmse_after"]
    named = (("speed_rad_s", "speed (rpm)", RPM), ("flow_m3_s", "flow (L/min)", L_MIN))
    return [
        *((words, f"{before[key] * factor:.2f}", f"{after[key] * factor:.2f}") for key, words, factor in named),
        ("log score, gained", "", f"{found['elpd_gain']:.0f} ± {found['elpd_gain_se']:.0f}"),
    ]


def main() -> int:
    """Write the page, and say the verdict and where it is."""
    folder = Path(sys.argv[1])
    page = filled(folder)
    write_file(folder / "index.html", render("demo.html.j2", page))
    print(f"{page['verdict']} {page['score'][0]} All of it: {folder / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
