"""Recordings in strata: every unknown drawn from its prior, readings by the model and the noise of a diagnosis.

The design (levels, instruments, samples of the runs) is that of one recording of `nulls_draw`, and stays; behind real
supplies each case has a design of its own, a recording of the second rig. Truths with which the model gives no reading
of it, and plateaus that are not above 0, are drawn anew: the recording would be another one then. The posterior knows
this, for the model gives such truths no probability.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from zlib import crc32

import numpy as np

from calibration.data.runs import UNTOLD
from calibration.fit.whole import parts_of
from calibration.likelihood.function import Function
from calibration.studies.follow_ups import nothing_concealed
from calibration.studies.nulls_draw import OF_A_BENCH, null_recording
from calibration.systems.look_up import compared
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.noise import SAMPLES
from calibration.systems.several.comparison import Several
from calibration.unknowns import priors
from calibration.unknowns.effects import sampled
from calibration.unknowns.priors import OfRun
from rig.recording import Recording, read_recording
from rig.recording.columns import OF_CHANNEL

EFFECTS = ("coulomb_friction", "windage", "leakage", "flow_scale")
DESIGN_SEED = 5  # a motor of ordinary friction that turns at every level and all along both runs
DRIFT = 0.5  # sd of an offset's drift from day to day, of the offset's
TRIES = 1000
SEEDS = 1_000_000  # from one design's seed to that of the next, where it is drawn anew


@dataclass(frozen=True)
class Stratum:
    """Recordings of one kind.

    `effects`: of which each recording has one, in turn; none where there are none.
    `louder`: noise over the declared [-]; 0 where it is drawn from its prior.
    `whole_lines`: whether the lines of the runs are drawn from the whole of their priors, not as one bench has them.
    `real_supplies`: whether the designs are recordings of the second rig, behind lines that fill and droop.
    """

    words: str
    runs: bool = False
    days: int = 1
    effects: tuple[str, ...] = ()
    louder: float = 0.0
    whole_lines: bool = False
    real_supplies: bool = False


STRATA = {
    "sweep": Stratum("a sweep of 26 plateaus"),
    "sweep_effect": Stratum("the same, with an effect", effects=EFFECTS),
    "two_days": Stratum("two sweeps on two days, in other rooms, the instruments' offsets drifted", days=2),
    "louder": Stratum("a sweep, its noise 1.3 times the declared and not correlated", louder=1.3),
    "runs": Stratum("a sweep, a spin-up and a coast-down", runs=True),
    "runs_effect": Stratum("the same, with an effect", runs=True, effects=EFFECTS),
    "runs_any_line": Stratum("with runs, their lines from all of the priors", runs=True, whole_lines=True),
    "real_supplies": Stratum("other benches, with runs behind real supplies", runs=True, real_supplies=True),
}


@dataclass(frozen=True)
class Case:
    """A recording with its truth.

    `z`, shape (m,): the unknowns of nuisances and effects [-].
    `u`, shape (k,): the noise [-].
    `tries`: draws until the model gave a reading of everything [-].
    """

    recordings: tuple[Recording, ...]
    comparison: Comparison | Several
    names: tuple[str, ...]
    z: np.ndarray
    u: np.ndarray
    tries: int


def case_of(stratum: Stratum, seed: int) -> Case:
    """The case of a seed. Raises ArithmeticError when no truth of `TRIES` gives a reading of everything."""
    rng = np.random.default_rng([seed, crc32(stratum.words.encode())])  # strata share no draws
    recordings = (_of_second_rig(seed),) if stratum.real_supplies else designs(stratum.runs, stratum.days)
    comparison = _compared(recordings)
    names = (stratum.effects[seed % len(stratum.effects)],) if stratum.effects else ()
    f = Function(comparison, names)
    for tries in range(1, TRIES + 1):
        z, u = _truth(stratum, comparison, f, rng), _noise(stratum, comparison, rng)
        if np.any(z != f.clip(z)):
            continue
        try:
            if stratum.runs and isinstance(comparison, Comparison):
                comparison.see_pulses(z[: f.k])
            prediction = f(z)
        except ArithmeticError:
            continue
        if not comparison.is_told(prediction):
            continue
        read = comparison.raw(prediction) + comparison.drawn_noise(prediction, u, rng)
        if all(np.all(read[at][: 2 * part.n] > 0.0) for _, part, at in parts_of(comparison)):
            shown, comparison = _with_readings(recordings, comparison, read)
            return Case(shown, comparison, names, z, u, tries)
    raise ArithmeticError(f"none of {TRIES} truths gives a reading of everything")


@cache
def designs(runs: bool, days: int) -> tuple[Recording, ...]:
    """A recording of each day, whose readings say nothing but which samples there are."""
    nominal, _ = null_recording("declared", runs, np.random.default_rng(DESIGN_SEED))
    if days == 1:
        return (nominal,)
    channels = {name: replace(one, serial=name, drift_sd=DRIFT * one.bias_sd) for name, one in nominal.channels.items()}
    days_of_it = [f"2026-05-{10 + day}" for day in range(days)]
    return tuple(
        replace(nominal, channels=channels, folder=Path(day), sha256=day, origin={"date": day}) for day in days_of_it
    )


def _of_second_rig(seed: int) -> Recording:
    """A recording of the second rig with a spin-up and a coast-down behind a real supply, nothing concealed in it.

    One whose gauge is silent while a line stands open is drawn anew: the speeds read at the plateaus say then what the
    line held, so that other readings would make another design.
    """
    from calibration.challenge.second_rig import draw, make_recording

    for of_design in range(seed, seed + TRIES * SEEDS, SEEDS):
        truth = nothing_concealed(draw("development", of_design, "follow-ups"))
        with tempfile.TemporaryDirectory() as place:
            make_recording(truth, folder := Path(place) / "recording")
            recording = read_recording(folder)
        comparison = _compared((recording,))
        runs = [run for _, part, _ in parts_of(comparison) for run in part.problem.blocks.runs]
        if runs and not any(run.settled_sd >= UNTOLD * max(span.pressure_pa for span in run.valve) for run in runs):
            return recording
    raise ArithmeticError(f"none of {TRIES} recordings has a run whose gauge tells the line")


def _compared(recordings: tuple[Recording, ...]) -> Comparison | Several:
    found = compared(recordings if len(recordings) > 1 else recordings[0])
    if not isinstance(found, Comparison | Several):
        raise TypeError("the design is of another machine")
    return found


def _truth(stratum: Stratum, comparison: Comparison | Several, f: Function, rng: np.random.Generator) -> np.ndarray:
    """Every unknown from its prior, an effect's size from the one with the longer tails [-], shape (m,)."""
    problem = comparison.problem
    z = priors.draw(problem.nuisances, rng, 1)[0]
    for i, unknown in enumerate(problem.nuisances):
        if not stratum.whole_lines and isinstance(unknown.of, OfRun):
            if unknown.of.what == "floor":
                z[i] = unknown.z(0.0)
            else:
                z[i] *= next((share for end, share in OF_A_BENCH.items() if unknown.of.what.endswith(end)), 1.0)
    of_effects = [
        unknown.z(float(sampled(name, problem.parameter(name, unknown.name)).value(rng.standard_normal(1))[0]))
        for name, unknown in problem.effect_unknowns(f.names)
    ]
    return np.append(z, of_effects)


def _noise(stratum: Stratum, comparison: Comparison | Several, rng: np.random.Generator) -> np.ndarray:
    """The noise, shape (k,) [-]."""
    noise = comparison.noise
    u: np.ndarray = noise.spread * rng.standard_normal(noise.spread.size) * noise.free
    if stratum.louder:
        u[:] = 0.0
        u[noise.scales] = math.log(stratum.louder)
    if isinstance(comparison, Comparison):
        u[SAMPLES] = abs(u[SAMPLES])  # a search has none below 0
    return u


def _with_readings(
    recordings: tuple[Recording, ...], comparison: Comparison | Several, read: np.ndarray
) -> tuple[tuple[Recording, ...], Comparison | Several]:
    """The recordings with other readings: the plateaus' in their files, the runs' in the vector alone.

    `read`, shape (n,): the readings [SI].
    """
    shown = []
    for recording, (_, part, at) in zip(recordings, parts_of(comparison), strict=True):
        plateaus = part.problem.blocks.plateaus
        names, size = np.array(plateaus.file), 2 * part.n
        known, flow_speed = part.known[:size].reshape(2, -1), read[at][:size].reshape(2, -1)
        files = []
        for file in recording.files:
            columns = dict(file.columns)
            for channel, seen, values in zip(("flow", "speed"), known, flow_speed, strict=True):
                mine = np.flatnonzero((names == file.file) & seen)
                if mine.size:
                    name, to_si = OF_CHANNEL[channel].column, OF_CHANNEL[channel].to_si
                    shown_there = columns[name].values.copy()
                    shown_there[plateaus.row[mine] - 1] = values[mine] / to_si
                    columns[name] = replace(columns[name], values=shown_there)
            files.append(replace(file, columns=columns))
        shown.append(replace(recording, files=tuple(files)))
    found = _compared(tuple(shown))
    found.read = read
    for _, part, at in parts_of(found):
        part.read = read[at]
    return tuple(shown), found
