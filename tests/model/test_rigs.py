"""Other rigs: the same motion equation and effects, and what a fit finds in data whose truth is known."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration.likelihood.descent import find
from calibration.likelihood.mode import Mode
from calibration.systems.machines.comparison import Comparison
from calibration.systems.machines.problem import Problem
from model.effects import effects
from model.layout import L_MIN, RPM
from model.rigs.displacement_machine import rows
from model.rigs.driven_axis import blocks_of, drive
from model.rigs.free_rotor import coast
from model.rigs.state import MOTOR, Sizes, scaled
from rig.exchange.importing import import_files
from rig.exchange.mapping import read_mapping
from rig.recording import RecordingError, read_recording

SHARED = Path(__file__).resolve().parents[3] / "shared"
RECORDINGS = Path(os.environ.get("SPINBENCH_RECORDINGS", SHARED / "recordings"))
TIME = np.arange(0.0, 20.0, 0.2)
J, F = 0.02, 0.003
ATM = 101_325.0
Put = Callable[..., Comparison]


def marched(torque: Callable[[float], float], first: float = 60.0, step: float = 1e-3) -> np.ndarray:
    """Mean speed since the sample before of J domega/dt = -F omega - torque, by another integrator (midpoint)."""
    omega, angle, angles = first, 0.0, [0.0]
    per = round((TIME[1] - TIME[0]) / step)
    for _ in range(1, TIME.size):
        for _ in range(per):
            half = omega - 0.5 * step * (F * omega + torque(omega)) / J
            new = max(omega - step * (F * half + torque(half)) / J, 0.0)
            angle, omega = angle + 0.5 * step * (omega + new), new
        angles.append(angle)
    return np.concatenate([[first], np.diff(angles) / np.diff(TIME)])


@pytest.fixture
def put(tmp_path: Path) -> Put:
    """A problem from a recording written as a person would write it."""

    def written(motor: str, kind: str, figures: str, columns: dict[str, np.ndarray]) -> Comparison:
        (tmp_path / "recording.toml").write_text(
            'format = "recording/1"\n[ambient]\npressure_bar_abs = 1.01325\ntemperature_c = 20.0\n'
            f'{figures}\n[[files]]\nfile = "data.csv"\nkind = "{kind}"\n[motor]\n{motor}\n',
            encoding="utf-8",
        )
        lines = [",".join(columns)]
        lines += [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
        (tmp_path / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return Comparison(Problem(read_recording(tmp_path)))

    return written


def test_a_free_rotor_with_viscous_friction_alone_slows_exponentially() -> None:
    found = coast(J, F, TIME, 60.0, {})
    assert found.speed == pytest.approx(60.0 * np.exp(-F / J * TIME))
    assert found.angle[-1] == pytest.approx(J / F * (60.0 - found.speed[-1]))


def test_dry_friction_stops_a_free_rotor_when_the_equation_says() -> None:
    dry = 0.05
    stop = J / F * np.log1p(F * 60.0 / dry)
    found = coast(
        J, F, np.array([0.0, stop - 0.01, stop + 0.01, stop + 5.0]), 60.0, {"coulomb_friction": {"torque_nm": dry}}
    )
    assert found.speed[1] == pytest.approx(dry / J * 0.01, rel=0.01)
    assert found.speed[2:].tolist() == [0.0, 0.0]
    assert found.angle[3] == found.angle[2]


@pytest.mark.parametrize(
    ("name", "values", "torque"),
    [
        ("windage", {"drag_nm_s2": 5e-5}, lambda w: 5e-5 * w * w),
        ("coulomb_friction", {"torque_nm": 0.02}, lambda w: 0.02 * (w > 0.0)),
        ("stribeck_friction", {"torque_nm": 0.05, "speed_rad_s": 20.0}, lambda w: 0.05 * np.exp(-((w / 20.0) ** 2))),
    ],
)
def test_a_free_rotor_with_an_effect_slows_as_another_integrator_says(
    name: str, values: dict[str, float], torque: Callable[[float], float]
) -> None:
    assert coast(J, F, TIME, 60.0, {name: values}).reading == pytest.approx(marched(torque), abs=0.01)


def test_an_imbalance_swings_a_free_rotor_once_a_turn_and_costs_it_nothing() -> None:
    time = np.arange(0.0, 2.0, 0.01)
    bare, swung = (
        coast(J, 0.0, time, 30.0, chosen)
        for chosen in ({}, {"once_per_rev_torque": {"sine_nm": 0.1, "cosine_nm": 0.0}})
    )
    energy = 0.5 * J * swung.speed**2 + 0.1 * (1.0 - np.cos(swung.angle))
    assert energy == pytest.approx(0.5 * J * bare.speed**2, rel=2e-3)
    assert np.ptp(swung.speed) > 0.1


def test_a_slide_needs_its_inertia_and_its_friction_and_dry_friction_with_the_sign_of_its_motion() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    v = 0.1 * np.sin(2.0 * np.pi * 0.25 * time)
    a = 0.1 * 2.0 * np.pi * 0.25 * np.cos(2.0 * np.pi * 0.25 * time)
    force = 95.0 * a + 200.0 * v + 20.0 * np.sign(v)
    blocks = blocks_of(time, force, v, 5, 0.005)
    found = drive(95.0, 200.0, blocks, {"coulomb_friction": {"torque_nm": 20.0}})
    assert blocks.used.sum() > 150
    assert found[blocks.used] == pytest.approx(blocks.mean(force)[blocks.used], abs=0.02)
    assert set(np.sign(blocks.mean(v)[blocks.used])) == {-1.0, 1.0}


def test_another_inertia_of_an_axis_leaves_its_flywheel_as_it_is() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    blocks = blocks_of(time, np.zeros(time.size), 3.0 * time, 5, 0.0)
    heavier, plain = (drive(0.02, 0.0, blocks, {"inertia": {"share": 0.5}}, flywheel=own) for own in (0.015, 0.0))
    assert heavier == pytest.approx(3.0 * (0.005 * 1.5 + 0.015))
    assert plain == pytest.approx(3.0 * 0.02 * 1.5)


def test_blocks_near_standstill_are_left_out() -> None:
    v = np.linspace(-1.0, 1.0, 101)
    blocks = blocks_of(np.arange(101) * 0.01, v, v, 5, 0.1)
    middle = blocks.mean(v)
    assert np.all(np.abs(middle[blocks.used]) > 0.1)
    assert not blocks.used[np.abs(middle) < 0.1].any()


def machine(
    chosen: dict[str, dict[str, float]], P: float = 3e5, speed: float = 100.0, V: float = 1e-4
) -> tuple[float, float]:
    """Torque and flow of one row."""
    one = np.ones(1)
    found = rows(V, 0.002, speed * one, P * one, 293.15 * one, ATM, one, chosen)
    return float(found.torque[0]), float(found.flow[0])


def test_a_displacement_machine_turns_its_volume_and_delivers_its_pressure() -> None:
    torque, flow = machine({})
    assert flow == pytest.approx(1e-4 * 100.0 / (2.0 * np.pi))
    assert torque == pytest.approx(0.002 * 100.0 - 1e-4 * (3e5 - ATM) / (2.0 * np.pi))


def test_a_leak_of_a_displacement_machine_flows_at_standstill_too() -> None:
    _, flow = machine({"leakage": {"conductance_kg_s_pa2": 1e-14}}, speed=0.0)
    assert flow == pytest.approx(1e-14 * (3e5**2 - ATM**2) * 287.05 * 293.15 / 3e5)


def test_throttling_costs_a_displacement_machine_torque_and_flow_alike() -> None:
    chosen = {"inlet_throttling": {"loss_pa_s2_m6": 2e10}}
    (bare_torque, bare_flow), (torque, flow) = machine({}), machine(chosen)
    behind = 3e5 * flow / bare_flow
    drop = 2e10 * (3e5 / (287.05 * 293.15)) / 2.38 * flow**2
    assert 3e5 - behind == pytest.approx(drop, rel=1e-6)
    assert torque - bare_torque == pytest.approx(1e-4 * drop / (2.0 * np.pi), rel=1e-6)


@pytest.mark.parametrize("name", ["coulomb_friction", "windage", "leakage", "inlet_throttling", "load_friction"])
def test_an_effect_switched_off_changes_no_bit_on_any_rig(name: str) -> None:
    off = {name: {effects()[name].amplitude.name: 0.0}}
    assert machine(off) == machine({})
    assert np.array_equal(coast(J, F, TIME, 60.0, off).reading, coast(J, F, TIME, 60.0, {}).reading)


def test_a_parameter_s_bounds_and_scale_follow_the_rig_s_size() -> None:
    windage, dry = effects()["windage"].amplitude, effects()["coulomb_friction"].amplitude
    larger = Sizes(torque=10.0 * MOTOR.torque, speed=2.0 * MOTOR.speed)
    assert scaled(dry, larger).high == pytest.approx(10.0 * dry.high)
    assert scaled(windage, larger).scale == pytest.approx(2.5 * windage.scale)
    assert scaled(effects()["flow_scale"].amplitude, larger) == effects()["flow_scale"].amplitude


ROTOR = f'kind = "free_rotor"\ninertia_kg_m2 = {J}'
TACHOMETER = "[channels.speed_rpm]\nnoise_sd = 0.5\nbias_sd = 0.1\nscale_sd = 0.0005\nresolution = 0.1"


def rotor(put: Put, torque: Callable[[float], float]) -> Comparison:
    """A coast-down with that torque in it, read with noise."""
    speed = marched(torque) * RPM
    moving = speed > 20.0
    noise = np.random.default_rng(1).normal(0.0, 0.5, speed.size)
    columns = {"time_s": TIME[moving], "speed_rpm": np.round((speed + noise)[moving], 1)}
    return put(ROTOR, "transient", TACHOMETER, columns)


def could_show(comparison: Comparison) -> list[str]:
    """Ids of the effects that a recording could show."""
    return [effect.id for effect in comparison.problem.effects_that_could()]


def gains(comparison: Comparison) -> dict[str, float]:
    """Logarithm of the evidence of each effect alone, over that of none."""
    base = find(comparison, ()).log_evidence
    return {name: find(comparison, (name,)).log_evidence - base for name in could_show(comparison)}


def estimate(comparison: Comparison, mode: Mode, name: str) -> tuple[float, float]:
    """Mean and deviation of an unknown by its name, an effect's as ``effect.parameter``."""
    known = [(one.name, one) for one in comparison.problem.nuisances]
    known += [(f"{effect}.{one.name}", one) for effect, one in comparison.problem.effect_unknowns(mode.names)]
    i = [label for label, _ in known].index(name)
    low, mean, high = known[i][1].value(mode.z[i] + np.sqrt(mode.covariance[i, i]) * np.array([-1.0, 0.0, 1.0]))
    return float(mean), float(high - low) / 2.0


def covers(comparison: Comparison, mode: Mode, name: str, truth: float) -> bool:
    """Whether an estimate lies within three of its deviations of the truth."""
    mean, sd = estimate(comparison, mode, name)
    return abs(mean - truth) < 3.0 * sd


def test_dry_friction_of_a_free_rotor_is_found_and_no_rival_comes_near(put: Put) -> None:
    problem = rotor(put, lambda w: 0.02 * (w > 0.0))
    gain = gains(problem)
    best = max(gain, key=lambda name: gain[name])
    assert best == "coulomb_friction"
    assert gain.pop(best) > 20.0 + max(gain.values())
    mode = find(problem, (best,))
    assert covers(problem, mode, "coulomb_friction.torque_nm", 0.02)
    assert covers(problem, mode, "viscous_friction", F)
    assert problem.noise.told(mode.u)[0]["scale"] == pytest.approx(1.0, abs=0.2)


def test_nothing_is_gained_where_viscous_friction_is_all(put: Put) -> None:
    problem = rotor(put, lambda w: 0.0)
    assert max(gains(problem).values()) < 2.0
    assert covers(problem, find(problem, ()), "viscous_friction", F)


MACHINE = 'kind = "displacement_machine"\ndisplacement_m3_per_rev = 1e-4'
FLOW_METER = """[channels.flow_l_min]
noise_sd = 1.0
bias_sd = 1.0
scale_sd = 0.02
resolution = 0.1
"""
METERS = """
[channels.pressure_bar_abs]
noise_sd = 0.002
bias_sd = 0.005
scale_sd = 0.002
resolution = 0.001
[channels.speed_rpm]
noise_sd = 0.5
bias_sd = 0.1
scale_sd = 0.0005
resolution = 0.1
[channels.torque_nm]
noise_sd = 0.02
bias_sd = 0.02
scale_sd = 0.005
resolution = 0.001
"""


def brake(put: Put, chosen: dict[str, dict[str, float]]) -> Comparison:
    """Steady rows of a displacement machine at 4 pressures and 5 speeds."""
    rng = np.random.default_rng(2)
    P, speed = (grid.ravel() for grid in np.meshgrid([2e5, 3e5, 4e5, 6e5], [20.0, 60.0, 100.0, 150.0, 200.0]))
    found = rows(1e-4, 0.004, speed, P, np.full(P.size, 293.15), ATM, np.zeros(P.size), chosen)
    columns = {
        "pressure_bar_abs": P / 1e5 + rng.normal(0.0, 0.002, P.size),
        "flow_l_min": found.flow * L_MIN + rng.normal(0.0, 1.0, P.size),
        "speed_rpm": speed * RPM,
        "torque_nm": found.torque + rng.normal(0.0, 0.02, P.size),
    }
    return put(MACHINE, "steady", METERS + FLOW_METER, columns)


@pytest.mark.parametrize(
    ("name", "parameter", "truth"),
    [
        ("leakage", "conductance_kg_s_pa2", 1.5e-14),
        ("inlet_throttling", "loss_pa_s2_m6", 5e9),
        ("coulomb_friction", "torque_nm", 0.3),
    ],
)
def test_what_a_displacement_machine_lacks_is_found(put: Put, name: str, parameter: str, truth: float) -> None:
    problem = brake(put, {name: {parameter: truth}})
    gain = gains(problem)
    assert max(gain, key=lambda one: gain[one]) == name
    assert gain[name] > 5.0
    assert covers(problem, find(problem, (name,)), f"{name}.{parameter}", truth)


def test_a_machine_without_a_flow_meter_is_not_asked_about_leaks(put: Put) -> None:
    columns = {
        "pressure_bar_abs": np.array([2.0, 3.0, 4.0, 5.0]),
        "speed_rpm": np.array([500.0, 600.0, 700.0, 800.0]),
        "torque_nm": np.array([-1.0, -2.5, -4.0, -5.5]),
    }
    problem = put(MACHINE, "steady", METERS, columns)
    assert {"leakage", "flow_scale", "flow_offset"}.isdisjoint(could_show(problem))


def test_a_rig_without_the_files_that_its_kind_needs_is_refused(put: Put) -> None:
    columns = {"pressure_bar_abs": np.array([2.0, 3.0]), "speed_rpm": np.array([500.0, 600.0])}
    with pytest.raises(RecordingError, match="free_rotor: no transient file"):
        put(ROTOR, "steady", TACHOMETER, columns)


@pytest.mark.skipif(not (RECORDINGS / "emps").is_dir(), reason="the public recordings are not here")
def test_the_dry_friction_of_emps_is_found_and_nothing_beyond_it(tmp_path: Path) -> None:
    """Published: viscous friction 203.5 N s/m, dry friction 20.4 N, offset -3.2 N at a mass of 95.1 kg."""
    folder = import_files([RECORDINGS / "emps" / "DATA_EMPS.mat"], read_mapping("emps"), tmp_path / "emps")
    problem = Comparison(Problem(read_recording(folder)))
    base, dry = find(problem, ()), find(problem, ("coulomb_friction",))
    assert dry.log_evidence > base.log_evidence + 100.0
    assert estimate(problem, dry, "coulomb_friction.torque_nm")[0] == pytest.approx(20.4, abs=1.0)
    assert estimate(problem, dry, "viscous_friction")[0] == pytest.approx(203.5, abs=10.0)
    assert estimate(problem, dry, "drive_offset")[0] == pytest.approx(-3.2, abs=0.8)
    for name in ("windage", "friction_warm_up", "inertia"):
        more = find(problem, ("coulomb_friction", name))
        assert more.log_evidence < dry.log_evidence + 3.0, name
