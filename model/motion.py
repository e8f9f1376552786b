"""Section 2.3 of the article: forces, torques and the motion of the rotor, Eq. 21-25.

`P`, `P_a`: pressure in the cylinder and of the ambient [Pa].
`F`: gas force [N].
`L4`, `r`: motor centre to roller centre, and to the touch point [m].
`sin_phi`, `cos_phi`: of the angle of Eq. 23 and 24 [-].
`torque`: sum over the cylinders of gas torque less roller friction [N m].
`f_overall`: overall friction coefficient [N m s].
`inertia`: moment of inertia J [kg m2].
"""

from __future__ import annotations

from configs.compiled import njit


@njit(error_model="numpy", cache=True)
def piston_force(A_p: float, P: float, P_a: float) -> float:
    """Gas force on a piston [N], Eq. 22."""
    return A_p * (P - P_a)


@njit(error_model="numpy", cache=True)
def gas_arm(L4: float, sin_phi: float, cos_phi: float, r: float, virtual_work: bool) -> float:
    """Arm of the gas force about the motor centre [m].

    `virtual_work`: False: r sin(phi) as Eq. 25 prints it; True: dL4/dth = L4 tan(phi), which does the gas's own work
        (erratum 4).
    """
    return L4 * sin_phi / cos_phi if virtual_work else r * sin_phi


@njit(error_model="numpy", cache=True)
def roller_torque(F: float, f_r: float, cos_phi: float, r: float, as_printed: bool) -> float:
    """Magnitude of the roller friction's torque [N m], the second term of Eq. 25.

    `as_printed`: True: f_r F cos(phi) r, which drives where F < 0; False: with \\|F\\| (erratum 5).
    """
    return f_r * (F if as_printed else abs(F)) * cos_phi * r


@njit(error_model="numpy", cache=True)
def acceleration(torque: float, f_overall: float, omega: float, inertia: float) -> float:
    """Angular acceleration [rad/s2], Eq. 21 and 25."""
    return (torque - f_overall * omega) / inertia
