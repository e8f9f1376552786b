"""Section 2.1 of the article: the guide curve and the cylinder volume, Eq. 1-11, and the angle phi, Eq. 23-24.

The angle ``psi`` of a cylinder runs over one lobe: at 0 the piston is farthest out (largest volume), half a lobe on
farthest in. Eq. 7 and 10 describe that half; the other is its mirror image. The article prints the equations for four
lobes: its pi/4 is half a lobe here, and its sqrt2/2 the sine and the cosine of that.

`R2`, `R3`: radii of the concave and the convex circle [m].
`R5`: radius of the roller [m].
`R6`: far point of the concave circle to the motor centre [m].
`L1`, `L2`: motor centre to the centres of the concave and the convex circle [m], Eq. 1 and 8.
`L3`: motor centre to roller centre at the junction of the arcs [m], Eq. 4.
`L4`: motor centre to roller centre [m], Eq. 7 and 10.
`L5`, `L6`: roller centre to the centres of the concave and the convex circle [m], Eq. 6 and 9.
`half`: half a lobe [rad], pi/4 in the article.
`beta`, `gamma`: angles at the convex and the concave circle's centre [rad], Eq. 2 and 3.
`th`: angle from the far point [rad].
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit
from model import layout as at


@njit(error_model="numpy", cache=True)
def concave_centre(R6: float, R2: float) -> float:
    """Distance L1 of the concave circle's centre from the motor centre [m], Eq. 1."""
    return R6 - R2


@njit(error_model="numpy", cache=True)
def square_of_sine(half: float) -> float:
    """The square of the sine of half a lobe [-], by the whole lobe: just 1/2 for four lobes."""
    return 0.5 * (1.0 + math.cos(math.pi - 2.0 * half))


@njit(error_model="numpy", cache=True)
def angle_beta(L1: float, R2: float, R3: float, half: float) -> float:
    """Angle beta at the convex circle's centre [rad], Eq. 2."""
    return math.asin(math.sqrt(square_of_sine(half)) * L1 / (R2 + R3))


@njit(error_model="numpy", cache=True)
def angle_gamma(beta: float, half: float) -> float:
    """Angle gamma at the concave circle's centre [rad], Eq. 3."""
    return math.pi - half - beta


@njit(error_model="numpy", cache=True)
def junction_distance(L1: float, R2: float, R5: float, gamma: float) -> float:
    """Distance L3 of the roller's centre from the motor centre at the junction of the arcs [m], Eq. 4."""
    b = R2 - R5
    return math.sqrt(L1 * L1 + b * b - 2.0 * b * L1 * math.cos(gamma))


@njit(error_model="numpy", cache=True)
def junction_angle(R2: float, R5: float, gamma: float, L3: float) -> float:
    """Critical angle alpha, where the roller passes from the concave to the convex arc [rad], Eq. 5."""
    return math.asin((R2 - R5) * math.sin(gamma) / L3)


@njit(error_model="numpy", cache=True)
def concave_arm(R2: float, R5: float) -> float:
    """Distance L5 of the roller's centre from the concave circle's centre [m], Eq. 6."""
    return R2 - R5


@njit(error_model="numpy", cache=True)
def reach_concave(th: float, L1: float, L5: float) -> float:
    """Motor centre to roller centre, L4, on the concave arc [m], Eq. 7; valid for \\|th\\| <= alpha."""
    s = L1 * math.sin(th)
    return L1 * math.cos(th) + math.sqrt(L5 * L5 - s * s)


@njit(error_model="numpy", cache=True)
def convex_centre(L1: float, R2: float, R3: float, half: float) -> float:
    """Distance L2 of the convex circle's centre from the motor centre [m], Eq. 8."""
    cosine = math.sqrt(0.5 * (1.0 + math.cos(2.0 * half)))
    return cosine * L1 + math.sqrt((R2 + R3) ** 2 - square_of_sine(half) * L1 * L1)


@njit(error_model="numpy", cache=True)
def convex_arm(R3: float, R5: float) -> float:
    """Distance L6 of the roller's centre from the convex circle's centre [m], Eq. 9."""
    return R3 + R5


@njit(error_model="numpy", cache=True)
def reach_convex(th: float, L2: float, L6: float, half: float) -> float:
    """Motor centre to roller centre, L4, on the convex arc [m], Eq. 10; valid for alpha <= th <= 2 half - alpha."""
    u = half - th
    s = L2 * math.sin(u)
    return L2 * math.cos(u) - math.sqrt(L6 * L6 - s * s)


@njit(error_model="numpy", cache=True)
def volume(L4: float, A_p: float, offset: float) -> float:
    """Volume of one cylinder [m3], Eq. 11 with erratum 1: V = Ap (L4 + R5 - Lp - R4).

    `offset`: R5 - Lp - R4 [m]; as printed, without erratum 1, -Lp - R4.
    """
    return A_p * (L4 + offset)


@njit(error_model="numpy", cache=True)
def sin_phi_concave(th: float, L1: float, L5: float) -> float:
    """Magnitude of sin(phi) on the concave arc [-], Eq. 23.

    `th`: angle from the far point, 0..alpha [rad].
    """
    return L1 * math.sin(th) / L5


@njit(error_model="numpy", cache=True)
def sin_phi_convex(th: float, L2: float, L6: float, half: float) -> float:
    """Magnitude of sin(phi) on the convex arc [-], Eq. 24.

    `th`: angle from the far point, alpha..half [rad].
    """
    return L2 * math.sin(half - th) / L6


@njit(error_model="numpy", cache=True)
def lobe_angle(parameters: np.ndarray) -> float:
    """Angle of a lobe of the curve [rad]."""
    angle: float = 2.0 * math.pi / parameters[at.N_LOBES]
    return angle


@njit(error_model="numpy", cache=True)
def pulse_angle(parameters: np.ndarray) -> float:
    """Angle after which the sum of the cylinders repeats [rad]; the counts have no common divisor."""
    angle: float = lobe_angle(parameters) / parameters[at.N_PISTONS]
    return angle


@njit(error_model="numpy", cache=True)
def curve(parameters: np.ndarray, c: np.ndarray) -> None:
    """Fill the constants of the guide curve, Eq. 1-6, 8 and 9.

    `c`, shape (12,): filled with L1, L2, L5, L6 [m], alpha [rad], R5 [m], the volume offset [m] and Ap [m2], NaN where
        the lengths give no curve; and the angles of half a lobe, a lobe, a pulse, and from cylinder to cylinder [rad].
    """
    R2 = 0.5 * parameters[at.R2_DIAMETER]
    R3 = 0.5 * parameters[at.R3_DIAMETER]
    R5 = 0.5 * parameters[at.R5_DIAMETER]
    L1 = concave_centre(parameters[at.R6], R2)
    c[:] = np.nan
    c[at.LOBE_ANGLE] = lobe_angle(parameters)
    c[at.PULSE_ANGLE] = pulse_angle(parameters)
    c[at.PITCH] = parameters[at.N_LOBES] * c[at.PULSE_ANGLE]
    c[at.HALF_LOBE] = half = 0.5 * c[at.LOBE_ANGLE]
    if L1 <= 0.0 or R2 <= R5 or math.sqrt(square_of_sine(half)) * L1 >= R2 + R3:
        return
    gamma = angle_gamma(angle_beta(L1, R2, R3, half), half)
    c[at.L1] = L1
    c[at.L2] = convex_centre(L1, R2, R3, half)
    c[at.L5] = concave_arm(R2, R5)
    c[at.L6] = convex_arm(R3, R5)
    c[at.ALPHA] = junction_angle(R2, R5, gamma, junction_distance(L1, R2, R5, gamma))
    c[at.R5] = R5
    c[at.V_OFFSET] = R5 - parameters[at.LP] - parameters[at.R4]
    c[at.A_P] = 0.25 * math.pi * parameters[at.DP] ** 2


@njit(error_model="numpy", cache=True)
def place(psi: float, c: np.ndarray) -> tuple[float, float, float, float]:
    """Everything that follows from the angle of one cylinder.

    `psi`: cylinder angle within a lobe [rad].
    Returns `L4`: motor centre to roller centre [m]; `sin_phi`: sine of phi [-], negative in the first half (the piston
    is pushed in), positive in the second; `cos_phi`: cosine of phi [-]; `r`: motor centre to the touch point of roller
    and curve [m].
    """
    half = c[at.HALF_LOBE]
    if psi <= half:
        th = psi
        sign = -1.0
    else:
        th = c[at.LOBE_ANGLE] - psi
        sign = 1.0
    if th <= c[at.ALPHA]:
        L4 = reach_concave(th, c[at.L1], c[at.L5])
        s = sin_phi_concave(th, c[at.L1], c[at.L5])
    else:
        L4 = reach_convex(th, c[at.L2], c[at.L6], half)
        s = sin_phi_convex(th, c[at.L2], c[at.L6], half)
    cos_phi = math.sqrt(1.0 - s * s)
    r = math.sqrt(L4 * L4 + c[at.R5] * c[at.R5] + 2.0 * L4 * c[at.R5] * cos_phi)
    return L4, sign * s, cos_phi, r


def lowest_volume(parameters: np.ndarray) -> float:
    """Volume of a cylinder with the piston farthest in [m3]; NaN where the lengths give no curve."""
    c = np.empty(at.N_CURVE)
    curve(parameters, c)
    if not c[at.L2] * math.sin(c[at.HALF_LOBE] - c[at.ALPHA]) < c[at.L6]:
        return math.nan
    return float(volume(c[at.L2] - c[at.L6], c[at.A_P], c[at.V_OFFSET]))


def rooms(parameters: np.ndarray) -> tuple[float, float]:
    """Largest diameters of cylinders and of rollers that stand side by side [m].

    Cylinders: where the piston's upper surface is farthest out. Rollers: as two neighbours pass a near point together.
    """
    c = np.empty(at.N_CURVE)
    curve(parameters, c)
    between = math.pi / parameters[at.N_PISTONS]
    surface = place(0.0, c)[0] + c[at.R5] - parameters[at.LP]
    roller = place((c[at.HALF_LOBE] - between) % c[at.LOBE_ANGLE], c)[0]
    return 2.0 * surface * math.tan(between), 2.0 * roller * math.sin(between)


def table(parameters: np.ndarray, psi: np.ndarray) -> dict[str, np.ndarray]:
    """The geometry over the angle, as Fig. 5 of the article shows it.

    `psi`, shape (n,): angles of one cylinder [rad]; any turn.
    Returns dict of ndarray, shape (n,): ``L4_m``, ``phi_rad``, ``r_m``, ``V_m3`` and ``dL4_dpsi_m`` (= L4 tan phi).
    """
    c = np.empty(at.N_CURVE)
    curve(parameters, c)
    rows = np.array([place(float(angle), c) for angle in np.mod(psi, c[at.LOBE_ANGLE])])
    L4, sin_phi, cos_phi, r = rows.T
    return {
        "L4_m": L4,
        "phi_rad": np.arcsin(sin_phi),
        "r_m": r,
        "V_m3": c[at.A_P] * (L4 + c[at.V_OFFSET]),
        "dL4_dpsi_m": L4 * sin_phi / cos_phi,
    }
