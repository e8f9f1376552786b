"""Priors: what is unknown in a fit, where each prior comes from, and the way between a value and its normal number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import lognorm, loguniform, norm

from calibration.unknowns import priors
from calibration.unknowns.priors import Unknown
from model.motor import QUANTITIES, read_motor
from rig.recording import read_recording

SWEEP = "pressure_bar_abs,flow_l_min,speed_rpm\n1.6,44,232\n2.0,70,394\n"
NORMAL = Unknown("pressure_offset", "bar", "normal", 0.1, 0.05, "here")
LOGNORMAL = Unknown("roller_friction", "1", "lognormal", 0.008, 2.0, "here")
LOGUNIFORM = Unknown("f_overall", "N m s", "loguniform", 0.01, 0.4, "here")


def found_in(folder: Path) -> dict[str, Unknown]:
    """The unknowns of a recording by name."""
    recording = read_recording(folder)
    motor = priors.at_ambient(read_motor("ptm3600"), recording)
    return {unknown.name: unknown for unknown in priors.unknowns(motor, recording)}


# Values and normal numbers


@pytest.mark.parametrize("unknown", [NORMAL, LOGNORMAL, LOGUNIFORM], ids=lambda unknown: unknown.kind)
@given(z=st.floats(-5.0, 5.0))
def test_a_value_leads_back_to_its_normal_number(unknown, z):
    assert unknown.z(float(unknown.value(np.array(z)))) == pytest.approx(z, abs=1e-8)


@pytest.mark.parametrize(
    ("unknown", "prior"),
    [
        (NORMAL, norm(0.1, 0.05)),
        (LOGNORMAL, lognorm(np.log(2.0), scale=0.008)),
        (LOGUNIFORM, loguniform(0.01, 0.4)),
    ],
    ids=lambda thing: getattr(thing, "kind", ""),
)
def test_a_standard_normal_number_makes_a_value_of_the_named_distribution(unknown, prior):
    z = np.linspace(-3.0, 3.0, 13)
    np.testing.assert_allclose(unknown.value(z), prior.ppf(norm.cdf(z)), rtol=1e-9, atol=1e-12)


def test_a_loguniform_value_never_leaves_its_limits():
    np.testing.assert_allclose(LOGUNIFORM.value(np.array([-60.0, 60.0])), [0.01, 0.4])


def test_draws_are_standard_normal_and_those_of_the_seed():
    drawn = priors.draw([NORMAL, LOGNORMAL], np.random.default_rng(7), 20_000)
    assert drawn.shape == (20_000, 2)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(drawn.std(axis=0), 1.0, atol=0.03)
    np.testing.assert_array_equal(drawn, priors.draw([NORMAL, LOGNORMAL], np.random.default_rng(7), 20_000))


# What is unknown


def test_the_unknowns_are_the_motors_uncertain_parameters_and_three_errors_of_each_instrument(put_recording):
    assert list(found_in(put_recording(("sweep.csv", "steady", SWEEP)))) == [
        *("port_lap", "roller_friction", "f_overall", "inertia"),
        *("ambient_pressure", "ambient_temperature", "inlet_temperature"),
        *("pressure_offset", "pressure_scale", "pressure_noise_scale"),
        *("flow_offset", "flow_scale", "flow_noise_scale"),
        *("speed_offset", "speed_scale", "speed_noise_scale"),
    ]


def test_a_parameter_has_the_prior_of_the_motors_file_in_the_motors_unit(put_recording):
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP)))
    lap, friction, f_overall = (found[name] for name in ("port_lap", "roller_friction", "f_overall"))
    assert (lap.kind, lap.a, lap.b, lap.unit) == ("normal", 8.0, 1.0, "deg")
    assert (friction.kind, friction.a, friction.b, friction.unit) == ("lognormal", 0.008, 2.0, "1")
    assert (f_overall.kind, f_overall.a, f_overall.b, f_overall.unit) == ("loguniform", 0.01, 0.4, "N m s")
    assert all(found[name].unit == QUANTITIES[name].unit for name in found if name in QUANTITIES)


def test_an_instruments_errors_have_the_recordings_figures_in_the_columns_unit(put_recording):
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP)))
    offset, scale, noise = (found[f"flow_{error}"] for error in ("offset", "scale", "noise_scale"))
    assert (offset.kind, offset.a, offset.b, offset.unit) == ("normal", 0.0, 0.5, "L/min")
    assert (scale.kind, scale.a, scale.b, scale.unit) == ("normal", 0.0, 0.02, "1")
    assert (noise.kind, noise.a, noise.b) == ("lognormal", 1.0, 1.35)
    assert (found["pressure_offset"].unit, found["speed_offset"].unit) == ("bar", "rpm")


@pytest.mark.parametrize(
    ("sweep", "absent"),
    [
        ("pressure_bar_abs,speed_rpm\n1.6,232\n", "flow"),
        ("pressure_bar_gauge,flow_l_min\n0.6,44\n", "speed"),
    ],
)
def test_an_absent_channel_has_no_unknowns(put_recording, sweep, absent):
    found = found_in(put_recording(("sweep.csv", "steady", sweep)))
    assert not [name for name in found if name.startswith(absent)]
    assert "pressure_offset" in found


def test_an_error_without_width_is_no_unknown(put_recording):
    folder = put_recording(("sweep.csv", "steady", SWEEP))
    toml = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(toml.replace("scale_sd = 0.002", "scale_sd = 0.0"))
    found = found_in(folder)
    assert "pressure_scale" not in found
    assert "flow_scale" in found


# The ambient and the flywheel


def test_a_recorded_ambient_overrides_the_motors_prior(put_recording):
    ambient = (
        "[ambient]\npressure_bar_abs = 0.98\npressure_sd_bar = 0.002\ntemperature_c = 25.0\ntemperature_sd_k = 1.5\n"
    )
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP), ambient=ambient))
    pressure, air, inlet = (found[name] for name in ("ambient_pressure", "ambient_temperature", "inlet_temperature"))
    assert (pressure.a, pressure.b, pressure.unit) == (pytest.approx(98_000.0), pytest.approx(200.0), "Pa")
    assert (air.a, air.b) == (inlet.a, inlet.b) == (pytest.approx(298.15), 1.5)


def test_a_recorded_ambient_without_an_uncertainty_takes_the_documented_one(put_recording):
    ambient = "[ambient]\npressure_bar_abs = 0.98\ntemperature_c = 25.0\n"
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP), ambient=ambient))
    assert found["ambient_pressure"].b == pytest.approx(150.0)
    assert found["ambient_temperature"].b == 0.5


def test_an_ambient_not_recorded_keeps_the_motors_prior(put_recording):
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP), ambient=""))
    assert (found["ambient_pressure"].a, found["ambient_pressure"].b) == (101_325.0, 800.0)
    assert found["ambient_pressure"].why.startswith("motor ptm3600")


def test_a_recorded_humidity_is_taken_over(put_recording):
    ambient = "[ambient]\nrelative_humidity = 0.2\n"
    recording = read_recording(put_recording(("sweep.csv", "steady", SWEEP), ambient=ambient))
    assert priors.at_ambient(read_motor("ptm3600"), recording)["relative_humidity"].value == 0.2


def test_a_flywheel_leaves_the_rotor_its_own_inertia(put_recording):
    found = found_in(put_recording(("sweep.csv", "steady", SWEEP), more="[rig]\nadded_inertia_kg_m2 = 0.0125\n"))
    assert found["inertia"].a == pytest.approx(0.005)


def test_the_column_of_a_channel_is_the_recordings(put_recording):
    recording = read_recording(put_recording(("sweep.csv", "steady", "pressure_bar_gauge,speed_rpm\n0.6,232\n")))
    assert priors.column_of(recording, "pressure") == "pressure_bar_gauge"
    assert priors.column_of(recording, "flow") is None
