"""Whether the evidence that a diagnosis weighs by, Laplace's, is right: against nested sampling of the same posterior.

A case is a sweep drawn by `nulls_draw`, with nothing concealed or with one effect. It is searched as a
diagnosis does it; then the Bayes factor of one effect against the base model is taken three ways: as the diagnosis has
it, by nested sampling, and by importance sampling. The effect is the one concealed; where nothing is, the one that the
diagnosis finds most probable. Runs in time are left aside: a call of the model takes fifteen times as long there.

    python -m calibration.studies.evidence -o out/evidence     # resumable: a case that is there is not made again
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.studies import evidence_page
from calibration.studies.campaigns import Study, main, whole_number
from calibration.studies.nulls_draw import NOISES, null_recording, template
from calibration.work import many_table
from calibration.work.many import Item, Result
from calibration.work.sources import DIAGNOSIS
from model.effects.effect import Effect

SIZES = (0.1, 0.3, 1.0)  # of what is concealed, in ordinary sizes of the effect
REPEAT_EVERY = 5  # cases whose nested sampling is repeated with another seed: one in so many of those that have it
DRAWS = 1000  # of importance sampling
CASES = 50  # every other one with an effect concealed
COLUMNS = {
    "name": many_table.TEXT,
    "seed": many_table.WHOLE,
    "noise": many_table.TEXT,
    "concealed": many_table.TEXT,
    "size": many_table.NUMBER,
    "effect": many_table.TEXT,
    **dict.fromkeys(evidence_page.NUMBERS, many_table.NUMBER),
    "seconds": many_table.NUMBER,
    "error": many_table.TEXT,
}


def check_case(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One case's evidences.

    `argument`: ``seed``, ``noise``, ``concealed`` (effects and their parameters [SI]; empty for a null), ``repeats`` of
        nested sampling.
    Returns ``effect``, and for ``base`` and ``with_effect`` what `evidences` gives; where the effect's amplitude is,
    and how slow the slowest level that was read.
    """
    from calibration.diagnosis.diagnose import FARTHER
    from calibration.diagnosis.steps.name import screen
    from calibration.diagnosis.steps.search import Search
    from calibration.likelihood.descent import find
    from calibration.likelihood.signatures import signatures
    from calibration.systems.radial_piston.base import base_of
    from calibration.systems.radial_piston.comparison import Comparison
    from calibration.systems.radial_piston.predict.problem import Problem

    seed = argument["seed"]
    recording, _ = null_recording(argument["noise"], False, np.random.default_rng(seed), argument["concealed"])
    comparison = Comparison(Problem(recording))
    base = base_of(comparison)
    found = signatures(comparison, base)
    if argument["concealed"]:
        (name,) = argument["concealed"]
        first = {effect: values for effect, _, values in screen(comparison, base, found, base.u, -math.inf)}
        mode = find(comparison, [name], base, None, first=first.get(name, {}))
    else:
        search = Search(comparison, base)
        search.singles(found, base.u, FARTHER)
        mode = max((one for key, one in search.modes.items() if key), key=lambda one: one.log_evidence)
    n, k = comparison.n, base.z.size
    read = comparison.known[n : 2 * n]
    return {
        "effect": mode.names[0],
        "amplitude": float(mode.z[k]),
        "amplitude_sd": float(math.sqrt(mode.covariance[k, k])),
        "slowest_rad_s": float(np.min(base.prediction.speed[read])),
        "not_read": int(np.sum(~read)),
        "base": evidences(comparison, base, seed, argument["repeats"]),
        "with_effect": evidences(comparison, mode, seed, argument["repeats"]),
    }


def evidences(comparison: Any, mode: Any, seed: int, repeats: int) -> dict[str, Any]:
    """The log evidence of a model by Laplace, by nested sampling and by importance sampling.

    `repeats`: of nested sampling, each with draws of its own [-].
    Returns ``laplace`` as the diagnosis has it, which holds the noise scales at their best; ``noise_log_volume``, what
    Laplace's approximation over them adds; ``nested`` and ``importance``, each with errors and calls. All but the first
    are of the same integral, up to a constant that all models of a recording share.
    """
    from calibration.studies.evidence_reference import adapted, importance, nested
    from calibration.studies.evidence_target import Target

    target = Target(comparison, mode)
    near = adapted(target, target.width, [seed, 0])
    weighed = importance(target, near.mean, near.covariance, [seed, 1], DRAWS)
    runs = [nested(target, near.mean, near.covariance, [seed, 2 + i]) for i in range(repeats)]
    return {
        "unknowns": target.size,
        "laplace": mode.log_evidence,
        "noise_log_volume": target.noise_log_volume,
        "importance": {"log_evidence": weighed.log_evidence, "error": weighed.error, "effective": weighed.effective},
        "nested": [{"log_evidence": r.log_evidence, "error": r.error, "calls": r.calls} for r in runs],
        "calls": target.calls,
        "half_log_det": 0.5 * float(np.linalg.slogdet(near.covariance)[1]),
    }


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every case of a campaign: an effect is concealed in every other one, effects, sizes and noises in turn.

    `given`: one case in ``nested_every`` is nested-sampled, the others importance-sampled alone; 0 for none [-].
    """
    from calibration.systems.radial_piston.predict.problem import Problem

    could = Problem(template(NOISES[0], False)).effects_that_could()
    items = []
    for i in range(given.cases):
        which = i // 2  # of those with an effect concealed, or of those without
        turn = which // len(could)
        concealed, size = {}, None
        if i % 2 == 0:
            effect, size = could[which % len(could)], SIZES[(which + turn) % len(SIZES)]
            concealed = {effect.id: _values(effect, size, which)}
        repeats = int(given.nested_every > 0 and i % given.nested_every == 0)
        if repeats and (i // given.nested_every) % REPEAT_EVERY == 0:
            repeats = 2
        argument = {
            "seed": given.first_seed + i,
            "noise": NOISES[(which + turn) % len(NOISES)],
            "concealed": concealed,
            "size": size,
            "repeats": repeats,
        }
        items.append(Item(f"case-{given.first_seed + i}", argument, f"{code}-{repeats}"))
    return items


def _values(effect: Effect, size: float, which: int) -> dict[str, float]:
    """Parameters of what is concealed: of so many ordinary sizes, of either sign in turn where both are possible."""
    amplitude = effect.amplitude
    sign = -1.0 if amplitude.low < 0.0 and which % 2 else 1.0
    values = {parameter.name: parameter.scale for parameter in effect.parameters}
    return values | {amplitude.name: amplitude.expected + sign * size * amplitude.scale}


def row_of(item: Item, result: Result) -> dict[str, Any]:
    """A case as a row of the table; a failed one has its error."""
    given = item.argument
    row = {
        "name": item.name,
        "seed": given["seed"],
        "noise": given["noise"],
        "concealed": next(iter(given["concealed"]), ""),
        "size": given["size"],
        "effect": (result.value or {}).get("effect", ""),
    }
    numbers = evidence_page.numbers(result.value) if result.value else dict.fromkeys(evidence_page.NUMBERS)
    return row | numbers | {"seconds": result.seconds, "error": result.error}


STUDY = Study(
    name="evidence",
    words=__doc__,
    roots=("calibration.studies.nulls_draw", DIAGNOSIS),
    task=check_case,
    items=items_of,
    first_seed=400_000,
    options={
        "--cases": {"type": whole_number, "default": CASES, "help": "half with an effect concealed (%(default)s)"},
        "--nested-every": {
            "type": whole_number,
            "default": 1,
            "help": "nested sampling of one case in so many; 0 for none",
        },
    },
    row=row_of,
    columns=COLUMNS,
    summary=evidence_page.summary,
    documents=evidence_page.documents,
    told=evidence_page.verdict,
    needs="dynesty",
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
