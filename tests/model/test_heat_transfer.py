"""Heat between gas and ambient: Eq. 18-20 and the four rows of Table 2, each evaluated by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model import layout, motor
from model.gas import heat_transfer as heat
from model.gas.cylinder import gas_state

PTM3600 = motor.read_motor("ptm3600")
PARAMETERS = PTM3600.vector()
PISTON_AREA = math.pi * 0.02403**2 / 4.0
PHASES = (heat.COMPRESSION, heat.DISCHARGE, heat.EXPANSION, heat.SUCTION)

# By hand, from rho 2 kg/m3, D 24 mm, mu 18 uPa s, Vp 0.5 m/s, Ug 0.3 m/s: rho D/mu = 8000/3 s/m, and the velocity is
# 0.5; 0.5 + 0.5^0.8 0.3^0.2 = 0.951440; 0.5; 0.5 + 0.5^-0.4 0.3^1.4 = 0.744558 m/s.
TABLE_2 = [
    (heat.COMPRESSION, 1333.3333, 0.08, 0.8),
    (heat.DISCHARGE, 2537.1739, 0.08, 0.8),
    (heat.EXPANSION, 1333.3333, 0.12, 0.8),
    (heat.SUCTION, 1985.4878, 0.08, 0.9),
]


@pytest.mark.parametrize(("phase", "Re", "a", "b"), TABLE_2)
def test_each_row_of_table_2_gives_its_reynolds_number(phase, Re, a, b):
    assert heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.5, 0.3) == pytest.approx(Re, rel=4e-8)


@pytest.mark.parametrize(("phase", "Re", "a", "b"), TABLE_2)
def test_each_row_of_table_2_gives_its_nusselt_number(phase, Re, a, b):
    by_hand = math.exp(math.log(a) + b * math.log(Re) + 0.6 * math.log(0.71))
    assert heat.nusselt(phase, Re, 0.71) == pytest.approx(by_hand, rel=1e-13)


@pytest.mark.parametrize("phase", [heat.DISCHARGE, heat.SUCTION])
@given(scale=st.floats(0.01, 100.0))
def test_the_velocities_of_an_open_cylinder_scale_together(phase, scale):
    """Both added terms are velocities (erratum 3): twice the speeds, twice the Reynolds number."""
    once = heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.5, 0.3)
    assert heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.5 * scale, 0.3 * scale) == pytest.approx(scale * once, rel=1e-12)


@pytest.mark.parametrize("phase", [heat.COMPRESSION, heat.EXPANSION])
def test_a_shut_cylinder_knows_no_gas_velocity(phase):
    assert heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.5, 0.0) == heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.5, 9.0)


@pytest.mark.parametrize("phase", PHASES)
def test_a_piston_at_rest_has_no_reynolds_number(phase):
    assert heat.reynolds(phase, 2.0, 0.024, 18e-6, 0.0, 0.3) == 0.0


def test_equation_20_takes_the_flow_of_either_sign():
    assert heat.gas_velocity(-0.003, 2.0, 0.0015) == pytest.approx(1.0, rel=1e-15)
    assert heat.gas_velocity(0.003, 2.0, 0.0015) == pytest.approx(1.0, rel=1e-15)


def test_the_contact_area_is_the_bore_and_both_ends():
    D, stroke = 0.02, 0.015
    A_p = math.pi * D * D / 4.0
    by_hand = math.pi * D * stroke + 2.0 * A_p
    assert heat.contact_area(A_p * stroke, D, A_p) == pytest.approx(by_hand, rel=1e-15)


@pytest.mark.parametrize(
    ("per_area", "by_hand"),
    [
        # 1/(0.002 10) + w + 1/(0.002 50) = 50 + w + 10 K/W, w = 0.004/(16 0.002) = 0.125 or 0.004/16 = 0.00025
        (True, 20.0 / 60.125),
        (False, 20.0 / 60.00025),
    ],
)
def test_equation_18_adds_three_resistances(per_area, by_hand):
    assert heat.heat_rate(293.0, 273.0, 0.002, 10.0, 50.0, 0.004, 16.0, per_area) == pytest.approx(by_hand, rel=1e-14)


@pytest.mark.parametrize(("H_a", "H_g"), [(0.0, 50.0), (10.0, 0.0)])
def test_without_a_coefficient_on_one_side_no_heat_flows(H_a, H_g):
    assert heat.heat_rate(293.0, 273.0, 0.002, H_a, H_g, 0.004, 16.0, True) == 0.0


def test_a_quartic_is_taken_from_its_place_lowest_order_first():
    coefficients = np.array([9.0, 9.0, 3.0, -2.0, 0.5, 0.25, -0.125])
    by_hand = 3.0 - 2.0 * 1.7 + 0.5 * 1.7**2 + 0.25 * 1.7**3 - 0.125 * 1.7**4
    assert heat.quartic(coefficients, 2, 1.7) == pytest.approx(by_hand, rel=1e-14)


@pytest.mark.parametrize(
    ("phase", "a", "b", "velocity"),
    [
        (heat.COMPRESSION, 0.08, 0.8, lambda V_p, U_g: V_p),
        (heat.DISCHARGE, 0.08, 0.8, lambda V_p, U_g: V_p + V_p**0.8 * U_g**0.2),
        (heat.EXPANSION, 0.12, 0.8, lambda V_p, U_g: V_p),
        (heat.SUCTION, 0.08, 0.9, lambda V_p, U_g: V_p + U_g**1.4 / V_p**0.4),
    ],
)
def test_the_heat_of_a_cylinder_is_all_of_it_together(phase, a, b, velocity):
    P, T, V, V_p, mdot = 1.9e5, 265.0, 4e-6, 0.6, 4e-4
    R, cp = 287.055, 3.5 * 287.055
    mu = 1.716e-5 * (T / 273.15) ** 1.5 * (273.15 + 110.4) / (T + 110.4)
    k = 0.0241 * (T / 273.15) ** 1.5 * (273.15 + 194.0) / (T + 194.0)
    D, rho = 0.02403, P / (R * T)
    A_c = 4.0 * V / D + math.pi * D * D / 2.0
    Re = rho * D * velocity(V_p, mdot / (rho * A_c)) / mu
    H_g = a * Re**b * (mu * cp / k) ** 0.6 * k / D
    by_hand = A_c * (293.15 - T) / (1.0 / 10.0 + 0.005 / 16.0 + 1.0 / H_g)
    gas = gas_state(PARAMETERS, 2e5, PTM3600.with_readings(air="constant").readings.vector())
    found = heat.cylinder_heat(phase, P, T, V, V_p, mdot, PARAMETERS, PISTON_AREA, gas, True)
    assert found == pytest.approx(by_hand, rel=6e-7)  # the quartics' distance from Sutherland's laws


@given(
    phase=st.sampled_from(PHASES),
    P=st.floats(1e5, 3e5),
    T=st.floats(210.0, 390.0),
    V_p=st.floats(1e-3, 3.0),
    mdot=st.floats(-1e-3, 1e-3),
    per_area=st.booleans(),
)
def test_heat_flows_from_warm_to_cold_and_less_than_the_outer_air_can_bring(phase, P, T, V_p, mdot, per_area):
    gas = gas_state(PARAMETERS, 2e5, PTM3600.with_readings(air="constant").readings.vector())
    Q = heat.cylinder_heat(phase, P, T, 4e-6, V_p, mdot, PARAMETERS, PISTON_AREA, gas, per_area)
    most = 10.0 * heat.contact_area(4e-6, 0.02403, PISTON_AREA) * (293.15 - T)
    assert min(0.0, most) <= Q <= max(0.0, most)


def test_the_equations_are_the_same_plain_and_compiled():
    gas = gas_state(PARAMETERS, 2e5, PTM3600.readings.vector())
    for phase in PHASES:
        calls = {
            heat.contact_area: (4e-6, 0.024, PISTON_AREA),
            heat.gas_velocity: (-4e-4, 2.1, 1.6e-3),
            heat.reynolds: (phase, 2.1, 0.024, 1.8e-5, 0.6, 0.2),
            heat.nusselt: (phase, 2100.0, 0.71),
            heat.heat_rate: (293.0, 265.0, 1.6e-3, 10.0, 80.0, 0.005, 16.0, True),
            heat.quartic: (gas, layout.GAS_K, 280.0),
            heat.cylinder_heat: (phase, 1.9e5, 265.0, 4e-6, 0.6, 4e-4, PARAMETERS, PISTON_AREA, gas, False),
        }
        for function, arguments in calls.items():
            assert function(*arguments) == pytest.approx(function.py_func(*arguments), rel=1e-14)
