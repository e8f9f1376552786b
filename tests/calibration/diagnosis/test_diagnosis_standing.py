"""The flow meter while the rotor stands: what leaks shows there, and nothing else does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.diagnosis import as_json, diagnose
from calibration.likelihood.descent import find
from calibration.report.diagnosis.figures import held_rotor
from calibration.report.diagnosis.numbers import models
from calibration.report.diagnosis.page import report
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.kinds import STANDING
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.unknowns.priors import at_ambient
from model.effects import effects
from model.effects.effect import unknown_state
from model.layout import L_MIN
from model.motor import read_motor
from rig.recording import read_recording
from tests import diagnosis_recordings as recordings

LEAK = {"conductance_kg_s_pa2": 2e-14, "exponent": 1.0}


def leak_at(pressure: float) -> float:
    """What leaks [kg/s]."""
    law = effects()["leakage"].leak
    assert law is not None
    state = replace(unknown_state(np.ones(1)), pressure=np.array([pressure]), ambient=np.array([1.01325e5]))
    return float(law(LEAK, state)[0])


def lead_of_a_leak(folder: Path, rival: str) -> float:
    """Log evidence of a leak less that of an effect on the flow meter."""
    comparison = Comparison(Problem(read_recording(folder)))
    base = base_of(comparison)
    leak, other = (find(comparison, (name,), base, None) for name in ("leakage", rival))
    return leak.log_evidence - other.log_evidence


def test_a_held_rotor_tells_a_leak_from_a_meter_that_is_off(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {"leakage": LEAK})
    without = lead_of_a_leak(tmp_path, "flow_offset")
    recordings.add_held_rotor(tmp_path, 5, leak_at(2.0e5))
    held = lead_of_a_leak(tmp_path, "flow_offset")
    assert held > without + 5.0


def test_a_held_rotor_without_a_flow_speaks_against_a_leak(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {"flow_scale": {"scale": 0.3}})
    without = lead_of_a_leak(tmp_path, "flow_scale")
    recordings.add_held_rotor(tmp_path, 5, 0.0)
    held = lead_of_a_leak(tmp_path, "flow_scale")
    assert held < without - 5.0


@pytest.mark.long
def test_a_held_rotor_is_pictured_in_the_report(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {"leakage": LEAK})
    recordings.add_held_rotor(tmp_path, 5, leak_at(2.0e5))
    found = diagnose(read_recording(tmp_path), seed=1)
    assert b"Flow with the rotor held" in report(found, as_json(found))["report.html"]
    picture = held_rotor(found, models(found))
    assert picture.startswith(b"\x89PNG")
    assert picture != held_rotor(found, models(found)[:1])


def test_a_held_rotor_is_read_as_one_mean_of_its_flow(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    comparison = Comparison(Problem(recordings.add_held_rotor(tmp_path, 5, leak_at(2.0e5))))
    standing, rows = comparison.problem.blocks.standing, comparison.kind == STANDING
    assert standing.file == ("held.csv",)
    assert standing.time[0] == pytest.approx(1318.0)
    assert standing.sd[0] * L_MIN == pytest.approx(np.hypot(0.8 / np.sqrt(10.0), 0.5 / np.sqrt(12.0)))
    assert comparison.read[rows] == pytest.approx(standing.flow)
    predicted = comparison.problem.predict(np.zeros(len(comparison.problem.nuisances)), {"leakage": LEAK})
    motor = at_ambient(read_motor("ptm3600"), comparison.problem.recording)
    density = standing.pressure[0] / (287.05 * motor.si("inlet_temperature"))
    assert predicted.standing[0] == pytest.approx(leak_at(standing.pressure[0]) / density, rel=2e-3)  # of dry air


def test_a_meter_that_shows_nothing_counts_as_one_reading(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    recordings.add_held_rotor(tmp_path, 5, 0.0)
    text = (tmp_path / "held.csv").read_text(encoding="utf-8").splitlines()
    shown = [",".join([*row.split(",")[:2], "0.0", "0.0", "1"]) for row in text[1:]]
    (tmp_path / "held.csv").write_text("\n".join([text[0], *shown]) + "\n", encoding="utf-8")
    standing = Problem(read_recording(tmp_path)).blocks.standing
    assert standing.flow[0] == 0.0
    assert standing.sd[0] * L_MIN == pytest.approx(np.hypot(0.8, 0.5 / np.sqrt(12.0)))


def test_the_meter_with_the_line_vented_shows_its_offset(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    recordings.add_held_rotor(tmp_path, 5, 0.0)
    toml = (tmp_path / "recording.toml").read_text(encoding="utf-8")
    zero = '{ file = "held.csv", kind = "zero", start_s = 1300.0 }'
    (tmp_path / "recording.toml").write_text(
        toml.replace('{ file = "held.csv", kind = "steady", start_s = 1300.0 }', zero), encoding="utf-8"
    )
    (tmp_path / "held.csv").write_text("pressure_bar_abs,flow_l_min\n1.013,1.5\n1.013,1.0\n1.014,1.5\n", "utf-8")
    problem = Problem(read_recording(tmp_path))
    assert np.isnan(problem.blocks.standing.pressure[0])
    z = np.zeros(len(problem.nuisances))
    place = problem.place("flow_offset")
    assert place is not None
    assert problem.predict(z, {"leakage": LEAK}).standing[0] == pytest.approx(0.0, abs=1e-12)
    z[place] = 2.0
    assert problem.predict(z, {}).standing[0] * L_MIN == pytest.approx(1.0)
