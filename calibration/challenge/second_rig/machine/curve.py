"""The guide curve as a table over one lobe: volume, its slope, and the arms of gas force and roller friction.

From the article's section 2.1 and Eq. 23-24, drawn as what it is: a roller of radius R5 on two arcs that touch. The
centre of the roller runs on a circle of R2 - R5 about the concave centre, and of R3 + R5 about the convex one.
"""

from __future__ import annotations

import math

import numpy as np

from calibration.challenge.second_rig.machine.slots import LOBE

CONCAVE, CONVEX, ROLLER, FAR = 80.23e-3 / 2, 52.84e-3 / 2, 18.20e-3 / 2, 76.61e-3  # R2, R3, R5, R6 of Table 1 [m]
TOP, PISTON, BORE = 24.95e-3, 35.07e-3, 24.03e-3  # R4, Lp, Dp [m]
AREA = math.pi / 4.0 * BORE**2  # of a piston [m2]
CELLS = 7200  # of a lobe
VOLUME, SLOPE, GAS_ARM, ROLLER_ARM = 0, 1, 2, 3  # columns of the table


def radius(psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motor centre to roller centre [m], and the signed angle phi between curve normal and piston [rad].

    `psi`: angle within a lobe [rad]; 0 where the piston is farthest out.
    """
    folded = np.minimum(psi % LOBE, LOBE - psi % LOBE)
    side = np.where(psi % LOBE <= LOBE / 2.0, -1.0, 1.0)
    to_concave = FAR - CONCAVE
    inner, outer = CONCAVE - ROLLER, CONVEX + ROLLER
    # The convex centre lies on the lobe's other dead-centre line, as far from the concave one as the radii add up to.
    half = to_concave / math.sqrt(2.0)
    to_convex = half + math.sqrt((CONCAVE + CONVEX) ** 2 - half**2)
    across = to_concave * np.sin(folded)
    on_concave = to_concave * np.cos(folded) + np.sqrt(np.maximum(inner**2 - across**2, 0.0))
    away = to_convex * np.sin(LOBE / 2.0 - folded)
    on_convex = to_convex * np.cos(LOBE / 2.0 - folded) - np.sqrt(np.maximum(outer**2 - away**2, 0.0))
    # Beyond the junction the concave circle would lie farther out than the convex one lets the roller go.
    touch = math.acos(half / (CONCAVE + CONVEX)) + math.pi / 4.0  # at the concave centre, Eq. 2-3
    x, y = to_concave - inner * math.cos(touch), inner * math.sin(touch)
    concave = folded <= math.atan2(y, x)
    reach = np.where(concave, on_concave, on_convex)
    sine = np.where(concave, across / inner, away / outer)
    return reach, side * np.arcsin(sine)


def table() -> np.ndarray:
    """The guide curve over one lobe, a row an angle: what a cylinder and its piston do there, shape (CELLS + 1, 4).

    Its columns are the gas volume [m3], its slope with the angle [m3/rad], and the arms of Eq. 25 at the point where
    the roller touches the curve: r sin(phi) of the gas force and r cos(phi) of the roller's friction [m].
    """
    psi = np.linspace(0.0, LOBE, CELLS + 1)
    reach, phi = radius(psi)
    phi[-1] = 0.0
    touch = np.sqrt(reach**2 + ROLLER**2 + 2.0 * reach * ROLLER * np.cos(phi))
    # Erratum 1: the piston's length counts from the roller's outer surface.
    volume = AREA * (reach + ROLLER - PISTON - TOP)
    return np.column_stack([volume, AREA * reach * np.tan(phi), touch * np.sin(phi), touch * np.cos(phi)])
