"""An instrument that drifts between days: a later offset is the first day's and a drift, as normal theory has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tests.diagnosis_recordings as recordings
from calibration.data.joined import as_given
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from calibration.systems.look_up import compared
from calibration.systems.several.comparison import Several
from rig.recording import Column, Recording, read_recording, write_recording

BIAS, DRIFT = 1.5, 0.3  # of the flow meter [L/min]
FURTHER = 0.3  # what its offset has grown by on the second day [L/min]


def on(
    folder: Path, seed: int, date: str, further: float, serial: str | None = "FM-7", drift: float = 0.0
) -> Recording:
    """A sweep of a day, whose flows read higher than they are by so much."""
    if not folder.exists():
        recordings.sweep(folder, seed, {})
    found = read_recording(folder)
    (file,) = found.files
    flow = file.columns["flow_l_min"]
    columns = {**file.columns, "flow_l_min": Column(flow.values + further, flow.censor)}
    figures = {**found.channels}
    figures["flow_l_min"] = replace(figures["flow_l_min"], serial=serial, drift_sd=drift, bias_sd=BIAS)
    return replace(
        found, files=(replace(file, columns=columns),), channels=figures, origin={"date": date}, sha256=f"{folder}"
    )


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory):
    """Two or three days with the same flow meter, as one vector."""
    root = tmp_path_factory.mktemp("days")

    def made(*dates: str, **keys) -> Several:
        each = [on(root / f"n{i}", 3, date, FURTHER * (i > 0), **keys) for i, date in enumerate(dates)]
        found = compared(each)
        assert isinstance(found, Several)
        return found

    return made


def value(several: Several, mode: Mode, k: int) -> tuple[float, float]:
    """A recording's own offset of the flow, and its standard deviation [L/min]."""
    own, place = several.of_part(k, mode), several.parts[k].problem.place("flow_offset")
    assert place is not None
    return BIAS * float(own.z[place]), BIAS * float(np.sqrt(own.covariance[place, place]))


@pytest.mark.parametrize("drift", [0.1, DRIFT, 50.0])
def test_the_offsets_are_those_of_theory(days, drift: float) -> None:
    """What independent errors give, with the prior of linked ones in its place: normal and linear, in closed form."""
    apart = days("2026-05-01", "2026-05-02", serial=None)
    mode = apart.base()
    names = [one.name for one in apart.problem.nuisances]
    precision = np.linalg.inv(mode.covariance)
    linked = precision.copy()
    for error, share in (("flow_offset", drift / BIAS), ("flow_scale", 1e-4)):
        places = [names.index(f"n{k}: {error}") for k in (0, 1)]
        linked[np.ix_(places, places)] += np.linalg.inv([[1.0, 1.0], [1.0, 1.0 + share**2]]) - np.eye(2)
    z, covariance = np.linalg.solve(linked, precision @ mode.z), np.linalg.inv(linked)
    drifting = days("2026-05-01", "2026-05-02", drift=drift)
    found = drifting.base()
    for k in (0, 1):
        place = names.index(f"n{k}: flow_offset")
        mean, sd = value(drifting, found, k)
        expected = BIAS * np.sqrt(covariance[place, place])
        assert sd == pytest.approx(expected, rel=0.03)
        assert mean == pytest.approx(BIAS * z[place], abs=0.1 * expected)


def test_without_a_drift_the_offset_is_one(days) -> None:
    shared = days("2026-05-01", "2026-05-02")
    names = [one.name for one in shared.problem.nuisances]
    assert names.count("FM-7: flow_offset") == 1 and not any("drift" in name for name in names)
    hardly = days("2026-05-01", "2026-05-02", drift=1e-4)
    one, other = shared.base(), hardly.base()
    assert value(shared, one, 0) == value(shared, one, 1)
    assert value(hardly, other, 1) == pytest.approx(value(shared, one, 1), rel=0.02)


def test_a_drift_is_of_each_later_day_and_one_day_has_one(days) -> None:
    several = days("2026-05-01", "2026-05-02T09:00:00Z", "2026-05-02T15:00:00Z", drift=DRIFT)
    drifts = [one for one in several.problem.nuisances if one.name.endswith("_drift")]
    assert [(one.name, one.unit, one.b) for one in drifts] == [("n1: flow_offset_drift", "L/min", DRIFT)]
    several = days("2026-05-01", "", "", drift=DRIFT)  # a recording without a date is of a day of its own
    names = [one.name for one in several.problem.nuisances if one.name.endswith("_drift")]
    assert names == ["n1: flow_offset_drift", "n2: flow_offset_drift"]


def test_the_first_recording_need_not_know_of_the_drift(tmp_path: Path) -> None:
    each = [on(tmp_path / f"n{i}", 3, f"2026-05-0{i + 1}", 0.0, drift=DRIFT * i) for i in (0, 1)]
    names = [one.name for one in compared(each).problem.nuisances]
    assert names.count("FM-7: flow_offset") == names.count("n1: flow_offset_drift") == 1


def test_known_derivatives_are_those_of_differences(days) -> None:
    several = days("2026-05-01", "2026-05-02", drift=DRIFT)
    f, z = Function(several, ()), np.random.default_rng(1).normal(0.0, 0.3, len(several.problem.nuisances))
    start = several.raw(f(z))
    seen = []
    for i, one in enumerate(several.problem.nuisances):
        known = several.known_derivative(i, z, start, ())
        if known is not None and "flow" in one.name:
            seen.append(one.name)
            moved = z.copy()
            moved[i] += 1e-4
            difference = (several.raw(f(moved)) - start) / 1e-4
            np.testing.assert_allclose(np.nan_to_num(difference), np.nan_to_num(known), atol=1e-4 * np.abs(known).max())
    assert seen == ["FM-7: flow_offset", "FM-7: flow_scale", "n1: flow_offset_drift"]


def test_recordings_alike_in_all_are_one_unless_their_instruments_drift(tmp_path: Path) -> None:
    for drift, dates, count in (
        (0.0, ("2026-05-01", "2026-05-02"), 1),
        (DRIFT, ("2026-05-01", "2026-05-01"), 1),
        (DRIFT, ("2026-05-01", "2026-05-02"), 2),
    ):
        each = [on(tmp_path / f"n{i}", 3, date, 0.0, drift=drift) for i, date in enumerate(dates)]
        assert len(as_given(each)) == count


def test_a_drift_is_written_and_read(tmp_path: Path) -> None:
    write_recording(on(tmp_path / "one", 3, "2026-05-01", 0.0, drift=DRIFT), tmp_path / "copy")
    assert read_recording(tmp_path / "copy").channels["flow_l_min"].drift_sd == DRIFT
    assert read_recording(tmp_path / "copy").channels["speed_rpm"].drift_sd == 0.0
    assert (tmp_path / "copy" / "recording.toml").read_text().count("drift_sd") == 1
