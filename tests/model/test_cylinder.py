"""The gas in one cylinder: ports and phases at their edges, Eq. 12-17 by hand, filling and blow-down."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model import layout, motor
from model.gas import air, cylinder
from model.gas.cylinder import CLOSED, INLET, OUTLET
from model.gas.heat_transfer import COMPRESSION, DISCHARGE, EXPANSION, SUCTION

PTM3600 = motor.read_motor("ptm3600")
DRY = PTM3600.with_readings(air="constant")
GAS = cylinder.gas_state(DRY.vector(), 2e5, DRY.readings.vector())
R, CP = 287.055, 3.5 * 287.055
CV = CP - R
GAMMA = 1.4
LAP = math.radians(8.0)
LOBE = 0.5 * math.pi

pressure = st.floats(0.9e5, 4e5)
temperature = st.floats(200.0, 400.0)
volume = st.floats(3e-7, 8e-6)


@pytest.mark.parametrize(
    ("edge_deg", "before", "after"),
    [(8.0, CLOSED, OUTLET), (37.0, OUTLET, CLOSED), (53.0, CLOSED, INLET), (82.0, INLET, CLOSED)],
)
def test_a_port_opens_and_shuts_at_its_edge(edge_deg, before, after):
    edge = math.radians(edge_deg)
    assert cylinder.port_at(edge - 1e-9, LAP, LOBE) == before
    assert cylinder.port_at(edge + 1e-9, LAP, LOBE) == after


def test_an_edge_belongs_to_what_begins_there():
    half = 0.25 * math.pi
    assert cylinder.port_at(LAP, LAP, LOBE) == OUTLET
    assert cylinder.port_at(half - LAP, LAP, LOBE) == CLOSED
    assert cylinder.port_at(half + LAP, LAP, LOBE) == INLET
    assert cylinder.port_at(LOBE - LAP, LAP, LOBE) == CLOSED


@pytest.mark.parametrize("dead_centre", [0.0, 0.25 * math.pi])
def test_both_ports_are_shut_at_the_dead_centres(dead_centre):
    assert cylinder.port_at(dead_centre, LAP, LOBE) == CLOSED


@given(st.floats(1e-6, LOBE - 1e-6), st.floats(0.01, 0.3))
def test_the_ports_are_symmetric_as_the_motor_is_reversible(psi, lap):
    swapped = {OUTLET: INLET, INLET: OUTLET, CLOSED: CLOSED}
    edges = (lap, LOBE / 2 - lap, LOBE / 2 + lap, LOBE - lap)
    if min(abs(psi - edge) for edge in edges) > 1e-12:
        assert cylinder.port_at(LOBE - psi, lap, LOBE) == swapped[cylinder.port_at(psi, lap, LOBE)]


@pytest.mark.parametrize(
    ("port", "dV", "phase"),
    [
        (OUTLET, -1.0, DISCHARGE),
        (OUTLET, 1.0, DISCHARGE),
        (INLET, 1.0, SUCTION),
        (INLET, -1.0, SUCTION),
        (CLOSED, -1e-9, COMPRESSION),
        (CLOSED, 1e-9, EXPANSION),
    ],
)
def test_the_row_of_table_2_follows_the_port_and_when_shut_the_volume(port, dV, phase):
    assert cylinder.phase_of(port, dV) == phase


def test_equation_17_by_hand():
    # (0.4 5 W - 1.4 2e5 Pa 3e-5 m3/s) / 4e-6 m3 = (2 - 8.4) / 4e-6 Pa/s
    assert cylinder.closed_rate(2e5, 4e-6, 3e-5, 5.0, 1.4) == pytest.approx(-1.6e6, rel=1e-13)


@given(pressure, volume, st.floats(-1e-4, 1e-4), st.floats(-5.0, 5.0))
def test_equation_17_is_the_first_law_with_the_mass_shut_in(P, V, dVdt, Q):
    """d(mu)/dt = Q - P dV/dt with m u = P V/(gamma - 1)."""
    dP = cylinder.closed_rate(P, V, dVdt, Q, GAMMA)
    assert (dP * V + P * dVdt) / (GAMMA - 1.0) == pytest.approx(Q - P * dVdt, abs=1e-11)


@pytest.mark.parametrize(
    ("dVdt", "Q", "by_hand"),
    [
        # suction, Eq. 16: (cp/R P dV/dt - Q)/(cp T_in) = (3.5 20 - 7)/(1004.6925 300)
        (1e-4, 7.0, 63.0 / (1004.6925 * 300.0)),
        # outflow at the gas's own temperature: (-70 - 7)/(1004.6925 250)
        (-1e-4, 7.0, -77.0 / (1004.6925 * 250.0)),
    ],
)
def test_equations_15_and_16_by_hand(dVdt, Q, by_hand):
    assert cylinder.open_flow(2e5, 250.0, dVdt, Q, 300.0, GAS) == pytest.approx(by_hand, rel=1e-13)


@given(pressure, temperature, st.floats(-1e-4, 1e-4), st.floats(-5.0, 5.0), temperature)
def test_an_open_port_is_the_first_law_at_constant_pressure(P, T, dVdt, Q, T_port):
    """Eq. 12: d(P V cv/R)/dt = Q - P dV/dt + mdot h, with the h of where the gas comes from."""
    mdot = cylinder.open_flow(P, T, dVdt, Q, T_port, GAS)
    h = CP * (T_port if mdot > 0.0 else T)
    assert P * dVdt * CV / R == pytest.approx(Q - P * dVdt + mdot * h, abs=1e-10)


def test_filling_by_hand():
    # V 1e-6 m3, from 1e5 to 2e5 Pa, 290 K outside: dm = 1e5 1e-6/(1.4 287.055 290); m before at 350 K.
    dm = 0.1 / (1.4 * 287.055 * 290.0)
    m = 0.1 / (287.055 * 350.0)
    T_after, entered = cylinder.open_port(1e5, 350.0, 1e-6, 2e5, 290.0, GAS)
    assert entered == pytest.approx(dm, rel=1e-13)
    assert T_after == pytest.approx(0.2 / (287.055 * (m + dm)), rel=1e-13)


@given(pressure, temperature, volume, st.floats(1e-3, 3.0), temperature)
def test_filling_brings_the_energy_and_the_mass_of_what_enters(P, T, V, rise, T_port):
    P_port = P * (1.0 + rise)
    T_after, dm = cylinder.open_port(P, T, V, P_port, T_port, GAS)
    m = P * V / (R * T)
    assert (m + dm) * CV * T_after - m * CV * T == pytest.approx(dm * CP * T_port, rel=1e-9)
    assert (m + dm) * R * T_after == pytest.approx(P_port * V, rel=1e-12)
    assert dm > 0.0


@given(pressure, temperature, volume, st.floats(0.1, 0.999))
def test_blow_down_leaves_the_remaining_gas_isentropic(P, T, V, ratio):
    T_after, dm = cylinder.open_port(P, T, V, ratio * P, 293.0, GAS)
    m = P * V / (R * T)
    assert T_after / T == pytest.approx(ratio ** (2.0 / 7.0), rel=1e-13)
    assert (m + dm) * R * T_after == pytest.approx(ratio * P * V, rel=1e-12)
    assert dm < 0.0


def test_blow_down_takes_out_the_enthalpy_of_what_leaves():
    """In many small steps, each sending gas out at its temperature of the moment, the same gas remains."""
    V, steps = 5e-6, 4000
    P = np.geomspace(2.4e5, 1.02e5, steps + 1)
    T, m = 250.0, 2.4e5 * V / (R * 250.0)
    for before, after in itertools.pairwise(P):
        dm = (after - before) * V / (GAMMA * R * T)
        m, T = m + dm, after * V / (R * (m + dm))
    T_after, dm = cylinder.open_port(2.4e5, 250.0, V, 1.02e5, 293.0, GAS)
    np.testing.assert_allclose([T, m], [T_after, 2.4e5 * V / (R * 250.0) + dm], rtol=1e-4)


def test_a_port_at_the_cylinders_own_pressure_changes_nothing():
    T_after, dm = cylinder.open_port(2e5, 270.0, 4e-6, 2e5, 293.0, GAS)
    assert T_after == 270.0
    assert dm == pytest.approx(0.0, abs=1e-20)


def test_constant_air_is_dry_with_the_ratio_seven_fifths():
    assert GAS[layout.GAS_R] == 287.055
    assert GAS[layout.GAS_CP] / (GAS[layout.GAS_CP] - GAS[layout.GAS_R]) == pytest.approx(1.4, rel=1e-14)


@pytest.mark.parametrize(("first", "law"), [(layout.GAS_MU, 110.4), (layout.GAS_K, 194.0)])
def test_constant_air_follows_sutherland(first, law):
    T = np.linspace(200.0, 440.0, 61)
    start = {110.4: 1.716e-5, 194.0: 0.0241}[law]
    by_hand = start * (T / 273.15) ** 1.5 * (273.15 + law) / (T + law)
    quartic = np.polynomial.Polynomial(GAS[first : first + 5])(T)
    np.testing.assert_allclose(quartic, by_hand, rtol=2.2e-5)


def moist_gas(P_in, **values):
    motor_then = PTM3600.with_values(values)
    return cylinder.gas_state(motor_then.vector(), P_in, motor_then.readings.vector())


def test_moist_air_carries_the_water_of_the_ambient():
    x_w = air.water_fraction(293.15, 101325.0, 0.3)
    gas = moist_gas(1.5e5, relative_humidity=0.3)
    assert gas[layout.GAS_R] == pytest.approx(air.gas_constant(x_w), rel=1e-14)
    assert gas[layout.GAS_CP] == pytest.approx(air.ideal_heat_capacity(293.15, x_w), rel=1e-14)
    T = 260.0
    mu = np.polynomial.Polynomial(gas[layout.GAS_MU : layout.GAS_MU + 5])(T)
    assert mu == pytest.approx(air.viscosity(T, 0.5 * (1.5e5 + 101325.0), x_w), rel=1e-4)


def test_what_condenses_under_pressure_stays_in_the_receiver():
    """At 4 bar the line holds the water of saturation there, however damp the day."""
    x_w = air.water_fraction(293.15, 4e5, 1.0)
    for humidity in (0.5, 1.0):
        assert moist_gas(4e5, relative_humidity=humidity)[layout.GAS_R] == pytest.approx(
            air.gas_constant(x_w), rel=1e-14
        )


def test_a_state_outside_the_air_properties_is_refused():
    with pytest.raises(ValueError, match=r"P = 2e\+06 Pa is outside"):
        moist_gas(20e5)


def test_the_equations_are_the_same_plain_and_compiled():
    calls = [
        (cylinder.closed_rate, (2e5, 4e-6, 3e-5, 5.0, 1.4)),
        (cylinder.open_flow, (2e5, 250.0, 1e-4, 7.0, 300.0, GAS)),
        (cylinder.open_flow, (2e5, 250.0, -1e-4, 7.0, 300.0, GAS)),
        (cylinder.open_port, (1e5, 350.0, 1e-6, 2e5, 290.0, GAS)),
        (cylinder.open_port, (2e5, 250.0, 1e-6, 1e5, 290.0, GAS)),
        *((cylinder.phase_of, (port, dV)) for port in (OUTLET, INLET, CLOSED) for dV in (-1.0, 1.0)),
        *((cylinder.port_at, (psi, LAP, LOBE)) for psi in np.linspace(0.0, LOBE, 91)),
    ]
    for function, arguments in calls:
        np.testing.assert_allclose(function(*arguments), function.py_func(*arguments), rtol=1e-14)
