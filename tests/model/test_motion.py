"""Forces and torques: Eq. 21-25 by hand, and both readings of the gas's arm and of the roller's friction."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model import geometry, layout, motion, motor

PTM3600 = motor.read_motor("ptm3600")
CURVE = np.empty(layout.N_CURVE)
geometry.curve(PTM3600.vector(), CURVE)
LOBE = 0.5 * math.pi
CALLS = {
    motion.piston_force: (4.5e-4, 1.99e5, 101325.0),
    motion.gas_arm: (0.06, -0.3, math.sqrt(0.91), 0.069, False),
    motion.roller_torque: (-40.0, 0.008, 0.9, 0.07, False),
    motion.acceleration: (2.7, 0.0625, 40.0, 0.005),
}


def test_equation_22_by_hand():
    # 2 cm2 at 0.5 bar above the ambient
    assert motion.piston_force(2e-4, 1.5e5, 1e5) == pytest.approx(10.0, rel=1e-14)


def test_equation_25_as_published_takes_the_touch_points_arm():
    assert motion.gas_arm(0.05, 0.6, 0.8, 0.06, False) == pytest.approx(0.036, rel=1e-14)


def test_virtual_work_takes_the_slope_of_the_reach():
    assert motion.gas_arm(0.05, 0.6, 0.8, 0.06, True) == pytest.approx(0.0375, rel=1e-14)


def test_the_arm_of_virtual_work_integrates_to_the_stroke():
    """Work over the outward stroke is F times the stroke: no more, no less."""
    psi, weight = np.polynomial.legendre.leggauss(20)
    alpha = CURVE[layout.ALPHA]
    stroke = 0.0
    for low, high in ((0.25 * math.pi, LOBE - alpha), (LOBE - alpha, LOBE)):
        for x, w in zip(psi, weight, strict=True):
            L4, s, c, r = geometry.place(0.5 * (low + high + (high - low) * x), CURVE)
            stroke += 0.5 * (high - low) * w * motion.gas_arm(L4, s, c, r, True)
    assert stroke == pytest.approx(0.0675100 - 0.0516126, abs=1e-7)


def test_the_published_arm_does_two_and_a_half_per_cent_too_much_work():
    """Erratum 4, over a full stroke at constant force."""
    work = {}
    for virtual_work in (False, True):
        psi = np.linspace(0.25 * math.pi, LOBE, 20001)
        work[virtual_work] = np.trapezoid([motion.gas_arm(*geometry.place(x, CURVE), virtual_work) for x in psi], psi)
    assert work[False] / work[True] == pytest.approx(1.025, abs=5e-4)


@given(st.floats(0.0, LOBE))
def test_both_arms_push_the_same_way(psi):
    L4, s, c, r = geometry.place(psi, CURVE)
    published, virtual = (motion.gas_arm(L4, s, c, r, reading) for reading in (False, True))
    assert np.sign(published) == np.sign(virtual)


def test_roller_friction_by_hand():
    assert motion.roller_torque(100.0, 0.008, 0.8, 0.06, False) == pytest.approx(0.0384, rel=1e-14)


@pytest.mark.parametrize(("as_printed", "torque"), [(False, 0.0384), (True, -0.0384)])
def test_below_the_ambient_the_printed_friction_drives_and_ours_does_not(as_printed, torque):
    """Erratum 5."""
    assert motion.roller_torque(-100.0, 0.008, 0.8, 0.06, as_printed) == pytest.approx(torque, rel=1e-14)


def test_equations_21_and_25_by_hand():
    # (2.7 N m - 0.0625 N m s 40 rad/s) / 0.005 kg m2
    assert motion.acceleration(2.7, 0.0625, 40.0, 0.005) == pytest.approx(40.0, rel=1e-13)


def test_overall_friction_brakes_either_way():
    assert motion.acceleration(0.0, 0.0625, 40.0, 0.005) == pytest.approx(-500.0, rel=1e-14)
    assert motion.acceleration(0.0, 0.0625, -40.0, 0.005) == pytest.approx(500.0, rel=1e-14)


@pytest.mark.parametrize("function", CALLS, ids=lambda function: function.__name__)
def test_the_equations_are_the_same_plain_and_compiled(function):
    assert function(*CALLS[function]) == pytest.approx(function.py_func(*CALLS[function]), rel=1e-15)
