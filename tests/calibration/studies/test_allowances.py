"""What each allowance of a diagnosis costs: one recording of the campaign, and what becomes of several."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.studies.allowances import D2, LINE, STUDY, WORDS, costs, page, summary
from calibration.studies.campaigns import main


def test_what_is_left_of_an_effect_is_what_no_allowance_makes():
    rng = np.random.default_rng(3)
    J, change = 10.0 * rng.normal(size=(40, 3)), rng.normal(size=40)
    seen = np.linalg.lstsq(J, change, rcond=None)
    free = float(seen[1][0])
    assert free < D2(J, change) < 1.05 * free  # priors, which are no more than that
    assert D2(J[:, :0], change) == pytest.approx(change @ change)
    assert D2(1e3 * J, J @ [1.0, 2.0, 3.0]) < 1e-3


@pytest.mark.long
@pytest.mark.slow
def test_in_a_sweep_with_runs_dry_friction_is_hidden_by_the_roller_friction_not_by_the_line():
    found = costs({"seed": STUDY.first_seed})
    assert set(found["used"]) <= set(WORDS)
    of = found["D2"]["coulomb_friction"]
    assert all(of[""] <= (1.0 + 1e-9) * value for value in of.values())  # what is known hides nothing
    assert of[LINE] >= (1.0 - 1e-9) * of["form"]
    assert of["roller"] > 2.0 * of[""] and of[LINE] < 1.5 * of[""]
    assert found["D2"]["flow_offset"]["others"] > 2.0 * found["D2"]["flow_offset"][""]  # the meter's own


def test_a_factor_is_the_median_over_the_recordings_and_a_failed_one_is_told():
    rows = [
        {"error": "", "used": {"form": used}, "D2": {"windage": {"": 4.0, "form": known, LINE: 8.0}}}
        for used, known in ((1.0, 4.0), (2.0, 6.0), (2.0, 8.0))
    ]
    found = summary([*rows, {"name": "recording-9", "error": "ValueError: no"}], 1, "code")
    assert found["D"] == {"windage": 2.0}
    assert found["factor"]["windage"] == {LINE: 2.0, "form": 1.5}
    assert found["used"] == {LINE: None, "form": pytest.approx(3.0**0.5)}
    words = page(found)
    assert "| windage | 2.0 | 2.00 | 1.50 |" in words and "recording-9: ValueError: no" in words
    assert "*form*" in words and "*roller*" not in words


def test_it_runs_as_the_other_campaigns_do(tmp_path, capsys):
    assert main(STUDY, ["-o", str(tmp_path), "--recordings", "0"]) == 2
    assert "nothing to do" in capsys.readouterr().err
