"""What a recording can tell of each effect, before anything is refitted."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.diagnosis.sizes.resolves import Resolved, resolved
from calibration.likelihood.descent import find
from calibration.likelihood.signatures import signatures
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from model.effects import effects
from tests.diagnosis_recordings import sweep


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, dict[str, Resolved]]:
    """A sweep with nothing concealed, and what it can tell by effect."""
    comparison = Comparison(Problem(sweep(tmp_path_factory.mktemp("clean"), 11, {})))
    base = base_of(comparison)
    found = resolved(comparison, base, base.u, signatures(comparison, base))
    return comparison, {one.effect: one for one in found}


@pytest.mark.parametrize("name", ["flow_offset", "coulomb_friction", "windage"])
def test_a_size_is_seen_from_five_sds_that_a_refit_gives_it(clean, name: str) -> None:
    """The refit is another way: the curvature of the whole posterior with the effect in it."""
    comparison, found = clean
    refit = find(comparison, (name,))
    place = len(comparison.problem.nuisances)
    unknown = comparison.problem.effect_unknowns((name,))[0][1]
    sd = math.sqrt(refit.covariance[place, place])
    low, high = unknown.value(refit.z[place] + sd * np.array([-1.0, 1.0]))
    assert found[name].seen_from == pytest.approx(5.0 * (high - low) / 2.0, rel=0.3)


def test_to_be_named_takes_more_than_to_be_seen(clean) -> None:
    for one in clean[1].values():
        assert 0.0 <= one.rho <= 1.0 and one.nearest != one.effect
        if one.told_from is not None:
            assert one.seen_from is not None
            assert 1.4 * one.seen_from <= one.told_from * 1.0001
            assert one.told_from <= effects()[one.effect].amplitude.high
            # D >= 7, and D sqrt((1 - rho)/2) >= 2.326
            needed = max(7.0, 2.3263 / math.sqrt((1.0 - one.rho) / 2.0))
            assert one.told_from == pytest.approx(one.seen_from * needed / 5.0, rel=1e-3)
    assert all(clean[1][name].told_from is not None for name in ("windage", "leakage", "stribeck_friction"))


def test_what_a_sweep_cannot_part_is_named_at_no_believable_size(clean) -> None:
    """Dry friction, a rolling one, and a gauge that reads high: speed by speed the same."""
    found = clean[1]
    assert found["coulomb_friction"].told_from is None
    assert found["coulomb_friction"].rho > 0.99
    assert found["inlet_throttling"].nearest == "exhaust_back_pressure"


def test_a_loud_tachometer_sees_less(tmp_path: Path) -> None:
    seen = []
    for speed_rpm in (0.4, 40.0):
        recording = sweep(tmp_path, 11, {})
        quiet = recording.channels["speed_rpm"]
        louder = replace(recording, channels={**recording.channels, "speed_rpm": replace(quiet, noise_sd=speed_rpm)})
        comparison = Comparison(Problem(louder))
        base = base_of(comparison)
        found = resolved(comparison, base, np.zeros_like(base.u), signatures(comparison, base))
        seen.append(next(one.seen_from for one in found if one.effect == "stribeck_friction"))
    assert seen[0] is not None and (seen[1] is None or seen[1] > 1.5 * seen[0])
