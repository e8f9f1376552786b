"""What can be concealed in the second rig: each effect's law as figures of the motor (see `instruments` for sensors).

An effect has an id (a listed one, or a word of this rig for what is in no library), a form, and values in SI. The first
form of a listed id is the usual law; its values bear the names that a diagnosis reports. The other forms are physics of
the same name that another author would write down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.challenge.second_rig.machine.slots import AT, DEFAULTS, DRAG_SPEED

Values = Mapping[str, float]


@dataclass(frozen=True)
class Concealed:
    """One effect at work.

    `form`: the `USUAL` one of the id, or one of `sizes.OTHER_FORMS`.
    `values`: its sizes [SI].
    """

    id: str
    form: str
    values: Values


USUAL = {
    "coulomb_friction": "sharp",
    "stribeck_friction": "gaussian",
    "windage": "square",
    "load_friction": "roller",
    "friction_warm_up": "exponential",
    "once_per_rev_torque": "sine",
    "inlet_throttling": "quadratic",
    "exhaust_back_pressure": "quadratic",
    "leakage": "laminar",
    "wall_heat_exchange": "factor",
    "pressure_gauge_offset": "constant",
    "pressure_gauge_scale": "constant",
    "flow_offset": "constant",
    "flow_scale": "constant",
    "flow_density_correction": "root",
    "speed_scale": "constant",
    "speed_lag": "first_order",
    "bad_reading": "misread",
    "inertia": "constant",
}
LISTED = tuple(USUAL)
TRANSIENT_ONLY = ("once_per_rev_torque", "speed_lag", "inertia")

# Figures of the motor by id and form; what depends on the clock or the sweep's direction stands in `row_figures`.
_FIGURES: dict[tuple[str, str], Callable[[Values], dict[str, float]]] = {
    ("coulomb_friction", "sharp"): lambda v: {"dry_nm": v["torque_nm"]},
    ("coulomb_friction", "smoothed"): lambda v: {"dry_nm": v["torque_nm"], "dry_width_rad_s": v["width_rad_s"]},
    ("stribeck_friction", "gaussian"): lambda v: {"stribeck_nm": v["torque_nm"], "stribeck_rad_s": v["speed_rad_s"]},
    ("stribeck_friction", "exponential"): lambda v: {
        "stribeck_nm": v["torque_nm"],
        "stribeck_rad_s": v["speed_rad_s"],
        "stribeck_form": 1.0,
    },
    ("stribeck_friction", "lorentzian"): lambda v: {
        "stribeck_nm": v["torque_nm"],
        "stribeck_rad_s": v["speed_rad_s"],
        "stribeck_form": 2.0,
    },
    ("windage", "square"): lambda v: {"drag_nm": v["drag_nm_s2"] * DRAG_SPEED**2},
    ("windage", "power"): lambda v: {"drag_nm": v["torque_at_40_nm"], "drag_exponent": v["exponent"]},
    ("load_friction", "roller"): lambda v: {"roller_factor": v["roller_factor"]},  # added, see `figures`
    ("load_friction", "seal"): lambda v: {"seal_m3": v["torque_per_pressure_m3"]},
    ("once_per_rev_torque", "sine"): lambda v: {"turn_sine_nm": v["sine_nm"], "turn_cosine_nm": v["cosine_nm"]},
    ("once_per_rev_torque", "two_harmonics"): lambda v: {
        "turn_sine_nm": v["sine_nm"],
        "turn_cosine_nm": v["cosine_nm"],
        "turn_second_nm": v["second_nm"],
    },
    ("inlet_throttling", "quadratic"): lambda v: {"inlet_loss": v["loss_pa_s2_m6"]},
    ("inlet_throttling", "orifice"): lambda v: {"inlet_area_m2": v["area_m2"], "inlet_form": 1.0},
    ("inlet_throttling", "laminar"): lambda v: {"inlet_loss": v["loss_pa_s_m3"], "inlet_form": 2.0},
    ("exhaust_back_pressure", "quadratic"): lambda v: {"outlet_loss": v["rise_pa_s2_m6"]},
    ("exhaust_back_pressure", "orifice"): lambda v: {"outlet_area_m2": v["area_m2"], "outlet_form": 1.0},
    ("exhaust_back_pressure", "laminar"): lambda v: {"outlet_loss": v["rise_pa_s_m3"], "outlet_form": 2.0},
    ("leakage", "laminar"): lambda v: {"leak_kg_s_pa2": v["conductance_kg_s_pa2"]},
    ("leakage", "orifice"): lambda v: {"leak_area_m2": v["area_m2"]},
    ("wall_heat_exchange", "factor"): lambda v: {"heat_factor": v["extra_share"]},  # added to 1
    ("wall_heat_exchange", "wall"): lambda v: {"wall_w_m2k": v["coefficient_w_m2k"]},
    ("inertia", "constant"): lambda v: {"inertia": v["share"]},  # a share of the motor's own
    ("torque_above_a_speed", "clutch"): lambda v: {"clutch_nm": v["torque_nm"], "clutch_rad_s": v["speed_rad_s"]},
    ("torque_in_a_speed_band", "bump"): lambda v: {
        "band_nm": v["torque_nm"],
        "band_rad_s": v["speed_rad_s"],
        "band_width_rad_s": v["width_rad_s"],
    },
}
_ADDED = ("roller_factor", "heat_factor")


def figures(nuisances: Mapping[str, float], effects: Sequence[Concealed]) -> dict[str, float]:
    """Figures of the motor with a set of effects, as they are at any time."""
    found = dict(DEFAULTS) | {name: value for name, value in nuisances.items() if name in DEFAULTS}
    for effect in effects:
        for name, value in _FIGURES.get((effect.id, effect.form), lambda v: {})(effect.values).items():
            if name == "inertia":
                found[name] *= 1.0 + value
            elif name in _ADDED:
                found[name] += value
            else:
                found[name] = value
    return found


def row_figures(
    base: Mapping[str, float], effects: Sequence[Concealed], clock: np.ndarray, way: np.ndarray, lines: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Figures and line pressures of rows, with what depends on the clock and on the sweep's direction.

    `way`, shape (n,): 1 upwards, -1 downwards, 0 neither [-].
    `lines`, shape (n,): pressure where the gauge sits [Pa].
    Returns `rows`, shape (n, k): figures of the motor, laid out as in `slots`; `lines`, shape (n,): pressure that the
    motor gets [Pa].
    """
    rows = np.tile(np.array(list(base.values())), (clock.size, 1))
    for effect in effects:
        v = effect.values
        if effect.id == "friction_warm_up":
            rows[:, AT["f_overall"]] *= 1.0 + v["share_cold"] * _cold(effect.form, v, clock)
        elif effect.id == "torque_from_a_moment_on":
            rows[:, AT["extra_nm"]] += v["torque_nm"] * (clock >= v["moment_s"])
        elif effect.id == "regulator_hysteresis":
            lines = lines - v["half_width_pa"] * way
    return rows, lines


def _cold(form: str, v: Values, clock: np.ndarray) -> np.ndarray:
    """Share of the cold friction that is left at a time [-], 1 at the start."""
    t = np.maximum(clock, 0.0) / v["time_s"]
    if form == "hyperbolic":
        return 1.0 / (1.0 + t)
    if form == "logistic":  # the heat has a way to go before the bearing feels it
        return (1.0 + np.exp(-3.0)) / (1.0 + np.exp(3.0 * (t - 1.0)))
    return np.exp(-t)


def from_json(data: Sequence[Mapping[str, Any]]) -> tuple[Concealed, ...]:
    """Effects as a truth keeps them."""
    return tuple(Concealed(one["id"], one["form"], dict(one["values"])) for one in data)
