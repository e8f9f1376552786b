"""How large an effect is drawn, in which form, and where it acts. Two families of draws.

`development` is for work on the diagnosis; `proof` is for campaigns that count. They differ in sizes, in the other
forms, in the effects that are in no library, in the noise and in the nuisances (`draws`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from calibration.challenge.second_rig.concealed import USUAL, Concealed

FAMILIES = ("development", "proof")
TOP_RAD_S = 62.0  # above the fastest plateau
SWEEP_S = 1000.0  # duration of the sweep
SEAL_PER_ROLLER_M3 = 7e-5  # torque per pressure of seals that take as much as a unit of the roller factor

# (low, high) of each family; drawn evenly in the logarithm. The signs of sensors' errors are drawn too.
Range = tuple[float, float]
RANGES: dict[str, dict[str, tuple[Range, Range]]] = {
    "coulomb_friction": {"torque_nm": ((0.10, 0.25), (0.07, 0.40))},
    "stribeck_friction": {"torque_nm": ((0.15, 0.35), (0.10, 0.45)), "speed_rad_s": ((6.0, 10.0), (4.0, 14.0))},
    "windage": {"drag_nm_s2": ((1.5e-4, 4e-4), (1e-4, 7e-4))},
    "load_friction": {"roller_factor": ((0.035, 0.07), (0.035, 0.09))},
    "friction_warm_up": {"share_cold": ((0.10, 0.25), (0.06, 0.35)), "time_s": ((180.0, 360.0), (100.0, 600.0))},
    "inlet_throttling": {"loss_pa_s2_m6": ((2e9, 7e9), (1.5e9, 1e10))},
    "exhaust_back_pressure": {"rise_pa_s2_m6": ((5e8, 1.5e9), (3e8, 2.5e9))},
    "leakage": {"conductance_kg_s_pa2": ((1.5e-14, 5e-14), (1e-14, 8e-14))},
    "wall_heat_exchange": {"extra_share": ((15.0, 25.0), (12.0, 29.0))},
    "pressure_gauge_offset": {"offset_pa": ((3000.0, 8000.0), (2500.0, 12_000.0))},
    "pressure_gauge_scale": {"scale": ((0.02, 0.06), (0.015, 0.08))},
    "flow_offset": {"offset_m3_s": ((1e-4, 2e-4), (8e-5, 3e-4))},
    "flow_scale": {"scale": ((0.14, 0.3), (0.12, 0.4))},
    "flow_density_correction": {"share": ((0.95, 1.05), (0.8, 1.2))},
    "speed_scale": {"scale": ((0.04, 0.10), (0.03, 0.15))},
    "speed_lag": {"time_s": ((0.012, 0.04), (0.008, 0.08))},
    "inertia": {"share": ((0.5, 1.0), (0.45, 1.6))},
}
# An effect of the form of a nuisance: its amplitude, and the declared sd of that nuisance.
NEAR: dict[str, tuple[str, float]] = {
    "pressure_gauge_offset": ("offset_pa", 500.0),
    "pressure_gauge_scale": ("scale", 0.002),
    "flow_offset": ("offset_m3_s", 0.5 / 60_000.0),
    "flow_scale": ("scale", 0.02),
    "speed_scale": ("scale", 0.0005),
}
SIGNED = ("pressure_gauge_offset", "pressure_gauge_scale", "flow_offset", "flow_scale", "speed_scale")

# Forms other than the usual one: development, proof.
OTHER_FORMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "coulomb_friction": (("smoothed",), ("smoothed",)),
    "stribeck_friction": (("exponential",), ("lorentzian",)),
    "windage": (("power",), ("power",)),
    "load_friction": (("seal",), ("seal",)),
    "friction_warm_up": (("hyperbolic",), ("logistic", "hyperbolic")),
    "once_per_rev_torque": (("two_harmonics",), ("two_harmonics",)),
    "inlet_throttling": (("orifice",), ("orifice", "laminar")),
    "exhaust_back_pressure": (("orifice",), ("orifice", "laminar")),
    "leakage": (("orifice",), ("orifice",)),
    "wall_heat_exchange": (("wall",), ("wall",)),
    "flow_density_correction": (("exponent",), ("exponent",)),
    "speed_lag": (("delay",), ("moving_average", "delay")),
}
UNLISTED: dict[str, tuple[str, ...]] = {
    "development": ("torque_above_a_speed", "torque_from_a_moment_on", "flow_float_sticks", "flow_sawtooth"),
    "proof": (
        "torque_above_a_speed",
        "torque_in_a_speed_band",
        "torque_from_a_moment_on",
        "regulator_hysteresis",
        "gauge_sawtooth",
        "flow_float_sticks",
        "flow_sawtooth",
        "tachometer_slips_from_a_moment_on",
    ),
}

GAS = ["torque", "mass"]  # what changes the pressure at the pistons changes speed and flow
ALONG = ["speed", "pressure", "flow"]  # move together in a sweep
PLACES: dict[str, dict[str, Any]] = {
    "coulomb_friction": {"balance": "torque", "channel": "speed", "coordinate": [*ALONG, "phase"]},
    "stribeck_friction": {"balance": "torque", "channel": "speed", "coordinate": [*ALONG, "phase"]},
    "windage": {"balance": "torque", "channel": "speed", "coordinate": [*ALONG, "phase"]},
    "load_friction": {"balance": "torque", "channel": "speed", "coordinate": [*ALONG, "phase"]},
    "friction_warm_up": {"balance": "torque", "channel": "speed", "coordinate": ["time", "direction"]},
    "once_per_rev_torque": {"balance": "torque", "channel": "speed", "coordinate": ["angle", "phase"]},
    "inlet_throttling": {"balance": GAS, "channel": ["speed", "flow"], "coordinate": [*ALONG, "phase"]},
    "exhaust_back_pressure": {"balance": GAS, "channel": ["speed", "flow"], "coordinate": [*ALONG, "phase"]},
    "leakage": {"balance": "mass", "channel": "flow", "coordinate": ALONG},
    "wall_heat_exchange": {"balance": GAS, "channel": ["speed", "flow"], "coordinate": [*ALONG, "phase"]},
    "pressure_gauge_offset": {"balance": ["sensor", "torque"], "channel": ["pressure", "speed"], "coordinate": ALONG},
    "pressure_gauge_scale": {"balance": ["sensor", "torque"], "channel": ["pressure", "speed"], "coordinate": ALONG},
    "flow_offset": {"balance": ["sensor", "mass"], "channel": "flow", "coordinate": ALONG},
    "flow_scale": {"balance": ["sensor", "mass"], "channel": "flow", "coordinate": ALONG},
    "flow_density_correction": {"balance": ["sensor", "mass"], "channel": "flow", "coordinate": ALONG},
    "speed_scale": {"balance": ["sensor", "torque"], "channel": "speed", "coordinate": [*ALONG, "phase"]},
    "speed_lag": {"balance": ["sensor", "torque"], "channel": "speed", "coordinate": ["phase", "time"]},
    "bad_reading": {"balance": "sensor", "channel": ["speed", "flow", "pressure"], "coordinate": "row"},
    "inertia": {"balance": "torque", "channel": "speed", "coordinate": ["phase", "speed"]},
    # With a range there is one coordinate: ranges along others, which a sweep cannot tell from it, are not compared.
    "torque_above_a_speed": {"balance": "torque", "channel": "speed", "coordinate": "speed"},
    "torque_in_a_speed_band": {"balance": "torque", "channel": "speed", "coordinate": "speed"},
    "torque_from_a_moment_on": {"balance": "torque", "channel": "speed", "coordinate": "time"},
    "regulator_hysteresis": {
        "balance": ["torque", "sensor"],
        "channel": ["speed", "pressure"],
        "coordinate": ["direction", "time"],
    },
    "gauge_sawtooth": {"balance": ["sensor", "torque"], "channel": ["pressure", "speed"], "coordinate": ALONG},
    "flow_float_sticks": {"balance": ["sensor", "mass"], "channel": "flow", "coordinate": ["direction", "time"]},
    "flow_sawtooth": {"balance": ["sensor", "mass"], "channel": "flow", "coordinate": ALONG},
    "tachometer_slips_from_a_moment_on": {
        "balance": ["sensor", "torque"],
        "channel": "speed",
        "coordinate": "time",
    },
}


def usual(name: str, family: str, near: bool, rng: np.random.Generator) -> Concealed:
    """A listed effect in its usual form.

    `near`: whether its size is to be near that of the nuisance which has its form; for those that have none, ignored.
    """
    if name == "bad_reading":
        return Concealed(name, "misread", _bad_rows(family, rng))
    if name == "once_per_rev_torque":
        size, phase = _log(rng, ((0.03, 0.10), (0.015, 0.12))[_at(family)]), rng.uniform(0.0, 2.0 * np.pi)
        return Concealed(name, "sine", {"sine_nm": size * np.sin(phase), "cosine_nm": size * np.cos(phase)})
    values = {key: _log(rng, ranges[_at(family)]) for key, ranges in RANGES[name].items()}
    if near and name in NEAR:
        key, sd = NEAR[name]
        values[key] = sd * rng.uniform(2.0, 4.0)
    if near and name == "inertia":
        values["share"] = 1.1 ** rng.uniform(2.0, 4.0) - 1.0
    if name in SIGNED and rng.random() < 0.5:
        values = {key: -value for key, value in values.items()}
    if name == "inertia" and rng.random() < 0.4:
        values["share"] = 1.0 / (1.0 + values["share"]) - 1.0
    return Concealed(name, USUAL[name], values)


def other(name: str, family: str, rng: np.random.Generator) -> Concealed:
    """A listed effect in another form, of a size like its usual form's."""
    forms = OTHER_FORMS[name][_at(family)]
    form = forms[int(rng.integers(len(forms)))]
    like = dict(usual(name, family, False, rng).values)
    if form == "smoothed":
        like["width_rad_s"] = _log(rng, ((0.5, 1.5), (1.0, 4.0))[_at(family)])
    elif form == "power":
        like["exponent"] = 1.8 if family == "development" else float(rng.choice([1.7, 2.2, 2.5]))
    elif form == "exponent":
        like["exponent"] = 0.45 if family == "development" else float(rng.choice([0.4, 0.6]))
    return in_form(name, form, like)


def in_form(name: str, form: str, like: Mapping[str, float]) -> Concealed:
    """A listed effect in another form, as large as in its usual one.

    `like`: values of the usual form, and what the other one has besides.
    """
    values: Callable[[], dict[str, float]] = {
        ("windage", "power"): lambda: {
            "torque_at_40_nm": like["drag_nm_s2"] * 1600.0,
            "exponent": like["exponent"],
        },
        ("load_friction", "seal"): lambda: {"torque_per_pressure_m3": SEAL_PER_ROLLER_M3 * like["roller_factor"]},
        ("once_per_rev_torque", "two_harmonics"): lambda: {
            **like,
            "second_nm": 0.4 * float(np.hypot(like["sine_nm"], like["cosine_nm"])),
        },
        # The same loss at 80 L/min (2.2 bar) as the quadratic form has.
        ("inlet_throttling", "orifice"): lambda: {"area_m2": _orifice(like["loss_pa_s2_m6"], 2.2e5, 1.33e-3, 2.38)},
        ("inlet_throttling", "laminar"): lambda: {"loss_pa_s_m3": like["loss_pa_s2_m6"] * 1.33e-3},
        ("exhaust_back_pressure", "orifice"): lambda: {"area_m2": _orifice(like["rise_pa_s2_m6"], 1.02e5, 2.9e-3, 1.2)},
        ("exhaust_back_pressure", "laminar"): lambda: {"rise_pa_s_m3": like["rise_pa_s2_m6"] * 2.9e-3},
        # The same flow at 1.8 bar.
        ("leakage", "orifice"): lambda: {"area_m2": like["conductance_kg_s_pa2"] * (1.8e5**2 - 1.013e5**2) / 422.0},
        ("wall_heat_exchange", "wall"): lambda: {"coefficient_w_m2k": 5.0 * like["extra_share"]},
    }.get((name, form), lambda: dict(like))
    return Concealed(name, form, values())


def unlisted(family: str, rng: np.random.Generator, transients: bool) -> tuple[Concealed, list[float] | None]:
    """An effect that resembles no listed one, and where along its coordinate it acts [SI].

    `transients`: whether the recording has runs in time after the sweep.
    """
    kinds = UNLISTED[family]
    kind = kinds[int(rng.integers(len(kinds)))]
    wide = _at(family)
    if kind == "torque_above_a_speed":
        speed = rng.uniform(*((26.0, 36.0), (20.0, 42.0))[wide])
        values = {"torque_nm": _log(rng, ((0.15, 0.3), (0.12, 0.4))[wide]), "speed_rad_s": speed}
        return Concealed(kind, "clutch", values), [speed - 2.0, TOP_RAD_S]
    if kind == "torque_in_a_speed_band":
        speed, width = rng.uniform(20.0, 40.0), rng.uniform(2.0, 4.0)
        values = {"torque_nm": _log(rng, (0.15, 0.4)), "speed_rad_s": speed, "width_rad_s": width}
        return Concealed(kind, "bump", values), [speed - 2.0 * width, speed + 2.0 * width]
    moment = rng.uniform(*((0.35, 0.6), (0.25, 0.75))[wide]) * SWEEP_S
    since = [moment, SWEEP_S + (200.0 if transients else 0.0)]
    if kind == "torque_from_a_moment_on":
        return Concealed(kind, "step", {"torque_nm": _log(rng, (0.1, 0.3)), "moment_s": moment}), since
    if kind == "tachometer_slips_from_a_moment_on":
        return Concealed(kind, "step", {"slip": _log(rng, (0.02, 0.06)), "moment_s": moment}), since
    if kind == "regulator_hysteresis":
        return Concealed(kind, "band", {"half_width_pa": _log(rng, (1000.0, 2500.0))}), None
    if kind == "gauge_sawtooth":
        values = {
            "height_pa": _log(rng, (1000.0, 2500.0)),
            "period_pa": rng.uniform(3.5e4, 5.5e4),
            "phase": rng.random(),
        }
        return Concealed(kind, "sawtooth", values), None
    if kind == "flow_float_sticks":
        return Concealed(kind, "band", {"half_width_m3_s": _log(rng, ((5e-5, 8e-5), (4e-5, 1.1e-4))[wide])}), None
    height = _log(rng, ((6e-5, 1e-4), (5e-5, 1.2e-4))[wide])
    values = {"height_m3_s": height, "period_m3_s": rng.uniform(4e-4, 6e-4), "phase": rng.random()}
    return Concealed("flow_sawtooth", "sawtooth", values), None


def _at(family: str) -> int:
    if family not in FAMILIES:
        raise ValueError(f"no family of draws {family!r}; there are {' and '.join(FAMILIES)}")
    return FAMILIES.index(family)


def _log(rng: np.random.Generator, span: Range) -> float:
    return float(np.exp(rng.uniform(np.log(span[0]), np.log(span[1]))))


def _orifice(loss: float, P: float, volume: float, reference: float) -> float:
    """Area of a nozzle that loses at a volume flow what the quadratic law with its coefficient loses there [m2]."""
    density = P / (287.055 * 293.15)
    lost = loss * density / reference * volume**2
    return float(density * volume / np.sqrt(2.0 * density * lost))


def _bad_rows(family: str, rng: np.random.Generator) -> dict[str, float]:
    """Readings misread: one to three of the 26 rows, in one channel each."""
    rows = rng.choice(26, size=int(rng.integers(1, 4 if family == "proof" else 3)), replace=False) + 1
    found = {}
    for row in sorted(int(r) for r in rows):
        channel = str(rng.choice(["speed", "speed", "flow", "pressure"]))
        size = {"speed": (1.0, 5.0), "flow": (1.3e-4, 5e-4), "pressure": (4e3, 2e4)}[channel]
        found[f"{channel}_row_{row}"] = _log(rng, size) * float(rng.choice([-1.0, 1.0]))
    return found
