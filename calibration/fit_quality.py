"""Whether the model explains the readings that it is fitted to: the diagnosis' test, on the fit's own rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

import numpy as np
from scipy.special import bdtrc

from calibration.data.refusals import refuse_another_kind, refuse_unusable
from calibration.diagnosis.diagnose import CERTAIN_P
from calibration.diagnosis.mismatch import Detected, detect_mismatch, fit_base, test_base
from calibration.diagnosis.steps.detect import MISMATCH_P, detect
from calibration.diagnosis.steps.locate import locate
from calibration.fit import fit as fits
from calibration.fit.posterior import FitQuality
from calibration.likelihood.bad_reading import BAD
from calibration.likelihood.descent import find
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import signatures
from calibration.report.diagnosis.words import place_in_words
from calibration.systems.radial_piston.batch.effects import refuse_effects
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.kinds import FLOW, SPEED
from calibration.systems.several.comparison import Several
from calibration.systems.several.sharing import SHARED, Sharing
from calibration.unknowns.priors import CHANNELS, at_ambient
from calibration.work.step_clock import Tell
from calibration.work.threads import threads
from configs.units import BAR, ZERO_C
from model.motor import Motor, read_motor, set_values
from rig.recording import Ambient, Column, Recording, RecordingFile
from rig.recording.columns import OF_CHANNEL

MOST_PLACES = 2  # that are told
MOST_BAD = 0.25  # share of a channel's readings that may be taken for bad: more are no exceptions
FEWEST_ROWS = 3  # fewer cannot contradict a model that has as many unknowns

NOISE = "What it leaves over is no more than noise."
FEW = "So few rows can hardly contradict any model."
UNTESTED = "No row has a flow or a speed on its instrument's scale: nothing could be tested."


def judge(
    recording: Recording,
    seed: int,
    assignments: Sequence[str] = (),
    channels: tuple[str, ...] = CHANNELS,
    effects: Sequence[str] = (),
    tell: Tell = lambda _: None,
) -> FitQuality:
    """Test the model of a fit; the arguments are those of `calibration.fit.fit.fit`.

    Bad readings are part of the model, as they are of the fit: a single one that stands out is no mismatch. Raises
    RecordingError when the recording holds nothing that can be fitted, or the model gives no reading of it at all;
    EffectsError for an effect that there is not, or that a fit cannot hold.
    """
    prepared, measured, _ = fits.prepare(recording, assignments, channels, effects)
    motor = prepared if assignments else None
    rows = as_fitted(recording, channels, motor)
    if not measured.steady.compared.any():
        return FitQuality(1.0, True, UNTESTED)
    found = detect_mismatch(rows, np.random.default_rng(seed), tell, motor=motor)
    if effects:
        tell("with its effects")
        found = _with_effects(found, effects, np.random.default_rng(seed))
    p, most_bad = min((_of_bad_readings(part, mode) for _, part, mode in _each(found)), default=(1.0, ""))
    p = min(found.detection.p_value, p)
    if p >= MISMATCH_P:
        few = len(measured.steady) < FEWEST_ROWS
        return FitQuality(p, True, FEW if few else NOISE)
    return FitQuality(p, False, _what_stands_out(found, most_bad))


def judge_whole(
    recordings: Sequence[Recording],
    seed: int,
    assignments: Sequence[str] = (),
    channels: tuple[str, ...] = CHANNELS,
    effects: Sequence[str] = (),
    tell: Tell = lambda _: None,
    workers: int = 1,
    sharing: Sharing = SHARED,
) -> tuple[list[Recording], Detected, FitQuality]:
    """The most probable point of a fit to everything in recordings of one motor, and whether its model explains them.

    `assignments`: ``NAME=VALUE`` changes of the motor, as on the command line.
    `channels`: those that the likelihood sees; pressure always.
    `workers`: threads that simulate side by side; the result is the same [-].
    `sharing`: of which effects each recording has its own sizes.
    Returns the recordings as they are used; the model with its effects at the most probable point, and the test of it;
    what that comes to. Raises RecordingError when one cannot be used, or the model gives no reading of it at all;
    EffectsError for an effect that there is not, or that none of them could show.
    """
    used = [_used(one, channels, assignments) for one in recordings]
    motor = set_values(read_motor(used[-1].motor), list(assignments)) if assignments else None
    comparison, base = fit_base(used[0] if len(used) == 1 else used, tell, workers, motor, sharing)
    refuse_effects(effects, {effect.id for effect in comparison.problem.effects_that_could()})
    tell("test")
    with threads(workers):
        found = test_base(comparison, base, np.random.default_rng(seed))
        if effects:
            tell("with its effects")
            found = _with_effects(found, effects, np.random.default_rng(seed))
    p, why, sure = found.detection.p_value, "", found.comparison.not_described(found.base)
    for name, part, mode in _each(found):
        bad_p, words = _of_bad_readings(part, mode)
        p, why = (bad_p, f"{name}{words}") if bad_p < p else (p, why)
    if sure:
        quality = FitQuality(min(p, CERTAIN_P), False, f"The model does not describe these readings at all: {sure}")
    elif p >= MISMATCH_P:
        quality = FitQuality(p, True, NOISE)
    else:
        quality = FitQuality(p, False, _what_stands_out(found, why))
    return used, found, quality


def _used(one: Recording, channels: Sequence[str], assignments: Sequence[str]) -> Recording:
    """A recording as a fit to everything uses it, in the ambient that a motor changed by hand has there."""
    refuse_another_kind(one)
    refuse_unusable(one)
    used = as_fitted(one, channels, in_time=True)
    if not assignments:
        return used
    there = set_values(at_ambient(read_motor(one.motor), one), list(assignments))
    return replace(used, ambient=_ambient_of(there, one.ambient))


def _each(found: Detected) -> Iterator[tuple[str, Comparison, Mode]]:
    """Each recording by name, as it is compared, with its share of the mode."""
    comparison = found.comparison
    if isinstance(comparison, Several):
        for k, (name, part) in enumerate(zip(comparison.names, comparison.parts, strict=True)):
            yield f"{name}: ", part, comparison.of_part(k, found.base)
    elif isinstance(comparison, Comparison):
        yield "", comparison, found.base


def as_fitted(
    recording: Recording, channels: Sequence[str], motor: Motor | None = None, in_time: bool = False
) -> Recording:
    """A recording with nothing in it but what a fit uses: no channel left out; of a fit to plateaus no held rotor.

    `motor`: changed by hand: the recording gets its ambient.
    `in_time`: whether runs in time and the held rotor stay.
    """
    if motor is not None:
        recording = replace(recording, ambient=_ambient_of(motor, recording.ambient))
    left_out = {OF_CHANNEL[channel].column for channel in ("flow", "speed") if channel not in channels}
    return replace(
        recording,
        channels={name: figures for name, figures in recording.channels.items() if name not in left_out},
        files=tuple(
            _rows_of(file, left_out, in_time) for file in recording.files if in_time or file.kind != "transient"
        ),
    )


def _rows_of(file: RecordingFile, left_out: set[str], with_held: bool) -> RecordingFile:
    columns = {name: column for name, column in file.columns.items() if name not in left_out}
    if not with_held and "rotor_locked" in columns and "flow_l_min" in columns:
        flow, locked = columns["flow_l_min"], columns["rotor_locked"].values > 0.5
        columns["flow_l_min"] = Column(np.where(locked, np.nan, flow.values), flow.censor)
    return replace(file, columns=columns)


def _ambient_of(motor: Motor, ambient: Ambient) -> Ambient:
    """The ambient that was noted, with the values that the motor has now."""
    now = {
        "pressure_bar_abs": motor["ambient_pressure"].value / BAR,
        "temperature_c": motor["inlet_temperature"].value - ZERO_C,
        "relative_humidity": motor["relative_humidity"].value,
    }
    return replace(ambient, **{name: value for name, value in now.items() if getattr(ambient, name) is not None})


def _with_effects(first: Detected, names: Sequence[str], rng: np.random.Generator) -> Detected:
    """The test of the model with effects, from that of the base model."""
    mode = find(first.comparison, tuple(sorted(names)), first.base, None)
    found, free = signatures(first.comparison, mode), first.comparison.places.forces(mode)
    return Detected(first.comparison, mode, found, free, detect(first.comparison, mode, found, free, rng))


def _of_bad_readings(comparison: Comparison, mode: Mode) -> tuple[float, str]:
    """How often as many readings of a channel are bad [-], and words of it; (1, "") where they are single ones."""
    for kind, channel in ((SPEED, "speed"), (FLOW, "flow")):
        mine = (comparison.kind == kind) & comparison.known
        n, bad = int(mine.sum()), int(np.count_nonzero(mode.bad[mine] > 0.5))
        p = 2.0 * float(bdtrc(bad - 1, n, BAD)) if bad > MOST_BAD * n else 1.0
        if p < MISMATCH_P:
            return p, f"{bad} of {n} readings of the {channel} would be bad ones."
    return 1.0, ""


def _what_stands_out(found: Detected, most_bad: str) -> str:
    detection, mode = found.detection, found.base
    places = locate(found.comparison, mode, detection, found.free)[:MOST_PLACES]
    words = [most_bad] if most_bad else []
    words += [place_in_words(asdict(place)) for place in places]
    if loud := found.comparison.noise.too_loud(np.maximum(detection.u, mode.u)):
        words.append(f"The {loud[0]}'s noise would be {loud[1]:.1f} times as large as declared.")
    if detection.pulled:
        words.append(f"The {detection.pulled.replace('_', ' ')} would be farther off than is believable.")
    if not words:
        words = ["The readings are farther from it than chance would put them, at no one place."]
    return " ".join(words)
