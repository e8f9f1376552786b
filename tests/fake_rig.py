"""A rig and a diagnosis without physics, for tests of what makes, runs, scores and counts campaigns.

The recording tells its truth in its one reading, so that the diagnosis can be right, wrong or undecided as wanted.
"""

from __future__ import annotations

import dataclasses
import os
import time
from pathlib import Path

import numpy as np

NAME = "tests.fake_rig"
CATEGORIES = ("none", "single", "other_form", "pair", "not_in_library")
IDS = {
    "none": [],
    "single": ["coulomb_friction"],
    "other_form": ["windage"],
    "pair": ["leakage", "windage"],
    "not_in_library": ["backlash"],
}
PLACE = {"balance": "torque", "channel": "speed", "coordinate": "speed", "where": [10.0, 20.0]}


@dataclasses.dataclass(frozen=True)
class Truth:
    family: str
    index: int
    category: str
    ids: list
    sizes: dict
    place: dict
    f_overall: float
    with_transients: bool = False
    misdeclared: bool = False
    near_nuisance: bool = False


def draw(family, index, seed):
    if family not in ("development", "proof"):
        raise ValueError("families are development and proof")
    rng = np.random.default_rng([index, seed])
    category = CATEGORIES[rng.integers(len(CATEGORIES))]
    sizes = {one: {"torque_nm": 0.1} for one in IDS[category]}
    misdeclared = bool(rng.integers(2))
    f = round(float(rng.normal(0.06, 0.002)), 6)
    return Truth(family, index, category, IDS[category], sizes, PLACE, f, misdeclared=misdeclared)


def make_recording(truth, folder):
    (folder / "recording.toml").write_text('format = "recording/1"\n', encoding="utf-8")
    reading = CATEGORIES.index(truth.category)
    (folder / "sweep.csv").write_text(f"reading,f\n{reading},{truth.f_overall}\n", encoding="utf-8")


def follow_up(truth, test, folder):
    make_recording(truth, folder)
    (folder / "test.csv").write_text(test["test"] + "\n", encoding="utf-8")


def separable(truth, folder):
    return {"D": 12.0, "rho": 0.1, "rival": ["leakage"], "separable": truth.category != "other_form"}


def diagnose(argument):
    """As a perfect diagnosis would, but that another form is confounded until a further test is there."""
    time.sleep(argument.get("sleep", 0.0))
    folder = Path(argument["folder"])
    reading, f = (folder / "sweep.csv").read_text(encoding="utf-8").splitlines()[1].split(",")
    category = CATEGORIES[int(reading)]
    kind = {"none": "consistent", "not_in_library": "unresolved"}.get(category, "named")
    kind = "confounded" if category == "other_form" and not (folder / "test.csv").exists() else kind
    said = ["unknown"] if kind == "unresolved" else [] if kind == "consistent" else IDS[category]
    return {"diagnosis": verdict(kind, said, f=float(f), seed=argument["seed"]), "seconds": {"all": time.monotonic()}}


def verdict(kind, said, alternatives=None, f=0.06, probability=0.97, located=None, seed=0):
    """A diagnosis/1."""
    size = {"torque_nm": {"mean": 0.1, "sd": 0.01, "q05": 0.084, "q95": 0.116}}
    interval = {"mean": f, "sd": 0.001, "q05": f - 0.0016, "q95": f + 0.0016}
    place = {"balance": "torque", "channel": "speed", "coordinate": "speed", "where": [12.0, 18.0], "unit": "rad/s"}
    place |= {"kind": "balance", "p_value": 1e-6, "sentence": "There.", "same_as": ["pressure"], "recording": ""}
    return {
        "format": "diagnosis/1",
        "verdict": kind,
        "mismatch": {"p_value": 0.5 if kind == "consistent" else 1e-5},
        "located": [place] if located is None else located,
        "set_probability": probability,
        "effects": [
            {"id": one, "probability": probability, "log10_bayes_factor": 3.0, "parameters": size} for one in said
        ],
        "alternatives": [["leakage"]] if alternatives is None and kind == "confounded" else alternatives or [],
        "improvement": {"held_out": {"elpd_gain": 9.0}},
        "f_overall_before": interval,
        "f_overall_after": interval,
        "next_tests": [
            {"test": "coast-down", "separates": ["windage", "leakage"], "information_nats": 5.0, "command": ""}
        ],
        "why": "",
        "seed": seed,
    }


def square(argument):
    """A task for the engine: it may take a while, fail, or take its worker with it."""
    started = argument.get("started")
    if started:
        Path(started).write_text(str(os.getpid()), encoding="utf-8")
        time.sleep(argument.get("sleep", 0.0))
    if argument.get("fails"):
        raise ValueError(f"{argument['n']} cannot be squared")
    once = argument.get("dies_without")
    if once and not Path(once).exists():
        os._exit(9)
    return {"square": argument["n"] ** 2}
