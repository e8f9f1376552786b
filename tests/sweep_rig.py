"""A rig of sweeps alone, made by the model itself: no proof of anything, but real recordings for the whole engine."""

from __future__ import annotations

from tests import diagnosis_recordings, fake_rig

NAME = "tests.sweep_rig"
CONCEALED = ({}, {"leakage": {"conductance_kg_s_pa2": 6e-14}}, {})


class Truth(fake_rig.Truth):
    """The same fields."""


def draw(family, index, seed):
    chosen = CONCEALED[index % len(CONCEALED)]
    place = {"balance": "mass" if "leakage" in chosen else "torque"}
    return Truth(family, index, "single" if chosen else "none", list(chosen), chosen, place, 0.0625)


def make_recording(truth, folder):
    diagnosis_recordings.sweep(folder, truth.index + 1, truth.sizes)


def separable(truth, folder):
    return {"D": None, "rho": None, "rival": None, "separable": False}
