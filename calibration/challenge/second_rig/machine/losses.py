"""Torques that the second rig's motor loses outside its cylinders. Compiled; SI units."""

from __future__ import annotations

import math

import numpy as np

from calibration.challenge.second_rig.machine.slots import AT, DRAG_SPEED
from configs.compiled import njit

F = AT["f_overall"]
DRY, DRY_WIDTH = AT["dry_nm"], AT["dry_width_rad_s"]
STRIBECK, STRIBECK_SPEED, STRIBECK_FORM = AT["stribeck_nm"], AT["stribeck_rad_s"], AT["stribeck_form"]
EXPONENTIAL, LORENTZIAN = 1.0, 2.0
DRAG, EXPONENT, SEAL = AT["drag_nm"], AT["drag_exponent"], AT["seal_m3"]
SINE, COSINE, SECOND = AT["turn_sine_nm"], AT["turn_cosine_nm"], AT["turn_second_nm"]
BAND, BAND_SPEED, BAND_WIDTH = AT["band_nm"], AT["band_rad_s"], AT["band_width_rad_s"]
CLUTCH, CLUTCH_SPEED, EXTRA = AT["clutch_nm"], AT["clutch_rad_s"], AT["extra_nm"]
CLUTCH_WIDTH = 0.15  # rad/s over which a clutch takes hold


@njit(cache=True)
def drag(p: np.ndarray, omega: float, line_gauge: float) -> tuple[float, float]:
    """Losses outside the cylinders: what is proportional to the speed [N m s], and what is dry [N m].

    Viscous friction of the article; dry friction (Coulomb), sharp or built up as tanh(w/w0); Stribeck's, which fades
    with speed as exp(-(w/ws)^2), exp(-w/ws) or 1/(1 + (w/ws)^2); the drag of the air as a power of the speed, 2 for a
    turbulent one; a seal that the line's pressure loads. A torque in a band of speeds and one above a speed are made
    up: they are to resemble nothing in a library.
    """
    speed = abs(omega)
    viscous, dry = p[F], p[EXTRA] + p[SEAL] * max(line_gauge, 0.0)
    if p[DRY_WIDTH] > 0.0:
        ratio = speed / p[DRY_WIDTH]
        viscous += p[DRY] * (math.tanh(ratio) / speed if speed > 1e-9 else 1.0 / p[DRY_WIDTH])
    else:
        dry += p[DRY]
    if p[STRIBECK] != 0.0:
        ratio = speed / p[STRIBECK_SPEED]
        if p[STRIBECK_FORM] == EXPONENTIAL:
            dry += p[STRIBECK] * math.exp(-ratio)
        elif p[STRIBECK_FORM] == LORENTZIAN:
            dry += p[STRIBECK] / (1.0 + ratio * ratio)
        else:
            dry += p[STRIBECK] * math.exp(-ratio * ratio)
    if p[DRAG] != 0.0 and speed > 0.0:
        viscous += p[DRAG] / DRAG_SPEED * (speed / DRAG_SPEED) ** (p[EXPONENT] - 1.0)
    if p[BAND] != 0.0:
        dry += p[BAND] * math.exp(-(((speed - p[BAND_SPEED]) / p[BAND_WIDTH]) ** 2))
    if p[CLUTCH] != 0.0:
        dry += p[CLUTCH] / (1.0 + math.exp(min(max((p[CLUTCH_SPEED] - speed) / CLUTCH_WIDTH, -60.0), 60.0)))
    return viscous, dry


@njit(cache=True)
def swing(p: np.ndarray, theta: float) -> float:
    """Torque fixed to the shaft's angle, as of an unbalanced rotor [N m], positive where it opposes turning forward."""
    return p[SINE] * math.sin(theta) + p[COSINE] * math.cos(theta) + p[SECOND] * math.sin(2.0 * theta)
