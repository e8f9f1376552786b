"""Teeth of a tachometer's wheel that are off their places: the same ones in every turn, so they pass for physics.

A tooth that stands too far on makes one sample too slow and the next too fast, and does so again a turn later. The
slowest harmonics of that pattern look like a torque that follows the shaft; they are unknowns of each run, for nobody
notes which tooth is which. What is left of the errors is noise from sample to sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from calibration.data.runs import RunInTime
from calibration.unknowns.priors import Unknown, unknown_of_run
from rig.recording import Recording

PITCH_SD = 0.002  # of a tooth's place where nothing is stated, in shares of the pitch
HARMONICS = (1, 2)  # of the turn
# What a run has for itself of its wheel: of each a harmonic, and which part of it.
WAVES = {f"wheel_{k}_{name}": (k, part) for k in HARMONICS for name, part in (("cos", np.cos), ("sin", np.sin))}


def pitch_sd(recording: Recording) -> float:
    """Error of the place of a tooth [rad]; 0 where the speed is not counted by teeth."""
    figures = recording.channels.get("speed_rpm")
    if figures is None or not figures.pulses_per_rev:
        return 0.0
    share = PITCH_SD if figures.pitch_error_sd is None else figures.pitch_error_sd
    return share * 2.0 * math.pi / figures.pulses_per_rev


def harmonics_of(recording: Recording) -> tuple[int, ...]:
    """Harmonics of the turn that a wheel's errors have, fewer of a wheel with few teeth; none of another tachometer."""
    figures = recording.channels.get("speed_rpm")
    if figures is None or not figures.pulses_per_rev or figures.window_s is not None:
        return ()
    return tuple(k for k in HARMONICS if 2 * k < figures.pulses_per_rev)


def rest_sd(recording: Recording) -> float:
    """Error of the place of a tooth without its harmonics that are unknowns [rad]."""
    kept = harmonics_of(recording)
    if not kept:
        return pitch_sd(recording)
    teeth = float(recording.channels["speed_rpm"].pulses_per_rev or 1.0)
    return pitch_sd(recording) * math.sqrt(max(1.0 - 2.0 * len(kept) / teeth, 0.0))


def wheel_unknowns(run: RunInTime, recording: Recording) -> list[Unknown]:
    """The unknowns of the wheel in a run, named after its file [rad]."""
    kept = harmonics_of(recording)
    if not kept:
        return []
    sd = pitch_sd(recording) * math.sqrt(2.0 / float(recording.channels["speed_rpm"].pulses_per_rev or 1.0))
    return [
        unknown_of_run(run.file, what, "rad", "normal", 0.0, sd, "teeth that are off their places")
        for what, (k, _) in WAVES.items()
        if k in kept
    ]


def seen(run: RunInTime, what: str) -> np.ndarray:
    """What a wheel's unknown adds to the samples of a run [rad/s per rad], shape (n,)."""
    k, part = WAVES[what]
    step = run.time - run.begin
    ends = np.cumsum(run.speed * np.diff(run.time, prepend=run.begin[:1]))  # where a row is missing it turned on
    begins = ends - run.speed * step
    found: np.ndarray = (part(k * ends) - part(k * begins)) / step
    return found


def added(run: RunInTime, own: Mapping[str, float]) -> np.ndarray:
    """What the wheel adds to the samples of a run [rad/s], shape (n,).

    `own`: the run's own unknowns, by the ends of their names.
    """
    found = np.zeros(run.size)
    for what, value in own.items():
        if what in WAVES:
            found += value * seen(run, what)
    return found
