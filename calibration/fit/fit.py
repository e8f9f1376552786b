"""The fit of a recording: everything from a folder to a posterior."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.data import measurement
from calibration.data.joined import flywheel_of_plateaus
from calibration.data.measurement import Measurement
from calibration.data.refusals import refuse_another_kind, refuse_unusable
from calibration.fit import posterior, proposed, sampling, store
from calibration.fit.posterior import FitQuality, Posterior, SuspectRow
from calibration.fit.sampling import Progress, Settings
from calibration.systems.radial_piston.batch import effects as with_effects
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from calibration.unknowns import priors
from calibration.unknowns.priors import CHANNELS
from calibration.work.sources import imported_sha256
from model.motor import Motor, read_motor, set_values
from rig.recording import Channel, Recording, RecordingError

GAUGE_CLASSES = (0.6, 1.0, 1.6, 2.5)
BRIEF_SAMPLES = 2000


class NotConvergedError(ArithmeticError):
    """The sampler's budget is spent and the chain is not long enough; what is drawn so far is kept."""


@dataclass(frozen=True)
class Fit:
    """A recording, what was assumed of it, and what came out.

    `quality`: whether the model explains the readings; None where that was not asked.
    """

    recording: Recording
    motor: Motor
    measured: Measurement
    likelihood: Likelihood
    posterior: Posterior
    settings: Settings
    effects: tuple[str, ...] = ()
    quality: FitQuality | None = None

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """What was fitted."""
        return (self.recording,)

    @property
    def notes(self) -> list[str]:
        """What the recording's reader warns of, and what was left aside."""
        runs = (file.file for file in self.recording.files if file.kind == "transient")
        aside = [f"{run}: a run in time; a fit to the plateaus alone does not use it" for run in runs]
        return list(dict.fromkeys([*self.measured.notes, *aside]))

    @property
    def rows(self) -> int:
        """Plateaus that were fitted [-]."""
        return len(self.measured.steady)

    @property
    def in_time(self) -> bool:
        """Whether runs in time were."""
        return False


def fit(
    recording: Recording,
    settings: Settings,
    assignments: Sequence[str] = (),
    channels: tuple[str, ...] = CHANNELS,
    chain_folder: Path | None = None,
    progress: Progress | None = None,
    effects: Sequence[str] = (),
) -> Fit:
    """Fit a recording.

    `assignments`: ``NAME=VALUE`` changes of the motor, as on the command line.
    `channels`: channels that the likelihood sees; pressure always.
    `chain_folder`: where the chain is kept as it grows, and continued from.
    Returns the result. Raises RecordingError when the recording holds nothing that can be fitted, or contradicts the
    motor; EffectsError for an effect that there is not, or that a fit cannot hold; NotConvergedError when the budget is
    spent.
    """
    begun = time.monotonic()
    motor, measured, likelihood = prepare(recording, assignments, channels, effects)
    mark = fingerprint(recording, motor, measured, settings, effects)
    chain = proposed.draw(likelihood, settings, chain_folder, mark, progress)
    if not chain.converged:
        raise NotConvergedError(why_not(chain, likelihood.unknowns, settings, chain_folder))
    bad = suspects(chain, likelihood, recording)
    result = posterior.summarise(chain, likelihood.unknowns, bad, time.monotonic() - begun)
    return Fit(recording, motor, measured, likelihood, result, settings, tuple(effects))


def prepare(
    recording: Recording,
    assignments: Sequence[str] = (),
    channels: tuple[str, ...] = CHANNELS,
    effects: Sequence[str] = (),
) -> tuple[Motor, Measurement, Likelihood]:
    """Everything of a fit but the sampling.

    Returns `motor`: at the recording's ambient; `measured`: the rows; `likelihood`: their likelihood. Raises
    RecordingError when the recording holds nothing that can be fitted, or contradicts the motor; EffectsError for an
    effect that there is not, or that a fit cannot hold.
    """
    refuse_another_kind(recording)
    motor = set_values(priors.at_ambient(read_motor(recording.motor), recording), list(assignments))
    measured = measurement.gather(recording, channels)
    refuse_unusable(
        dataclasses.replace(recording, files=tuple(file for file in recording.files if file.kind == "steady"))
    )
    seen = dataclasses.replace(
        recording,
        added_inertia_kg_m2=flywheel_of_plateaus(recording),
        channels={c: f for c, f in recording.channels.items() if _channel_of(c) in measured.channels},
    )
    held = with_effects.in_fit(effects, motor, recording, measured)
    found = priors.unknowns(motor, seen) + (held.unknowns() if held else [])
    return motor, measured, Likelihood(motor, seen, measured, found, effects=held)


def with_gauge_class(recording: Recording, accuracy_class: float, span_bar: float) -> Recording:
    """The recording as if its pressure gauge were of another accuracy class.

    `accuracy_class`: EN 837 class: limit of error in percent of the span [-].
    `span_bar`: the gauge's full scale [bar].
    Returns the same, its gauge's offset uncertain by the limit over sqrt(3) (a rectangular distribution's sd). Raises
    RecordingError when it has no pressure column, or the class or span is not positive.
    """
    column = priors.column_of(recording, "pressure")
    if column is None or not accuracy_class > 0.0 or not span_bar > 0.0:
        raise RecordingError(
            f"{recording.folder}: accuracy classes need a pressure column, and a positive class and span "
            f"(given: class {accuracy_class:g}, span {span_bar:g} bar)"
        )
    bias_sd = accuracy_class / 100.0 * span_bar / np.sqrt(3.0)
    gauge: Channel = dataclasses.replace(recording.channels[column], bias_sd=float(bias_sd), scale_sd=0.0)
    return dataclasses.replace(recording, channels={**recording.channels, column: gauge})


def variants(
    recordings: Sequence[Recording], channels: tuple[str, ...], without_flow: bool, span_bar: float | None
) -> list[tuple[str, list[Recording], tuple[str, ...]]]:
    """The fits that show what f_overall hangs on: a name, the recordings as changed, and the channels used.

    `span_bar`: full scale of the pressure gauge [bar]: one for each accuracy class; none when left out.
    """
    found: list[tuple[str, list[Recording], tuple[str, ...]]] = []
    if without_flow and "flow" in channels:
        found.append(("speed alone", list(recordings), ("pressure", "speed")))
    if span_bar is not None:
        for accuracy in GAUGE_CLASSES:
            changed = [with_gauge_class(one, accuracy, span_bar) for one in recordings]
            found.append((f"gauge of class {accuracy:g} of {span_bar:g} bar", changed, channels))
    return found


def brief(settings: Settings) -> Settings:
    """Settings for a fit that is only compared with: the same seed, fewer effective samples."""
    return dataclasses.replace(settings, effective_samples=min(settings.effective_samples, BRIEF_SAMPLES))


def fingerprint(
    recording: Recording, motor: Motor, measured: Measurement, settings: Settings, effects: Sequence[str] = ()
) -> str:
    """What a chain on disk has to share with a fit that goes on from it: all, the code too, but budget and target."""
    figures = {name: dataclasses.astuple(channel)[1:5] for name, channel in recording.channels.items()}
    parts = [
        store.of_readings(recording),
        motor.model_dump(),
        figures,
        measured.channels,
        settings.seed,
        settings.walkers,
        imported_sha256(__name__),
    ]
    if effects:
        parts.append(list(effects))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _channel_of(column: str) -> str:
    return column.partition("_")[0]


def suspects(chain: sampling.Chain, likelihood: Likelihood, recording: Recording) -> list[SuspectRow]:
    """Readings that are more probably bad than good, over draws of the chain."""
    bad, rows = likelihood.bad_probability(posterior.thinned(chain.flat())), likelihood.measured.steady
    columns = [priors.column_of(recording, channel) for channel in CHANNELS]
    return [
        SuspectRow(rows.file[r], int(rows.row[r]), str(columns[c]), float(bad[r, c]))
        for r, c in zip(*np.nonzero(bad > posterior.SUSPECT), strict=True)
    ]


def why_not(chain: sampling.Chain, unknowns: Sequence[priors.Unknown], settings: Settings, folder: Path | None) -> str:
    """What is missing, the unknown that limits it, and what to do about it, in a sentence."""
    steps, slowest = chain.samples.shape[1], unknowns[int(np.argmax(chain.tau))].name
    wanted = f"{settings.times_tau:g} x {chain.tau.max():.1f}"
    kept = f"; what is drawn is kept in {folder} and is continued" if folder else ""
    return (
        f"the sampler has not converged in {settings.most_steps} steps: {slowest} limits it; {steps} steps kept "
        f"against {wanted} (its autocorrelation time) wanted, R-hat {chain.rhat.max():.4f} (at most {sampling.RHAT}), "
        f"{chain.effective.min():.0f} effective samples (at least {settings.effective_samples}); give a larger "
        f"--max-steps{kept}"
    )
