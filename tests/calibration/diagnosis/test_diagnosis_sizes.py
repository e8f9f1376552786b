"""How well an effect's size is known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.diagnosis.sizes.sizes import sizes_of
from calibration.diagnosis.steps.candidate import Candidate, no_larger
from calibration.diagnosis.steps.name import declared_sizes, refusal, total_size
from calibration.likelihood.descent import find
from calibration.likelihood.tails import reweighed_sizes
from calibration.systems.look_up import compared
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from rig.recording import read_recording
from tests import diagnosis_recordings as recordings


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return Problem(recordings.sweep(tmp_path_factory.mktemp("windage"), 3, {"windage": {"drag_nm_s2": 3e-4}}))


def test_a_size_is_known_no_better_than_the_law(problem: Problem) -> None:
    comparison = Comparison(problem)
    mode = find(comparison, ("windage",), base_of(comparison))
    (size,) = sizes_of(problem, Candidate(("windage",), mode, 0.0, 0.0))
    fitted = float(reweighed_sizes(problem, ("windage",), mode.z, mode.covariance)[1].sd[0])
    assert fitted == pytest.approx(math.sqrt(mode.covariance[-1, -1]), rel=0.1)
    low, value, high = size.unknown.value(size.z + fitted * np.array([-1.0, 0.0, 1.0]))
    spread = np.diff(size.unknown.value(size.z + size.sd * np.array([-1.0, 1.0])))[0] / 2.0
    assert spread == pytest.approx(math.hypot((high - low) / 2.0, 0.04 * value))
    assert (size.effect, size.parameter.name) == ("windage", "drag_nm_s2")


@pytest.mark.parametrize("serial", [False, True])
def test_an_error_of_instruments_of_two_days_is_beside_what_is_declared_of_each(tmp_path: Path, serial: bool) -> None:
    for name, seed in (("may", 3), ("june", 8)):
        recordings.sweep(tmp_path / name, seed, {})
        toml = tmp_path / name / "recording.toml"
        named = '[channels.pressure_bar_abs]\nserial = "G-1"\ncalibrated = "2026-01-01"\n'
        toml.write_text(
            toml.read_text().replace(
                "[channels.pressure_bar_abs]\n", named if serial else "[channels.pressure_bar_abs]\n"
            )
        )
    several = compared([read_recording(tmp_path / name) for name in ("may", "june")])
    problem, names = several.problem, ("pressure_gauge_offset",)
    k = len(problem.nuisances)
    offsets = [i for i, one in enumerate(problem.nuisances) if one.own == "pressure_offset"]
    assert len(offsets) == (1 if serial else 2)
    z = np.append(np.zeros(k), 0.1)
    z[offsets[-1]] = 1.0
    mode = replace(several.base(), names=names, z=z, covariance=1e-12 * np.eye(k + 1))
    declared = declared_sizes(problem, names[0], "offset_pa")
    assert [place for _, place in declared] == offsets
    size = total_size(problem, mode, names[0])
    assert size is not None and size[0] == pytest.approx(1.0 + 0.1 * declared[-1][0])
    assert refusal(several, mode) == no_larger(names[0])


def test_a_sine_of_nothing_is_as_uncertain_as_its_cosine(problem: Problem) -> None:
    """Both are one size: a phase that is a little off moves the smaller part by a share of the larger."""
    k = len(problem.nuisances)
    names = ("once_per_rev_torque",)
    z = np.concatenate([np.zeros(k), [0.0, 0.5]])
    mode = replace(base_of(Comparison(problem)), z=z, covariance=1e-12 * np.eye(k + 2))
    sine, cosine = sizes_of(problem, Candidate(names, mode, 0.0, 0.0))
    assert sine.sd == pytest.approx(0.04 * 0.5)
    assert cosine.sd == pytest.approx(sine.sd)
