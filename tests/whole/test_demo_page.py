"""The page that ends the demo."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FRICTION = {"mean": 0.0702, "sd": 0.0024, "q05": 0.0663, "q95": 0.0742}
DRAG = {"id": "windage", "probability": 0.96, "parameters": {"drag_nm_s2": {"mean": 2e-4, "sd": 1e-5}}}


def written(folder: Path, verdict: str, effects: list[dict[str, Any]], improvement: dict[str, Any] | None) -> str:
    """The page of a demo that ended with a verdict, and what was said on the terminal before it."""
    diagnosis = {
        "format": "diagnosis/1",
        **{"verdict": verdict, "effects": effects, "improvement": improvement, "alternatives": [], "next_tests": []},
        **{"mismatch": {"p_value": 1e-9}, "located": [], "suspect_rows": [], "why": "", "term": None},
        **{"f_overall_before": FRICTION | {"q05": 0.077, "q95": 0.081}, "f_overall_after": FRICTION},
    }
    scored = {
        **{"concealed": ["windage"], "category": "single", "verdict": verdict, "named": ["windage"], "score": "right"},
        "f_overall": FRICTION | {"true": 0.0699, "holds": True},
    }
    line = {"line_volume_l": 0.2, "regulator_lag_s": 0.1, "valve_time_s": 0.01}
    truth = {"effects": [{"id": "windage", "form": "quadratic", "values": {"drag_nm_s2": 2e-4}}], "f_overall": 0.0699}
    files = {
        "diagnosis/diagnosis.json": diagnosis,
        "revealed.json": {"truth": truth, "line": line, "score": scored},
    }
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    (folder / "diagnosis" / "report.html").write_text("", encoding="utf-8")
    script = ROOT / "scripts" / "demo_page.py"
    told = subprocess.run([sys.executable, script, folder], capture_output=True, text=True, check=True)
    return told.stdout + (folder / "index.html").read_text(encoding="utf-8")


def test_it_says_what_was_named_and_what_was_concealed_and_links_only_what_is_there(tmp_path: Path) -> None:
    rmse = {"speed_rad_s": 0.4, "flow_m3_s": 7e-6}
    held_out = {"rmse_before": rmse, "rmse_after": rmse, "elpd_gain": 58.0, "elpd_gain_se": 15.0, "folds": 12}
    page = written(tmp_path, "named", [DRAG], {"held_out": held_out})
    told = page.partition("\n")[0]
    assert told.endswith(f"All of it: {tmp_path / 'index.html'}") and "windage" in told
    assert "0.0702 ± 0.0024" in page and "0.0699" in page and "58 ± 15" in page
    links = re.findall(r'<a href="([^"]+)"', page)
    assert "diagnosis/report.html" in links and "published_fit/report.html" not in links
    assert all((tmp_path / place).exists() for place in links)


def test_a_demo_that_names_nothing_has_a_page_too(tmp_path: Path) -> None:
    page = written(tmp_path, "unresolved", [], None)
    assert "no effect in the list explains why" in page.partition("\n")[0]
    assert "had not seen" not in page
