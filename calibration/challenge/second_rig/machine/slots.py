"""Where each figure of the second rig's motor stands in the array that its compiled march takes; SI units."""

from __future__ import annotations

import numpy as np

RPM = 30.0 / np.pi  # rpm in one rad/s
L_MIN = 60_000.0  # L/min in one m3/s
BAR = 1e5  # Pa

R_AIR = 287.055  # dry air [J/(kg K)]
GAMMA = 1.4
CYLINDERS = 7
LOBE = np.pi / 2.0  # angle of one lobe of the guide curve [rad]
PULSE = LOBE / CYLINDERS  # angle after which the seven cylinders look alike again [rad]

# Name and default of each figure. Forms are numbers: 0 is the form that a textbook gives first. What the article does
# not print is assumed, as it is in what is tested, so that a null conceals nothing.
DEFAULTS: dict[str, float] = {
    "f_overall": 0.0625,  # viscous friction, the article's section 5 [N m s]
    "roller_factor": 0.008,  # f_r of Eq. 25, assumed [-]
    "inertia": 0.005,  # J of Eq. 21, assumed [kg m2]
    "lap": np.radians(8.0),  # closed angle on each side of a dead centre, assumed [rad]
    "ambient_pa": 101_325.0,  # this and the two temperatures: assumed
    "ambient_k": 293.15,
    "inlet_k": 293.15,
    "inlet_drop_pa": 1000.0,  # this and the next: the article's fixed losses at the ports, section 2.4
    "outlet_drop_pa": 1000.0,
    "port_area_m2": 4.5e-4,  # effective area of a port, fully open: that of the bore
    "port_ramp_rad": 0.003,  # angle over which a port uncovers
    "port_lead": 0.25,  # share that is open at the article's angle
    "heat_factor": 1.0,  # times the heat of Eq. 18 [-]
    "wall_w_m2k": 0.0,  # other form of wall heat: a wall at the ambient's temperature, constant coefficient
    "dry_nm": 0.0,  # dry friction
    "dry_width_rad_s": 0.0,  # speed over which it builds up; 0: sharp
    "stribeck_nm": 0.0,
    "stribeck_rad_s": 8.0,
    "stribeck_form": 0.0,  # 0: Gaussian, 1: exponential, 2: Lorentzian
    "drag_nm": 0.0,  # drag torque at DRAG_SPEED
    "drag_exponent": 2.0,
    "seal_m3": 0.0,  # friction torque per Pa of the line's gauge pressure
    "turn_sine_nm": 0.0,  # torque fixed to the shaft's angle, once a turn
    "turn_cosine_nm": 0.0,
    "turn_second_nm": 0.0,  # ... and twice a turn
    "band_nm": 0.0,  # a torque around one speed
    "band_rad_s": 28.0,
    "band_width_rad_s": 2.5,
    "clutch_nm": 0.0,  # a torque above a speed
    "clutch_rad_s": 28.0,
    "extra_nm": 0.0,  # a dry torque of one plateau (something that happened at a time)
    "inlet_loss": 0.0,  # [Pa s2/m6], or [Pa s/m3] when laminar
    "inlet_area_m2": 0.0,  # compressible orifice ahead of the motor; 0: none
    "inlet_form": 0.0,  # 0: quadratic, 1: compressible orifice, 2: laminar
    "outlet_loss": 0.0,
    "outlet_area_m2": 0.0,
    "outlet_form": 0.0,
    "leak_kg_s_pa2": 0.0,  # laminar gap
    "leak_area_m2": 0.0,  # orifice beside the gap
}
NAMES = tuple(DEFAULTS)
AT = {name: i for i, name in enumerate(NAMES)}
DRAG_SPEED = 40.0  # rad/s


def vector(values: dict[str, float] | None = None) -> np.ndarray:
    """The array that the march takes, with some figures changed by name; KeyError for a name that is none."""
    found = np.array([DEFAULTS[name] for name in NAMES])
    for name, value in (values or {}).items():
        found[AT[name]] = value
    return found
