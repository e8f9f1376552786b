"""Moist air: against CoolProp and CIPM-2007, the measured errors as bounds, and as a physicist expects it to behave."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import CoolProp
import numba
import numpy as np
import pytest
from CoolProp.HumidAirProp import HAPropsSI
from hypothesis import given
from hypothesis import strategies as st

from model.gas import _air_equations as equations
from model.gas import air, transport

ROOT = Path(__file__).resolve().parents[2]
TEMPERATURES = [*np.linspace(230.0, 400.0, 18), 273.1, 273.2]
PRESSURES = np.linspace(0.5e5, 8e5, 16)
HUMIDITIES = (0.1, 0.25, 0.5, 0.75, 1.0)

DRY_BOUNDS = {"density": 5.8e-6, "heat capacity": 4.4e-6, "ratio": 4e-6, "viscosity": 8.7e-6, "conductivity": 2.2e-5}
MOIST_BOUNDS = {
    "saturation pressure of IAPWS-95": 7.1e-5,
    "water fraction": 4e-4,
    "density": 3.4e-5,
    "density, x_w <= 0.1": 1.8e-5,
    "heat capacity": 7e-4,
    "heat capacity, x_w <= 0.1": 3.3e-5,
    "ratio": 6.5e-5,
    "ratio, x_w <= 0.1": 2e-5,
    "viscosity by Wilke": 9.3e-6,
    "conductivity by Wilke": 2.5e-5,
    "viscosity of HAPropsSI, x_w <= 0.025": 6.1e-3,
    "conductivity of HAPropsSI, x_w <= 0.025": 1.1e-2,
}

temperature = st.floats(230.0, 399.0)
pressure = st.floats(0.5e5, 7.9e5)
water = st.floats(0.0, 0.33)


class Worst:
    """The largest relative error of each quantity and where it was met; quantities without a bound are refused."""

    def __init__(self, bounds):
        self.bounds = bounds
        self.found = dict.fromkeys(bounds, (0.0, ()))

    def record(self, name, value, reference, *state):
        error = abs(value / reference - 1.0)
        self.found[name] = max(self.found[name], (error, state))

    def check(self):
        lines = [
            f"{name:42s} {error:9.2e}  bound {self.bounds[name]:7.1e}  at {tuple(float(f'{v:.4g}') for v in state)}"
            for name, (error, state) in self.found.items()
        ]
        table = "\n".join(lines)
        print(table)
        assert all(error <= self.bounds[name] for name, (error, _) in self.found.items()), f"\n{table}"


def test_dry_air_agrees_with_lemmon_over_the_whole_range():
    fluid, worst = CoolProp.AbstractState("HEOS", "Air"), Worst(DRY_BOUNDS)
    for T in TEMPERATURES:
        for P in PRESSURES:
            fluid.update(CoolProp.PT_INPUTS, P, T)
            cp, cv = fluid.cpmass(), fluid.cvmass()
            worst.record("density", air.density(T, P, 0.0), fluid.rhomass(), T, P)
            worst.record("heat capacity", air.heat_capacity(T, P, 0.0), cp, T, P)
            worst.record("ratio", air.heat_capacity_ratio(T, P, 0.0), cp / cv, T, P)
            worst.record("viscosity", air.viscosity(T, P, 0.0), fluid.viscosity(), T, P)
            worst.record("conductivity", air.conductivity(T, P, 0.0), fluid.conductivity(), T, P)
    worst.check()


def wilke(T, P, x_w):
    """Viscosity and conductivity from CoolProp's pure fluids and Wilke's rule, written from the paper."""
    dry, steam = CoolProp.AbstractState("HEOS", "Air"), CoolProp.AbstractState("HEOS", "Water")
    dry.update(CoolProp.PT_INPUTS, P, T)
    steam.update(CoolProp.DmolarT_INPUTS, 1e-6, T)
    x, M = np.array([1.0 - x_w, x_w]), np.array([air.molar_mass(0.0), equations.M_WATER])
    mu = np.array([dry.viscosity(), steam.viscosity()])
    k = np.array([dry.conductivity(), steam.conductivity()])
    phi = (1.0 + (mu[:, None] / mu) ** 0.5 * (M / M[:, None]) ** 0.25) ** 2 / (8.0 * (1.0 + M[:, None] / M)) ** 0.5
    return np.sum(x * mu / (phi @ x)), np.sum(x * k / (phi @ x))


def moist_states():
    """States of the grid that are gas and no more than 0.35 water, with the water fraction of CoolProp."""
    for T in TEMPERATURES:
        for P in PRESSURES:
            for humidity in HUMIDITIES:
                p_sv = air.saturation_vapour_pressure(T)
                if humidity * p_sv * 1.05 < 0.35 * P:
                    yield T, P, humidity, HAPropsSI("psi_w", "T", T, "P", P, "R", humidity)


def test_moist_air_agrees_with_rp1485_up_to_saturation():
    worst = Worst(MOIST_BOUNDS)
    for T, P, humidity, x_w in moist_states():
        state = (T, P, humidity, x_w)
        worst.record("water fraction", air.water_fraction(T, P, humidity), x_w, *state)
        known = ("T", T, "P", P, "psi_w", x_w)
        cp, cv = HAPropsSI("cp_ha", *known), HAPropsSI("cv_ha", *known)
        found = {
            "density": (air.density(T, P, x_w), 1.0 / HAPropsSI("Vha", *known)),
            "heat capacity": (air.heat_capacity(T, P, x_w), cp),
            "ratio": (air.heat_capacity_ratio(T, P, x_w), cp / cv),
        }
        for name, (value, reference) in found.items():
            worst.record(name, value, reference, *state)
            if x_w <= 0.1:
                worst.record(f"{name}, x_w <= 0.1", value, reference, *state)
        mu, k = wilke(T, P, x_w)
        worst.record("viscosity by Wilke", air.viscosity(T, P, x_w), mu, *state)
        worst.record("conductivity by Wilke", air.conductivity(T, P, x_w), k, *state)
        if x_w <= 0.025:
            worst.record(
                "viscosity of HAPropsSI, x_w <= 0.025", air.viscosity(T, P, x_w), HAPropsSI("mu", *known), *state
            )
            worst.record(
                "conductivity of HAPropsSI, x_w <= 0.025", air.conductivity(T, P, x_w), HAPropsSI("k", *known), *state
            )
    water = CoolProp.AbstractState("HEOS", "Water")
    for T in np.linspace(273.16, 400.0, 40):
        water.update(CoolProp.QT_INPUTS, 1.0, T)
        worst.record("saturation pressure of IAPWS-95", air.saturation_vapour_pressure(T), water.p(), T)
    worst.check()


# IAPWS R14-08(2011) prints 8.94735e-6 MPa for ice at 230 K; the triple point is 611.657 Pa.
@pytest.mark.parametrize(
    ("T", "p_sv", "digits"), [(230.0, 8.94735, 6), (273.16, 611.657, 6), (273.1599999, 611.657, 6)]
)
def test_saturation_meets_the_printed_values_and_joins_at_the_triple_point(T, p_sv, digits):
    assert air.saturation_vapour_pressure(T) == pytest.approx(p_sv, rel=10.0 ** (1 - digits))


def test_cipm2007_lies_within_the_oiml_approximation_and_near_the_virial_equation():
    """OIML R 111-1, Eq. E.3-1, states 2e-4 over 900-1100 hPa, 10-30 C, below 80 %."""
    worst = Worst({"OIML R 111-1": 2e-4, "virial equation": 2.4e-5})
    for T in np.linspace(288.15, 300.15, 13):
        for P in np.linspace(0.6e5, 1.1e5, 11):
            for humidity in np.linspace(0.0, 1.0, 11):
                rho = air.density_cipm2007(T, P, humidity)
                virial = air.density(T, P, air.water_fraction(T, P, humidity))
                worst.record("virial equation", virial, rho, T, P, humidity)
                if P >= 0.9e5 and humidity <= 0.8:
                    oiml = (0.0034848 * P - 0.9 * humidity * np.exp(0.061 * (T - 273.15))) / T
                    worst.record("OIML R 111-1", rho, oiml, T, P, humidity)
    worst.check()


def test_cipm2007_at_20_degrees_one_atmosphere_and_half_humidity():
    assert air.density_cipm2007(293.15, 101325.0, 0.5) == pytest.approx(1.19931, abs=5e-6)


@pytest.mark.parametrize(
    ("x_w", "bounds"),
    [(0.0, (1.4e-5, 5.4e-5)), (0.025, (9.1e-5, 3.4e-5)), (0.1, (3.8e-4, 1e-4)), (0.35, (1.6e-3, 3.3e-4))],
)
def test_transport_quartics_follow_the_full_equations_down_to_180_kelvin(x_w, bounds):
    worst = Worst(dict(zip(("viscosity", "conductivity"), bounds, strict=True)))
    for P in PRESSURES:
        mu, k = air.transport_polynomials(P, x_w)
        assert mu.shape == k.shape == (5,)
        for T in np.linspace(180.0, 400.0, 45):
            exact = equations.transport(T, P, x_w)
            worst.record("viscosity", transport.polynomial(mu, T), exact[0], T, P)
            worst.record("conductivity", transport.polynomial(k, T), exact[1], T, P)
    worst.check()


def test_the_equations_are_the_same_plain_and_compiled(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    spec = importlib.util.spec_from_file_location("plain_air_equations", equations.__file__)
    plain = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(plain)
    for T, P, x_w, humidity in [(231.0, 7.9e5, 1e-5, 0.4), (293.15, 101325.0, 0.0116, 0.5), (399.0, 6e5, 0.3, 1.0)]:
        arguments = {"T": T, "P": P, "x_w": x_w, "humidity": humidity}
        for name in (
            *("saturation_pressure", "enhancement_factor", "water_fraction", "molar_mass", "gas_constant", "density"),
            *("compressibility", "ideal_heat_capacity", "heat_capacity", "heat_capacity_ratio", "volume_terms"),
            *("transport", "viscosity", "conductivity", "cipm2007_density"),
        ):
            slow, fast = getattr(plain, name), getattr(equations, name)
            given_arguments = [arguments[key] for key in slow.__code__.co_varnames[: slow.__code__.co_argcount]]
            np.testing.assert_allclose(fast(*given_arguments), slow(*given_arguments), rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("function", [transport.sutherland_viscosity, transport.sutherland_conductivity])
def test_sutherland_is_the_same_plain_and_compiled_and_takes_arrays(function):
    T = np.linspace(180.0, 400.0, 12)
    np.testing.assert_allclose(function(T), [function.py_func(t) for t in T], rtol=1e-12)


def test_sutherland_starts_from_the_reference_values():
    assert transport.sutherland_viscosity(273.15) == pytest.approx(1.716e-5, rel=1e-12)
    assert transport.sutherland_conductivity(273.15) == pytest.approx(0.0241, rel=1e-12)


def test_polynomial_is_the_quartic_lowest_order_first():
    c = np.array([3.0, -2.0, 0.5, 0.25, -0.125])
    assert transport.polynomial(c, 1.7) == pytest.approx(np.polynomial.polynomial.polyval(1.7, c), rel=1e-14)


def test_floats_give_a_float_and_arrays_broadcast():
    assert isinstance(air.density(300.0, 1e5, 0.01), float)
    assert air.density(np.full((3, 1), 300.0), np.full(4, 1e5), 0.01).shape == (3, 4)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: air.density(229.9, 1e5, 0.0), "T = 229.9 K is outside 230 to 400 K"),
        (lambda: air.viscosity([300.0, 401.0], 1e5, 0.0), "T = 401 K"),
        (lambda: air.heat_capacity(300.0, 9e5, 0.0), "P = 900000 Pa is outside 50000 to 800000 Pa"),
        (lambda: air.conductivity(300.0, 1e5, -0.1), "x_w = -0.1 mol/mol is outside 0 to 0.35"),
        (lambda: air.water_fraction(300.0, 1e5, 50.0), "humidity = 50 of saturation is outside 0 to 1"),
        (lambda: air.water_fraction(390.0, 1e5, 0.9), "x_w = 1.6"),
        (lambda: air.density_cipm2007(310.0, 1e5, 0.5), "T = 310 K is outside 288.15 to 300.15 K"),
        (lambda: air.transport_polynomials(9e5, 0.0), "P = 900000 Pa"),
        (lambda: air.density(float("nan"), 1e5, 0.0), "T = nan K"),
    ],
)
def test_what_is_out_of_range_is_refused_by_name_value_and_range(call, text):
    with pytest.raises(ValueError, match=text):
        call()


@given(temperature, pressure, water)
def test_density_rises_with_pressure_and_falls_with_temperature_and_water(T, P, x_w):
    rho = air.density(T, P, x_w)
    assert air.density(T, P * 1.01, x_w) > rho > air.density(T + 0.5, P, x_w)
    assert air.density(max(T, 320.0), P, x_w + 0.01) < air.density(max(T, 320.0), P, x_w)


@given(temperature)
def test_saturation_pressure_rises_with_temperature(T):
    assert air.saturation_vapour_pressure(T + 0.01) > air.saturation_vapour_pressure(T)


@given(st.floats(230.0, 320.0), pressure, st.floats(0.0, 0.9))
def test_water_fraction_rises_with_humidity_and_falls_with_pressure(T, P, humidity):
    x_w = air.water_fraction(T, P, humidity)
    assert air.water_fraction(T, P, humidity + 0.1) > x_w
    assert air.water_fraction(T, P * 1.01, humidity) <= x_w


@given(temperature, pressure, water)
def test_viscosity_and_conductivity_rise_with_temperature(T, P, x_w):
    assert air.viscosity(T + 0.5, P, x_w) > air.viscosity(T, P, x_w)
    assert air.conductivity(T + 0.5, P, x_w) > air.conductivity(T, P, x_w)


@given(temperature, st.floats(0.0, 0.33))
def test_ideal_gas_has_a_ratio_between_that_of_steam_and_of_dry_air(T, x_w):
    cp, R = air.ideal_heat_capacity(T, x_w), air.gas_constant(x_w)
    assert 1.3 < cp / (cp - R) < 1.402
    assert air.gas_constant(x_w + 0.01) > R


def test_heat_capacity_is_the_slope_of_the_enthalpy_the_equation_of_state_implies():
    """dcp/dP = -T d2v/dT2, both taken by differences: the hand-made derivatives are right."""
    T, P, x_w, d = 300.0, 3e5, 0.01, 0.5

    def volume(T, P):
        return 1.0 / air.density(T, P, x_w)

    slope = (air.heat_capacity(T, P + 1e3, x_w) - air.heat_capacity(T, P - 1e3, x_w)) / 2e3
    curvature = (volume(T + d, P) - 2.0 * volume(T, P) + volume(T - d, P)) / d**2
    assert slope == pytest.approx(-T * curvature, rel=1e-4)


@pytest.mark.long
def test_the_committed_coefficients_are_what_coolprop_gives():
    script = ROOT / "scripts" / "air_polynomials.py"
    run = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
