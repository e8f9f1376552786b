"""The guide curve: the reference table, Eq. 1-11 by hand, and what a curve has to be whatever its lengths."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from model import geometry, layout, motor

PTM3600 = motor.read_motor("ptm3600")
LOBE = 0.5 * math.pi

# psi deg, L4 mm, phi deg, r mm, V cm3; two independent implementations agree on the digits shown.
REFERENCE = [
    (0.0, 67.5100, 0.0, 76.6100, 7.5239),
    (8.0, 66.7361, -9.4254, 75.7279, 7.1729),
    (15.0, 64.7931, -17.7311, 73.5131, 6.2918),
    (30.7871, 56.1106, -37.0339, 63.6115, 2.3540),
    (37.0, 52.8987, -19.9622, 61.5304, 0.8974),
    (45.0, 51.6126, 0.0, 60.7126, 0.3141),
    (60.0, 56.6847, 36.0396, 64.2664, 2.6144),
    (82.0, 66.7361, 9.4254, 75.7279, 7.1729),
]
angles = st.floats(-20.0, 20.0)


def curve_of(parameters):
    c = np.empty(layout.N_CURVE)
    geometry.curve(parameters, c)
    return c


def table_at(*psi, parameters=None):
    return geometry.table(PTM3600.vector() if parameters is None else parameters, np.array(psi))


@st.composite
def motors(draw):
    """Parameter sets near the published one that still make a motor."""
    parameters = PTM3600.vector()
    for index in (layout.R2_DIAMETER, layout.R3_DIAMETER, layout.R5_DIAMETER, layout.R6, layout.DP):
        parameters[index] *= draw(st.floats(0.97, 1.03))
    parameters[layout.LP] *= draw(st.floats(0.9, 1.0))
    assume(geometry.lowest_volume(parameters) > 0.0)
    return parameters


@pytest.mark.parametrize("row", REFERENCE, ids=lambda row: f"{row[0]:g} deg")
def test_the_reference_table_is_met_to_its_last_digit(row):
    psi, L4, phi, r, V = row
    found = table_at(math.radians(psi))
    assert found["L4_m"][0] * 1e3 == pytest.approx(L4, abs=5.1e-5)
    assert math.degrees(found["phi_rad"][0]) == pytest.approx(phi, abs=1.5e-4)  # psi itself has four digits
    assert found["r_m"][0] * 1e3 == pytest.approx(r, abs=5.1e-5)
    assert found["V_m3"][0] * 1e6 == pytest.approx(V, abs=5.1e-5)


@pytest.mark.parametrize(
    ("index", "millimetres", "half_digit"),
    [
        (layout.L1, 36.495, 5e-7),
        (layout.L2, 87.1326, 5e-5),
        (layout.L5, 31.015, 5e-7),
        (layout.L6, 35.52, 5e-7),
    ],
)
def test_the_reference_lengths_are_met_to_their_last_digit(index, millimetres, half_digit):
    assert curve_of(PTM3600.vector())[index] * 1e3 == pytest.approx(millimetres, abs=half_digit)


def test_the_arcs_meet_at_the_reference_angle():
    assert math.degrees(curve_of(PTM3600.vector())[layout.ALPHA]) == pytest.approx(30.7871, abs=5e-5)


@pytest.mark.parametrize("lobes", [2, 3, 4, 5, 8])
def test_the_angles_and_lengths_of_equations_1_to_5_close_the_triangle(lobes):
    """The junction seen from the concave centre and from the convex centre is one point."""
    R2, R3, R5, R6 = 40.115, 26.42, 9.1, 76.61
    L1, half = geometry.concave_centre(R6, R2), math.pi / lobes
    beta = geometry.angle_beta(L1, R2, R3, half)
    gamma = geometry.angle_gamma(beta, half)
    L3 = geometry.junction_distance(L1, R2, R5, gamma)
    alpha = geometry.junction_angle(R2, R5, gamma, L3)
    # The line between the two circles' centres is R2 + R3 long; the roller's centre divides it at R2 - R5.
    concave = np.array([L1, 0.0])
    convex = geometry.convex_centre(L1, R2, R3, half) * np.array([math.cos(half), math.sin(half)])
    assert np.linalg.norm(convex - concave) == pytest.approx(R2 + R3, rel=1e-14)
    junction = concave + (convex - concave) * (R2 - R5) / (R2 + R3)
    assert np.hypot(*junction) == pytest.approx(L3, rel=1e-14)
    assert math.atan2(junction[1], junction[0]) == pytest.approx(alpha, rel=1e-14)


def test_the_roller_centre_keeps_its_distance_from_the_circle_it_rolls_on():
    c = curve_of(PTM3600.vector())
    for psi in np.linspace(0.0, 0.25 * math.pi, 91):
        L4 = geometry.place(psi, c)[0]
        centre = L4 * np.array([math.cos(psi), math.sin(psi)])
        if psi <= c[layout.ALPHA]:
            assert np.linalg.norm(centre - [c[layout.L1], 0.0]) == pytest.approx(c[layout.L5], rel=1e-13)
        else:
            convex = c[layout.L2] * math.sqrt(0.5)
            assert np.linalg.norm(centre - [convex, convex]) == pytest.approx(c[layout.L6], rel=1e-13)


def test_the_volume_counts_the_piston_from_the_rollers_surface():
    """Erratum 1: with L4 + R5 the volume at 45 deg is 0.314 cm3; as printed it would be -3.81 cm3."""
    area = 0.25 * math.pi * 24.03**2
    L4 = table_at(0.25 * math.pi)["L4_m"][0] * 1e3
    assert table_at(0.25 * math.pi)["V_m3"][0] * 1e9 == pytest.approx(area * (L4 + 9.1 - 35.07 - 24.95), rel=1e-12)
    assert geometry.lowest_volume(PTM3600.vector()) * 1e6 == pytest.approx(0.3141, abs=5e-5)
    assert area * (L4 - 35.07 - 24.95) * 1e-3 == pytest.approx(-3.81, abs=5e-3)


@given(angles)
def test_phi_is_negative_while_the_piston_is_pushed_in_and_positive_while_it_comes_out(psi):
    within = psi % LOBE
    assume(1e-6 < within < LOBE - 1e-6 and abs(within - 0.25 * math.pi) > 1e-6)
    found = table_at(psi)
    pushed_in = within < 0.25 * math.pi
    assert (found["phi_rad"][0] < 0.0) == pushed_in
    assert (found["dL4_dpsi_m"][0] < 0.0) == pushed_in


@given(motors(), st.floats(0.0, LOBE))
def test_the_reach_changes_by_its_tangent(parameters, psi):
    h = 1e-5
    alpha = curve_of(parameters)[layout.ALPHA]
    assume(min(abs(psi - edge) for edge in (0.0, alpha, LOBE - alpha, LOBE)) > 2.0 * h)
    below, here, above = table_at(psi - h, psi, psi + h, parameters=parameters)["L4_m"]
    slope = table_at(psi, parameters=parameters)
    assert slope["dL4_dpsi_m"][0] == pytest.approx((above - below) / (2.0 * h), abs=2e-10)
    assert slope["dL4_dpsi_m"][0] == pytest.approx(here * math.tan(slope["phi_rad"][0]), rel=1e-12, abs=1e-15)


@given(motors(), angles)
def test_the_volume_is_positive_everywhere(parameters, psi):
    assert table_at(psi, parameters=parameters)["V_m3"][0] >= geometry.lowest_volume(parameters) * (1.0 - 1e-12) > 0.0


@given(angles, st.integers(-8, 8))
def test_the_curve_repeats_with_every_lobe(psi, lobes):
    here, there = table_at(psi), table_at(psi + lobes * LOBE)
    for name in here:
        np.testing.assert_allclose(there[name], here[name], rtol=1e-11, atol=1e-13)


@given(angles)
def test_the_curve_is_its_own_mirror_image(psi):
    here, there = table_at(psi), table_at(-psi)
    for name, sign in {"L4_m": 1, "r_m": 1, "V_m3": 1, "phi_rad": -1, "dL4_dpsi_m": -1}.items():
        np.testing.assert_allclose(there[name], sign * here[name], rtol=1e-11, atol=1e-13)


@given(motors())
def test_the_arcs_join_in_place_and_in_slope(parameters):
    c = curve_of(parameters)
    alpha = c[layout.ALPHA]
    concave = geometry.reach_concave(alpha, c[layout.L1], c[layout.L5])
    convex = geometry.reach_convex(alpha, c[layout.L2], c[layout.L6], 0.5 * LOBE)
    assert concave == pytest.approx(convex, rel=1e-13)
    steep = geometry.sin_phi_concave(alpha, c[layout.L1], c[layout.L5])
    assert steep == pytest.approx(geometry.sin_phi_convex(alpha, c[layout.L2], c[layout.L6], 0.5 * LOBE), rel=1e-12)


@given(motors(), st.floats(0.0, LOBE))
def test_the_touch_point_lies_a_roller_radius_from_its_centre_along_the_normal(parameters, psi):
    L4, sin_phi, cos_phi, r = geometry.place(psi, curve_of(parameters))
    R5 = 0.5 * parameters[layout.R5_DIAMETER]
    assert r == pytest.approx(math.hypot(L4 + R5 * cos_phi, R5 * sin_phi), rel=1e-13)
    assert sin_phi**2 + cos_phi**2 == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize(
    ("index", "value"), [(layout.R6, 0.03), (layout.R5_DIAMETER, 0.09), (layout.R6, 0.2), (layout.R3_DIAMETER, 1e-3)]
)
def test_lengths_that_make_no_curve_have_no_lowest_volume(index, value):
    parameters = PTM3600.vector()
    parameters[index] = value
    assert not geometry.lowest_volume(parameters) > 0.0


def test_the_curve_is_the_same_plain_and_compiled():
    parameters = PTM3600.vector()
    plain = np.empty(layout.N_CURVE)
    geometry.curve.py_func(parameters, plain)
    np.testing.assert_allclose(curve_of(parameters), plain, rtol=1e-15)
    for psi in np.linspace(0.0, LOBE, 61):
        np.testing.assert_allclose(geometry.place(psi, plain), geometry.place.py_func(psi, plain), rtol=1e-14)
