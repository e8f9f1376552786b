"""Step 6: which test would part explanations that this recording cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.name import Candidate
from calibration.diagnosis.problem import CHANNELS
from model import layout as at
from model import steady as base_steady
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.effect import unknown_state
from model.effects.laws import readings_of
from model.transient import OMEGA, Supply, rest_state

SAMPLE_S = 0.005
MOST = 4
LEAST_NATS = 0.1
BLUR = 5e-3  # of a reading: what a test leaves open of the nuisances
MOST_NATS = 20.0  # what is told beyond this is certainty


@dataclass(frozen=True)
class NextTest:
    """A test, and what it would tell.

    Attributes
    ----------
    test : str
        In words.
    separates : tuple of str
        Effects, or sets joined by +.
    information_nats : float
        Expected, one repeat [-].
    """

    test: str
    separates: tuple[str, ...]
    information_nats: float


def propose(comparison: Comparison, rivals: Sequence[Candidate]) -> list[NextTest]:
    """Tests ranked by what they would tell between the two most probable rivals.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    rivals : sequence of Candidate
        Explanations, the most probable first.
    """
    if len(rivals) < 2:
        return []
    problem = comparison.problem
    top = float(np.nanmax(problem.blocks.plateaus.pressure)) if comparison.n else 2e5
    low = float(np.nanmin(problem.blocks.plateaus.pressure)) if comparison.n else 1.2e5
    middle = 0.5 * (top + low)
    found: list[NextTest] = []
    for other in rivals[1:3]:
        pair = (rivals[0], other)
        names = tuple("+".join(c.names) if c.names else "nothing missing" for c in pair)
        tests = {
            f"coast-down from {middle / 1e5:.1f} bar": lambda c: _run(comparison, c, middle, 1.0, False),
            f"coast-down from {top / 1e5:.1f} bar": lambda c: _run(comparison, c, top, 1.0, False),
            f"coast-down from {middle / 1e5:.1f} bar with a flywheel of three times the inertia": lambda c: _run(
                comparison, c, middle, 4.0, False
            ),
            f"spin-up to {top / 1e5:.1f} bar": lambda c: _run(comparison, c, top, 1.0, True),
            f"ten plateaus at {1.3 * top / 1e5:.1f} bar": lambda c: _plateau(comparison, c, 1.3 * top, 600.0),
            f"ten plateaus at {low / 1e5:.2f} bar": lambda c: _plateau(comparison, c, low, 600.0),
            f"ten plateaus at {middle / 1e5:.1f} bar, cold": lambda c: _plateau(comparison, c, middle, 0.0),
        }
        for text, simulate in tests.items():
            try:
                (a, sd), (b, _) = simulate(pair[0]), simulate(pair[1])
            except ArithmeticError:
                continue
            blur = np.abs(a) * BLUR  # what the nuisances still leave open, roughly
            D = float(np.sum((a - b) ** 2 / (sd**2 + blur**2)))
            found.append(NextTest(text, names, round(0.5 * min(D, 2.0 * MOST_NATS), 2)))
        gauge = [c for c in pair if any("pressure_gauge" in n for n in c.names)]
        if len(gauge) == 1:
            k = len(problem.nuisances)
            values = problem.chosen(gauge[0].names, gauge[0].mode.z[k:]).get("pressure_gauge_offset")
            if values:
                sd_pa = problem.noise["pressure"]
                found.append(
                    NextTest(
                        "zero: read the gauge with the line vented",
                        names,
                        round(0.5 * min((values["offset_pa"] / max(sd_pa, 1.0)) ** 2, 2.0 * MOST_NATS), 2),
                    )
                )
        if any(n in ("flow_offset", "leakage", "flow_scale") for c in pair for n in c.names):
            found.append(NextTest("locked rotor: flow at 2 bar with the rotor held", names, _locked(comparison, pair)))
    return ranked(found)


def ranked(found: Sequence[NextTest]) -> list[NextTest]:
    """The few tests that would tell most; those that would tell next to nothing are left out.

    Parameters
    ----------
    found : sequence of NextTest
        In any order.
    """
    best = sorted((t for t in found if t.information_nats >= LEAST_NATS), key=lambda t: -t.information_nats)
    return best[:MOST]


def _parts(comparison: Comparison, one: Candidate) -> tuple[np.ndarray, dict[str, dict[str, float]]]:
    problem = comparison.problem
    k = len(problem.nuisances)
    parameters = problem.split(one.mode.z[:k])[0]
    return parameters, problem.chosen(one.names, one.mode.z[k:])


def _run(
    comparison: Comparison, one: Candidate, pressure: float, inertia: float, from_rest: bool
) -> tuple[np.ndarray, np.ndarray]:
    problem = comparison.problem
    parameters, chosen = _parts(comparison, one)
    parameters = parameters.copy()
    parameters[at.J] *= inertia
    start = rest_state(problem.motor, 0.0)
    time = np.arange(0.0, 0.15 * inertia, SAMPLE_S)
    supply = [Supply(-0.5, pressure, from_rest)]
    if not from_rest:
        line = np.array([pressure])
        readings = problem.motor.readings.vector()
        first = effect_steady.solve(
            parameters[None, :], readings, line, base_steady.gas_table(problem.motor, line), chosen, np.zeros(1)
        )
        start[OMEGA] = float(first.speed[0])
    found = effect_transient.simulate(
        parameters, problem.motor.readings.vector(), supply, time, start, chosen, 600.0, 3
    )
    reading = readings_of(chosen, "speed", found.reading, unknown_state(found.reading))[1:]
    sd = np.full(reading.size, 2.0 * problem.noise["speed"] + 1e-9)
    return reading, sd


def _plateau(comparison: Comparison, one: Candidate, pressure: float, time: float) -> tuple[np.ndarray, np.ndarray]:
    problem = comparison.problem
    parameters, chosen = _parts(comparison, one)
    line = np.array([pressure])
    found = effect_steady.solve(
        parameters[None, :],
        problem.motor.readings.vector(),
        line,
        base_steady.gas_table(problem.motor, line),
        chosen,
        np.array([time]),
        slopes=True,
    )
    noise = {c: problem.noise[c] / np.sqrt(10.0) for c in CHANNELS}
    sd_speed = np.hypot(noise["speed"], found.speed_slope[0] * noise["pressure"])
    sd_flow = np.hypot(noise["flow"], found.flow_slope[0] * noise["pressure"])
    speed = readings_of(chosen, "speed", found.speed, found.state)[0]
    flow = readings_of(chosen, "flow", found.flow, found.state)[0]
    return np.array([speed, flow]), np.array([sd_speed, sd_flow])


def _locked(comparison: Comparison, pair: Sequence[Candidate]) -> float:
    """Flow with the rotor held: a leak flows on, a meter's scale error reads nothing."""
    problem = comparison.problem
    flows = []
    for one in pair:
        _, chosen = _parts(comparison, one)
        leak = chosen.get("leakage", {}).get("conductance_kg_s_pa2", 0.0) * (2.0e5**2 - 1.013e5**2) / 2.38
        flows.append(leak + chosen.get("flow_offset", {}).get("offset_m3_s", 0.0))
    sd = max(problem.noise["flow"], 1e-9)
    return round(0.5 * min(((flows[0] - flows[1]) / sd) ** 2, 2.0 * MOST_NATS), 2)
