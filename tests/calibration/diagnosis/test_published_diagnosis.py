"""What the diagnosis says of the article's own sweep: the flow at 2.00 bar, and what seven plateaus leave open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import truncnorm

from calibration.diagnosis import Diagnosis, as_json, diagnose
from calibration.likelihood.descent import find
from rig.recording import read_recording

PUBLISHED = Path(__file__).resolve().parents[3] / "logs" / "published_sweep"


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose(read_recording(PUBLISHED), 1)


def test_the_flow_at_two_bar_is_a_bad_reading_and_nothing_else_is_named(found) -> None:
    document = as_json(found)
    assert document["verdict"] == "named"
    assert [effect["id"] for effect in document["effects"]] == ["bad_reading"]
    (row,) = document["suspect_rows"]
    assert (row["file"], row["row"], row["channel"]) == ("sweep.csv", 7, "flow")


@pytest.mark.parametrize(("effect", "most", "below"), [("coulomb_friction", 0.0, 0.21), ("windage", 2.4e-5, 1.8e-4)])
def test_a_drag_is_bounded_at_the_size_that_the_docs_tell(found, effect: str, most: float, below: float) -> None:
    comparison, refit = found.comparison, find(found.comparison, (effect,))
    place = len(comparison.problem.nuisances)
    unknown = comparison.problem.effect_unknowns((effect,))[0][1]
    z, sd = refit.z[place], float(np.sqrt(refit.covariance[place, place]))
    assert unknown.value(z) == pytest.approx(most, abs=0.01 * below)
    assert unknown.value(truncnorm.ppf(0.95, -z / sd, np.inf, z, sd)) == pytest.approx(below, rel=0.05)


def test_f_overall_lies_on_a_ridge_with_lap_rollers_and_instruments(found) -> None:
    names = [one.name for one in found.comparison.problem.nuisances]
    sd = np.sqrt(np.diag(found.base.covariance))
    shared = found.base.covariance / np.outer(sd, sd)
    f = names.index("f_overall")
    told = {"port_lap": -0.75, "roller_friction": -0.56, "flow_scale": -0.51, "pressure_offset": 0.40}
    for name, correlation in told.items():
        assert shared[f, names.index(name)] == pytest.approx(correlation, abs=0.02), name
    unknown = found.comparison.problem.nuisances[f]
    low, mean, high = (float(unknown.value(found.base.z[f] + by * sd[f])) for by in (-1.0, 0.0, 1.0))
    assert (mean, (high - low) / 2.0) == (pytest.approx(0.0640, abs=2e-4), pytest.approx(0.0022, abs=1e-4))
    assert sd[names.index("port_lap")] == pytest.approx(0.6, abs=0.03)  # of its prior
    assert sd[names.index("roller_friction")] > 0.95
