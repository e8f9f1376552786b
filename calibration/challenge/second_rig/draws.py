"""Drawing a case. The make-up of a campaign is held in every block of twenty cases, whatever the seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from calibration.challenge.second_rig import sizes
from calibration.challenge.second_rig.concealed import LISTED, TRANSIENT_ONLY, USUAL, Concealed, figures
from calibration.challenge.second_rig.equipment import draw_instruments, draw_supply
from calibration.challenge.second_rig.machine.losses import drag
from calibration.challenge.second_rig.machine.marches import gas_torque
from calibration.challenge.second_rig.machine.slots import BAR, DEFAULTS, vector
from calibration.challenge.second_rig.truth import Truth, digest, generator

NONE, SINGLE, OTHER_FORM, PAIR, NOT_IN_LIBRARY = "none", "single", "other_form", "pair", "not_in_library"
MAKE_UP = {NONE: 4, NOT_IN_LIBRARY: 3, OTHER_FORM: 4, PAIR: 4, SINGLE: 5}  # of twenty
BLOCK = sum(MAKE_UP.values())
NEAR_SHARE = 0.25  # of effects that have the form of a nuisance
MISDECLARED_SHARE = 0.25  # of cases that conceal something
BEYOND = 2.5  # sds at which draws of nuisances are cut
NEAR_SDS = 4.0
TURNS_PA, SLOW_RAD_S = 1.5e5, 5.0  # line and speed at which a case has to have torque to spare

# One sd of each nuisance: narrow ones to practise on, and those that recordings and motor declare.
WIDTHS = {
    "practice": {"lap": np.radians(0.5), "roller_factor": 0.1, "ambient_pa": 150.0, "inertia": 0.03, "inlet_k": 0.1},
    "declared": {
        "lap": np.radians(1.0),
        "roller_factor": float(np.log(2.0)),
        "ambient_pa": 150.0,
        "inertia": float(np.log(1.1)),
        "inlet_k": 0.5,
    },
}
FRICTION = (0.055, 0.072)  # N m s
ERRORS = {
    "pressure_offset_bar": 0.005,
    "pressure_scale": 0.002,
    "flow_offset_l_min": 0.5,
    "flow_scale": 0.02,
    "speed_offset_rpm": 0.1,
    "speed_scale": 0.0005,
}


def draw(family: str, index: int, seed: int | bytes | str) -> Truth:
    """Draw a case.

    `index`: of the case [-]; twenty in a row have the whole make-up.
    Raises ValueError when there is no such family.
    """
    if family not in sizes.FAMILIES:
        raise ValueError(f"no family of draws {family!r}; there are {' and '.join(sizes.FAMILIES)}")
    block, place = divmod(index, BLOCK)
    slots = [(category, k) for category, share in MAKE_UP.items() for k in range(share)]
    category, k = slots[int(generator(seed, family, "block", block).permutation(BLOCK)[place])]
    key = digest(seed, family, "case", index)
    rng = generator(key, "draw")
    # Half of each category has runs in time, of an odd share over two blocks.
    with_transients = (k + block * (MAKE_UP[category] % 2) + (category == SINGLE)) % 2 == 1
    misdeclared = k < MAKE_UP[NONE] // 2 if category == NONE else bool(rng.random() < MISDECLARED_SHARE)
    while True:
        effects, where = _effects(category, family, with_transients, rng)
        nuisances, errors = _nuisances(family, rng)
        if _turns(effects, nuisances):
            break
    total = _totals(effects, nuisances, errors)
    alone = _totals(effects, DEFAULTS, dict.fromkeys(ERRORS, 0.0))
    fitted = generator(key, "equipment")
    supply = draw_supply(fitted)
    return Truth(
        family=family,
        index=index,
        seed=key,
        category=category,
        ids=["unknown"] if category == NOT_IN_LIBRARY else sorted(effect.id for effect in effects),
        effects=[_plain(effect) for effect in effects],
        sizes={e.id: dict(e.values) for e in effects if USUAL.get(e.id) == e.form and e.id != "bad_reading"},
        place=_place(effects, where),
        f_overall=nuisances["f_overall"],
        nuisances=nuisances,
        errors=errors,
        sensors=_sensors(family, misdeclared, rng),
        with_transients=with_transients,
        misdeclared=misdeclared,
        near_nuisance=any(abs(size) <= NEAR_SDS for size in (*total.values(), *alone.values())),
        total_sds=total,
        supply=supply,
        instruments=draw_instruments(supply, fitted),
    )


def _effects(
    category: str, family: str, transients: bool, rng: np.random.Generator
) -> tuple[list[Concealed], list[float] | None]:
    """What is concealed, and where along its coordinate for what is in no library."""
    if category == NONE:
        return [], None
    if category == NOT_IN_LIBRARY:
        one, where = sizes.unlisted(family, rng, transients)
        return [one], where
    there = [name for name in LISTED if transients or name not in TRANSIENT_ONLY]
    if category == OTHER_FORM:
        there = [name for name in there if name in sizes.OTHER_FORMS]
        return [sizes.other(there[int(rng.integers(len(there)))], family, rng)], None
    names = rng.choice(there, size=2 if category == PAIR else 1, replace=False)
    return [sizes.usual(str(name), family, bool(rng.random() < NEAR_SHARE), rng) for name in names], None


def _nuisances(family: str, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Figures of the motor off their defaults, and the instruments' errors."""
    setting = "practice" if family == "development" or rng.random() < 0.5 else "declared"
    width = WIDTHS[setting]
    nuisances = {
        "f_overall": float(rng.uniform(*FRICTION)),
        "lap": DEFAULTS["lap"] + width["lap"] * _cut(rng),
        "roller_factor": DEFAULTS["roller_factor"] * float(np.exp(width["roller_factor"] * _cut(rng))),
        "ambient_pa": DEFAULTS["ambient_pa"] + width["ambient_pa"] * _cut(rng),
        "inertia": DEFAULTS["inertia"] * float(np.exp(width["inertia"] * _cut(rng))),
        "inlet_k": DEFAULTS["inlet_k"] + width["inlet_k"] * _cut(rng),
    }
    return nuisances, {name: sd * _cut(rng) for name, sd in ERRORS.items()}


def _turns(effects: list[Concealed], nuisances: dict[str, float]) -> bool:
    """Whether the motor surely turns at most levels: a sheet of standstills tells nothing."""
    p = vector(figures(nuisances, effects))
    gauge = TURNS_PA - nuisances["ambient_pa"]
    viscous, dry = drag(p, SLOW_RAD_S, gauge)
    return bool(gas_torque(p, gauge) > 1.5 * (dry + viscous * SLOW_RAD_S))


def _sensors(family: str, misdeclared: bool, rng: np.random.Generator) -> dict[str, float]:
    """The kind of noise. As declared: white, normal, of the declared size, samples on time to 50 us."""
    found = {"noise_scale": 1.0, "correlation": 0.0, "tails": 0.0, "drift_bar": 0.0, "jitter_s": 5e-5}
    if not misdeclared:
        return found
    if family == "development":
        kind = str(rng.choice(["larger", "correlated"]))
        spans = {"larger": ("noise_scale", 1.1, 1.25), "correlated": ("correlation", 0.2, 0.4)}
    else:
        kind = str(rng.choice(["larger", "correlated", "tails", "drift", "jitter"]))
        spans = {
            "larger": ("noise_scale", 1.15, 1.3),
            "correlated": ("correlation", 0.3, 0.6),
            "tails": ("tails", 4.0, 6.0),  # degrees of freedom of Student's t
            "drift": ("drift_bar", 0.001, 0.0025),  # of the gauge, over the sweep
            "jitter": ("jitter_s", 1e-4, 2e-4),
        }
    name, low, high = spans[kind]
    found[name] = float(rng.uniform(low, high)) * (float(rng.choice([-1.0, 1.0])) if kind == "drift" else 1.0)
    return found


def _totals(effects: list[Concealed], nuisances: Mapping[str, float], errors: Mapping[str, float]) -> dict[str, float]:
    """By id, effect and nuisance of one form together, in declared sds [-]."""
    found: dict[str, float] = {}
    for effect in effects:
        v = effect.values
        if effect.id == "pressure_gauge_offset":
            found[effect.id] = (v["offset_pa"] / BAR + errors["pressure_offset_bar"]) / ERRORS["pressure_offset_bar"]
        elif effect.id == "flow_offset":
            found[effect.id] = (v["offset_m3_s"] * 6e4 + errors["flow_offset_l_min"]) / ERRORS["flow_offset_l_min"]
        elif effect.id in ("pressure_gauge_scale", "flow_scale", "speed_scale"):
            error = effect.id.replace("gauge_", "")
            found[effect.id] = ((1.0 + v["scale"]) * (1.0 + errors[error]) - 1.0) / ERRORS[error]
        elif effect.id == "load_friction":
            extra = v.get("roller_factor", v.get("torque_per_pressure_m3", 0.0) / sizes.SEAL_PER_ROLLER_M3)
            ratio = (nuisances["roller_factor"] + extra) / DEFAULTS["roller_factor"]
            found[effect.id] = float(np.log(ratio) / WIDTHS["declared"]["roller_factor"])
        elif effect.id == "inertia":
            ratio = nuisances["inertia"] * (1.0 + v["share"]) / DEFAULTS["inertia"]
            found[effect.id] = float(np.log(ratio) / WIDTHS["declared"]["inertia"])
    return found


def _place(effects: list[Concealed], where: list[float] | None) -> dict[str, Any]:
    """Where a mismatch is; of two effects, either place is right."""
    if len(effects) > 1:
        return {"any_of": [_place([effect], where) for effect in effects]}
    if not effects:
        return {}
    found: dict[str, Any] = dict(sizes.PLACES[effects[0].id])
    if effects[0].id != "bad_reading":
        return found | {"where": where}
    rows = [int(name.partition("_row_")[2]) for name in effects[0].values]
    channels = {name.partition("_row_")[0] for name in effects[0].values}
    return found | {"channel": sorted(channels), "where": [float(min(rows)), float(max(rows))]}


def _cut(rng: np.random.Generator) -> float:
    """A standard normal number, drawn again beyond `BEYOND`."""
    while True:
        z = float(rng.standard_normal())
        if abs(z) <= BEYOND:
            return z


def _plain(effect: Concealed) -> dict[str, Any]:
    data = asdict(effect)
    return data | {"values": {name: float(value) for name, value in data["values"].items()}}
