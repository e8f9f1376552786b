"""A fit in words: figures as a person writes them, the verdict, what it hangs on, what to look at."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.data.measurement import OBSERVED
from calibration.fit.fit import Fit
from calibration.fit.posterior import Posterior
from calibration.fit.whole import WholeFit
from calibration.report.fit.numbers import TARGET, Suspect, strongest
from calibration.report.sets_in_words import listed
from calibration.report.units import RAISED
from calibration.unknowns.priors import Error, OfEffect, OfInstrument, Unknown, full_name
from model.effects import EffectParameter, effects
from rig.recording.columns import OF_CHANNEL

INSTRUMENTS = {"pressure": "the pressure gauge", "flow": "the flow meter", "speed": "the tachometer"}
ERRORS = {
    Error.OFFSET: "offset",
    Error.SCALE: "scale",
    Error.NOISE: "noise",
    Error.DRIFT: "drift of the offset",
}
FEW_ROWS = 3  # a row or two cannot tell friction from the gauge and the assumed parameters
LEAST_PLAIN, MOST_PLAIN = 1e-8, 1e6  # an uncertainty outside is written with a power of ten
LEAST_P = 1e-6  # a p-value below it is told as such: the tail that it comes from is not known better

AnyFit = Fit | WholeFit


def rounded(value: float, sd: float) -> str:
    """A value to the digit that the second figure of its uncertainty stands at, both in the same unit."""
    if math.isfinite(value) and (0.0 < sd < LEAST_PLAIN or MOST_PLAIN <= sd < math.inf):
        return _by_powers_of_ten(value, sd)
    return f"{value:z.{_decimals(sd)}f}".replace("-", "−")


def uncertainty(sd: float) -> str:
    """An uncertainty to two significant figures, in its own unit."""
    return rounded(sd, sd)


def figure(value: float) -> str:
    """A given figure as short as it can be without losing any of its first five digits, in its own unit."""
    return f"{value:.5g}".replace("-", "−") if abs(value) < 1e5 else f"{value:.0f}".replace("-", "−")


def with_unit(text: str, unit: str) -> str:
    """A figure with its unit, without one where the unit is 1, or the `-` of an effect's parameter."""
    return text if unit in ("1", "-") else f"{text} {unit}"


def percent(share: float) -> str:
    """A share to two digits: 12 %, 100 %, 0.13 %."""
    return f"{float(f'{100.0 * share:.2g}'):g} %"


def probability(value: float) -> str:
    """A probability that is never shown as certain [-]."""
    return "> 0.999" if value > 0.999 else f"{value:.3f}"


def called(unknown: Unknown) -> str:
    """An unknown as a person calls it, with its recording where it is one recording's own."""
    match unknown.of:
        case OfEffect(effect, parameter):
            said = f"{effects()[effect].title}, its {_plain(effect, parameter)}"
        case OfInstrument(channel, error):
            said = f"{INSTRUMENTS[channel]}'s {ERRORS[error]}"
        case _:
            said = f"the {unknown.own.replace('_', ' ')}"
    return f"{said} in {unknown.whose}" if unknown.whose else said


def _parameter(effect: str, name: str) -> EffectParameter:
    return next(one for one in effects()[effect].parameters if one.name == name)


def _plain(effect: str, name: str) -> str:
    """An effect's parameter in words: its name, or where a unit stands in that, the first words on what it is."""
    first = re.split(r", | \(", _parameter(effect, name).text)[0]
    return name if name.isalpha() else first or name.replace("_", " ")


def prior_in_words(unknown: Unknown) -> str:
    """An unknown's prior, in its unit; that of an effect's size which cannot be negative is folded at 0."""
    of = unknown.of
    is_folded = isinstance(of, OfEffect) and unknown.kind != "lognormal" and _parameter(*of).low == 0.0
    if is_folded and unknown.kind != "halfsize":
        return f"above {figure(unknown.a)}, by {figure(unknown.b)}"
    if unknown.kind in ("normal", "size"):
        return f"{figure(unknown.a)} ± {figure(unknown.b)}"
    if unknown.kind == "lognormal":
        return f"{figure(unknown.a)}, times or over {figure(unknown.b)}"
    if unknown.kind == "halfsize":
        return f"above {figure(unknown.a)}, by {figure(unknown.b)}"
    return f"{figure(unknown.a)} to {figure(unknown.b)}, even in the logarithm"


def held_effects(found: AnyFit) -> list[str]:
    """Each effect that the model holds beyond the article, with the sizes that the fit gives it, in a sentence each."""
    sentences = []
    for name in found.effects:
        sizes = []
        for one in found.posterior.estimates:
            if not isinstance(one.unknown.of, OfEffect) or one.unknown.of.effect != name:
                continue
            value = f"{rounded(one.mean, one.sd)} ± {uncertainty(one.sd)}"
            low, high = (rounded(one.quantiles[q], one.sd) for q in ("q05", "q95"))
            size = full_name(_plain(name, one.unknown.of.parameter), one.unknown.whose)
            words = f"{size} {with_unit(value, one.unknown.unit)} (90 %: {low} to {high})"
            sizes.append(f"{words}, which is its prior" if found.posterior.prior_dominates(one.unknown.name) else words)
        sentences.append(f"{effects()[name].title} ({name}): {'; '.join(sizes)}")
    return sentences


def verdict(posterior: Posterior) -> str:
    """f_overall in a sentence."""
    one = posterior[TARGET]
    low, high = (rounded(one.quantiles[name], one.sd) for name in ("q05", "q95"))
    value = f"{rounded(one.mean, one.sd)} ± {uncertainty(one.sd)}"
    return f"{TARGET} is {with_unit(value, one.unknown.unit)} (90 %: {low} to {high})."


def headline(found: AnyFit) -> list[str]:
    """What comes first: f_overall where the model explains the readings, and that it does not where it does not."""
    quality = found.quality
    if quality is None:
        return [verdict(found.posterior)]
    if quality.model_fits:
        return [f"{verdict(found.posterior)} {explained(found)}"]
    return [contradicted(found), quality.why, not_to_be_relied_on(found.posterior), f"Next: {next_command(found)}"]


def explained(found: AnyFit) -> str:
    """That the readings do not contradict the model, in sentences; empty where that was not asked."""
    quality = found.quality
    if quality is None:
        return ""
    p = p_in_words(quality.p_value)
    return f"The readings do not contradict the model{_with_effects(found)} ({p}). {quality.why}"


def contradicted(found: AnyFit) -> str:
    """That the model does not explain the readings, in a sentence; empty where it does or that was not asked."""
    quality = found.quality
    if quality is None or quality.model_fits:
        return ""
    p = p_in_words(quality.p_value)
    return f"The model{_with_effects(found)} does not explain the readings ({p}): do not rely on its {TARGET}."


def not_to_be_relied_on(posterior: Posterior) -> str:
    """f_overall by a model that is wrong, in a sentence."""
    return f"What it gives, not to be relied on: {verdict(posterior)}"


def next_command(found: AnyFit) -> str:
    """The command that looks for what the model lacks."""
    folders = dict.fromkeys(str(folder) for one in found.recordings for folder in one.folders)
    left_out = dict.fromkeys(asked for one in found.recordings for asked in one.without)
    if len(folders) == 1:  # of one recording a file's name has none ahead
        left_out = {asked.removeprefix(f"{Path(*folders).resolve().name}/"): None for asked in left_out}
    words = ["spinbench", "diagnose", *(f"--without={asked}" for asked in left_out)]
    return shlex.join([*words, *["--"] * any(one.startswith("-") for one in folders), *folders])


def p_in_words(p: float) -> str:
    """A p-value as text [-]."""
    return f"p = {p:.2g}" if p >= LEAST_P else "p < 10⁻⁶"


def _with_effects(found: AnyFit) -> str:
    return f" with {' and '.join(found.effects)}" if found.effects else ""


def hangs_on(pairs: Sequence[tuple[Unknown, float]]) -> str:
    """What f_overall is correlated with, strongest first, in a sentence; ``pairs`` of unknown and correlation."""
    strong = strongest(pairs)
    if not strong:
        return f"{TARGET} is correlated with no other unknown to speak of."
    words = [f"{called(unknown)} ({r:+.2f})".replace("-", "−") for unknown, r in strong]
    return f"{TARGET} is correlated most with {listed(words)}."


def prior_says(found: AnyFit) -> str:
    """Whether f_overall comes from the recording or from the prior, in a sentence."""
    spread = f"Its standard deviation is {percent(found.posterior[TARGET].sd_of_prior)} of its prior's."
    share = f"{100 * found.posterior.share_from_priors(TARGET):.0f} % of its variance comes from unknowns"
    which = (
        f"{_rows(found)}: the prior dominates {TARGET}." if prior_dominates(found) else f"The data determine {TARGET}."
    )
    return f"{which} {spread} {share} that the data hardly tell."


def against_priors(posterior: Posterior) -> list[str]:
    """Each unknown that contradicts its prior, in a sentence."""
    return [
        f"the readings contradict the prior of {called(one.unknown)}: "
        f"{with_unit(prior_in_words(one.unknown), one.unknown.unit)} was given, and the fit says "
        f"{with_unit(f'{rounded(one.mean, one.sd)} ± {uncertainty(one.sd)}', one.unknown.unit)}, "
        f"{abs(off):.1f} of the prior's sds from its middle"
        for one, off in posterior.against_priors()
    ]


def prior_dominates(found: AnyFit) -> bool:
    """Whether f_overall rests on priors: it is hardly narrowed, or fewer rows than a line and a check of it."""
    return found.posterior.prior_dominates(TARGET) or (not found.in_time and found.rows < FEW_ROWS)


def suspect_in_words(one: Suspect) -> str:
    """A suspect reading in a sentence."""
    unit = OF_CHANNEL[one.channel].unit
    sd = "" if not math.isfinite(one.sd) or one.sd <= 0.0 else f" ± {uncertainty(one.sd)}"
    expected = f"{rounded(one.expected, one.sd) if sd else figure(one.expected)}{sd}"
    return (
        f"{one.row.file}: row {one.row.row}: {one.row.channel} {figure(one.reading)} is probably a bad reading "
        f"(probability {probability(one.row.probability)}); the fit expects {expected} {unit} and gives "
        "the reading little weight"
    )


def remarks(found: Fit, suspects: Sequence[Suspect]) -> list[str]:
    """What a person should know beside the table, in sentences."""
    said = set(found.recording.warnings)
    sentences = [note for note in found.notes if note not in said]
    if suspects and contradicted(found):
        count = "1 reading looks" if len(suspects) == 1 else f"{len(suspects)} readings look"
        sentences.append(f"{count} bad by this model, which says little as long as it does not explain the rest")
    else:
        sentences += [suspect_in_words(one) for one in suspects]
    if prior_dominates(found):
        sentences.append(prior_says(found).rstrip("."))
    return sentences + against_priors(found.posterior) + _too_fast(found)


def _too_fast(found: Fit) -> list[str]:
    rows, limit = found.measured.steady, found.motor["speed_limit"].value
    fast = rows.speed[(rows.speed_state == OBSERVED) & (rows.speed > limit)]
    if not fast.size:
        return []
    count = "1 row is" if fast.size == 1 else f"{fast.size} rows are"
    return [f"{count} above the manufacturer's {limit:g} rpm (up to {np.max(fast):g} rpm)"]


def _rows(found: AnyFit) -> str:
    return "one row" if found.rows == 1 else f"{found.rows} rows"


def _by_powers_of_ten(value: float, sd: float) -> str:
    if value == 0.0:
        return "0"
    of_value, of_sd = (math.floor(math.log10(float(f"{abs(one):.1e}"))) for one in (value, sd))
    power = max(of_value, of_sd)
    figures = f"{value * 10.0**-power:z.{power - of_sd + 1}f}"
    return f"{figures}·10{str(power).translate(RAISED)}".replace("-", "−")


def _decimals(sd: float) -> int:
    """Decimals that show two significant figures of a spread, 4 where it has none."""
    if not math.isfinite(sd) or sd <= 0.0:
        return 4
    return min(max(1 - math.floor(math.log10(float(f"{sd:.1e}"))), 0), 9)
