"""Which test on another rig would part explanations that its recording cannot tell apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from calibration.diagnosis.next_test.information import Expected
from calibration.diagnosis.next_test.recommend import MODEL_SD, NOTHING, NextTest, ranked, weigh
from calibration.diagnosis.other_rigs.coordinates import Coordinates
from calibration.diagnosis.other_rigs.problem import RigProblem
from calibration.diagnosis.steps.candidate import Candidate
from calibration.systems.driven_axis import loaded
from calibration.unknowns.priors import PASCAL_PER_BAR
from model.effects.laws import Chosen, readings_of
from model.layout import RPM
from model.rigs.displacement_machine import rows
from model.rigs.driven_axis import blocks_of, drive
from model.rigs.free_rotor import coast

MOST_RIVALS = 3
REPEATS = 10.0
SAMPLES = 60  # of a coast-down
SPEEDS = (0.1, 0.3, 1.5)  # of the ordinary speed, at which an axis is driven

Simulated = tuple[np.ndarray, np.ndarray]  # readings, and their deviations [SI]
Simulate = Callable[[Mapping[str, float], Chosen], Simulated]


def propose(problem: RigProblem, rivals: Sequence[Candidate]) -> list[NextTest]:
    """Tests ranked by what they would tell of the first few rivals, the mean over their pairs."""
    tests = {"free_rotor": _rotor, "driven_axis": _axis, "displacement_machine": _machine}[problem.kind](
        problem, rivals
    )
    weighed = rivals[:MOST_RIVALS]
    if len(weighed) < 2:
        return []
    names = [_words(one) for one in weighed]
    found = (weigh(text, names, partial(_each, problem, weighed, simulate)) for text, simulate in tests.items())
    return ranked([one for one in found if one])


def _words(one: Candidate) -> str:
    return "+".join(one.names) or NOTHING


def _each(problem: RigProblem, rivals: Sequence[Candidate], simulate: Simulate) -> list[Expected]:
    return [_expected(problem, one, simulate) for one in rivals]


def _expected(problem: RigProblem, one: Candidate, simulate: Simulate) -> Expected:
    """What a test would read if an explanation holds, with what the fit leaves open, in its noise."""
    at, x = Coordinates(problem, one.names), one.mode.point
    here, sd = simulate(*at.values(x))
    slopes = np.empty((here.size, x.size))
    for i in range(x.size):
        step = min(0.1, max(1e-3, 0.1 * float(np.sqrt(one.mode.covariance[i, i]))))
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        slopes[:, i] = (simulate(*at.values(moved))[0] - here) / step
    shared = slopes @ one.mode.covariance @ slopes.T + np.diag((MODEL_SD * here) ** 2)
    return Expected(here / sd, shared / np.outer(sd, sd), np.eye(here.size))


def _noise(problem: RigProblem, rivals: Sequence[Candidate], channel: str) -> float:
    """Noise of one reading of a channel as the best explanation has it [SI]; infinite where there is none."""
    of_channel = [one for one in problem.readings if one.channel == channel and one.value.size]
    if not of_channel:
        return float("inf")
    return float(np.median([np.median(one.sd) * rivals[0].mode.noise_scale[one.label] for one in of_channel]))


def _zero(problem: RigProblem, channel: str) -> float:
    return next((unknown.b for unknown in problem.unknowns if unknown.name == f"{channel}_offset"), 0.0)


def _machine(problem: RigProblem, rivals: Sequence[Candidate]) -> dict[str, Simulate]:
    speed, pressure, _, _ = problem.seen.rows
    top, slow, fast = float(pressure.max()), float(speed.min()), float(speed.max())
    sd = [np.hypot(_noise(problem, rivals, c) / np.sqrt(REPEATS), _zero(problem, c)) for c in ("drive", "flow")]

    def at(omega: float, P: float, flow_alone: bool = False) -> Simulate:
        def simulate(values: Mapping[str, float], chosen: Chosen) -> Simulated:
            one = np.ones(1)
            V = float(problem.motor["displacement_m3_per_rev"]) * values["displacement"]
            friction = values.get("viscous_friction", 0.0)
            found = rows(V, friction, omega * one, P * one, problem.room * one, problem.ambient, 0.0 * one, chosen)
            flow = readings_of(chosen, "flow", found.flow, found.state) * (1.0 + values.get("flow_scale", 0.0))
            torque = found.torque * (1.0 + values.get("drive_scale", 0.0))
            both = np.array([torque[0], flow[0]])
            if flow_alone:  # at rest friction may be anything
                return both[1:], np.array(sd[1:])
            return both, np.array(sd)

        return simulate

    words = f"bar abs, {REPEATS:.0f} plateaus"
    return {
        f"locked rotor: flow at zero speed and {top / PASCAL_PER_BAR:.2f} {words}": at(0.0, top, True),
        f"{0.5 * slow * RPM:.0f} rpm at {top / PASCAL_PER_BAR:.2f} {words}": at(0.5 * slow, top),
        f"{fast * RPM:.0f} rpm at {0.5 * top / PASCAL_PER_BAR:.2f} {words}": at(fast, 0.5 * top),
    }


def _axis(problem: RigProblem, rivals: Sequence[Candidate]) -> dict[str, Simulate]:
    sd = np.array([_noise(problem, rivals, "drive") / np.sqrt(REPEATS)])
    ordinary = problem.sizes.speed
    fastest = max(
        float(np.abs(blocks.mean(blocks.speed)[blocks.used]).max(initial=0.0)) for _, blocks in problem.seen.blocks
    )
    gauges = [
        blocks.pressure - problem.ambient for _, blocks in problem.seen.blocks if np.isfinite(blocks.pressure).any()
    ]
    middle = float(np.nanmean(np.concatenate(gauges))) if gauges else None

    def at(speed: float, gauge: float | None) -> Simulate:
        def simulate(values: Mapping[str, float], chosen: Chosen) -> Simulated:
            time = np.linspace(0.0, 1.0, 6)
            read = []
            for v in (speed, -speed):  # there and back: half the difference leaves the offset and the gas force out
                P = None if gauge is None else np.full(time.size, problem.ambient + gauge)
                one = blocks_of(time, np.zeros(time.size), np.full(time.size, v), 5, 0.0, None, P)
                effects = loaded(values, chosen)
                read.append(drive(problem.inertia, values["viscous_friction"], one, effects, 0.0, problem.ambient)[0])
            return np.array([0.5 * (read[0] - read[1])]), sd

        return simulate

    unit = "m/s" if problem.slides else "rad/s"
    tests = {
        f"steady strokes there and back at {speed:.3g} {unit}": at(speed, middle)
        for speed in (min(share * ordinary, fastest) for share in SPEEDS)  # never faster than the axis is known to go
    }
    if middle is not None:
        tests[f"steady strokes at {ordinary:.3g} {unit} with the pressure let off"] = at(ordinary, 0.0)
    return tests


def _rotor(problem: RigProblem, rivals: Sequence[Candidate]) -> dict[str, Simulate]:
    sd = _noise(problem, rivals, "speed")
    time = problem.seen.coasts[0][1]
    first, span = float(problem.readings[0].value[0]), float(time[-1] - time[0])

    def at(share: float, inertia: float) -> Simulate:
        def simulate(values: Mapping[str, float], chosen: Chosen) -> Simulated:
            t = np.linspace(0.0, 2.0 * inertia * span, SAMPLES)
            friction = values["viscous_friction"]
            return coast(inertia * problem.inertia, friction, t, share * first, chosen).reading, np.full(SAMPLES, sd)

        return simulate

    return {
        f"coast-down from {0.3 * first * RPM:.0f} rpm to standstill": at(0.3, 1.0),
        f"coast-down from {first * RPM:.0f} rpm to standstill": at(1.0, 1.0),
        f"coast-down from {first * RPM:.0f} rpm with a flywheel of three times the inertia": at(1.0, 4.0),
    }
