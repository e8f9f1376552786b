"""A concealed bench's seal opened: what was concealed, in plain words, and what a diagnosis of it is worth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from calibration.challenge.campaign.layout import ChallengeError
from calibration.challenge.campaign.sealing import CONCEALED, SealError, default_key, is_sealed, open_seal
from calibration.challenge.scoring import judging
from calibration.challenge.scoring.judging import (
    ALARM,
    ASTRAY,
    FAILED,
    LISTED,
    MISSED,
    NONE,
    PART,
    REFUSED,
    RIGHT,
    WRONG,
    Case,
)
from calibration.challenge.second_rig.concealed import USUAL
from calibration.report.diagnosis.page import JSON
from calibration.report.diagnosis.words import effect_in_words
from calibration.report.units import powers
from model.effects.library import effects
from rig.recording.mistakes import shown
from rig.recording.origin import parsed, run_bench_and_seal

FALSE_NAME, FALSE_ALARM = "false name", "false alarm"
SCORES = {
    RIGHT: "right",
    LISTED: "listed",
    PART: "part named",
    WRONG: "wrong name",
    ASTRAY: "listed without the truth",
    REFUSED: "not excluded",
    MISSED: "missed",
    ALARM: FALSE_ALARM,
    FAILED: "failed",
}
GIVE = "give a diagnosis of a run that was taken with this seal"
BEFORE = timedelta(hours=1)  # a run begins about when its bench is sealed
FIXED = {("leakage", "laminar"): {"exponent": 1.0}}  # what a form says without a figure
UNITS = {"nm": "N m", "rad_s": "rad/s", "pa": "Pa", "s": "s", "m3_s": "m3/s", "m2": "m2", "kg_s_pa2": "kg/(s Pa2)"}
UNITS |= {"nm_s2": "N m s2", "pa_s2_m6": "Pa s2/m6", "pa_s_m3": "Pa s/m3", "w_m2k": "W/(m2 K)", "m3": "m3"}


def reveal(seal: Path, key: Path | None = None) -> dict[str, Any]:
    """Open a seal.

    `key`: its key; the user's when left out.
    The JSON of concealed/1, with its ``truth_sha256``. Raises SealError when the key does not open it, or it is no
    concealed bench's.
    """
    if not is_sealed(seal):
        raise SealError(f"{seal}: there is no seal; give the folder that --conceal named")
    contents, digest = open_seal(seal, key or default_key())
    if contents.get("format") != CONCEALED:
        raise SealError(f"{seal}: the seal of a campaign; `spinbench challenge score` opens it")
    return contents | {"truth_sha256": digest}


def in_words(contents: Mapping[str, Any]) -> list[str]:
    """What was concealed, a sentence each; then the motor and its line."""
    truth, line = contents["truth"], contents["line"]
    concealed = [_effect(effect) for effect in truth["effects"]] or ["Nothing was concealed."]
    return [
        *concealed,
        f"The motor's f_overall was {truth['f_overall']:.4f} N m s.",
        f"Its line held {line['line_volume_l']:.2f} L; the regulator took {line['regulator_lag_s'] * 1e3:.0f} ms "
        f"and the valve {line['valve_time_s'] * 1e3:.0f} ms, where the bench file does not say otherwise.",
    ]


def score(contents: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """What a diagnosis is worth against what was concealed.

    Returns ``concealed`` and ``named`` (ids), ``verdict``, ``score`` (a word of `SCORES`, or a false name),
    ``p_value``, ``f_overall`` with ``true``, ``q05``, ``q95`` and whether that interval ``holds`` it, None where there
    is none.
    """
    truth = contents["truth"]
    case = Case("", dict(truth), dict(diagnosis))
    word = SCORES[case.outcome]
    if truth["category"] == NONE and case.verdict == "named":
        word = FALSE_NAME
    return {
        "concealed": list(truth["ids"]),
        "category": truth["category"],
        "verdict": case.verdict,
        "named": sorted(judging.said_set(diagnosis)) if case.verdict in ("named", "confounded") else [],
        "score": word,
        "p_value": diagnosis["mismatch"]["p_value"],
        "f_overall": _f_overall(truth["f_overall"], diagnosis),
    }


def score_in_words(scored: Mapping[str, Any]) -> list[str]:
    """The same in sentences."""
    said = " and ".join(scored["named"]) or "nothing"
    true = " and ".join(scored["concealed"]) or "nothing"
    sentences = {
        "right": f"The diagnosis is right: it said {scored['verdict']}, and {true} was concealed.",
        "listed": f"The diagnosis lists the truth ({true}) among the sets that it cannot tell apart.",
        "part named": f"The diagnosis names a part of it: {said} of {true}.",
        "wrong name": f"The diagnosis names the wrong thing: {said}, where {true} was concealed.",
        "listed without the truth": f"The diagnosis lists {said} and others; the truth ({true}) is not among them.",
        "not excluded": f"The diagnosis sees a mismatch and names nothing; {true} was concealed.",
        "missed": f"The diagnosis sees nothing, where {true} was concealed.",
        FALSE_NAME: f"The diagnosis names {said}, where nothing was concealed.",
        FALSE_ALARM: "The diagnosis sees a mismatch, where nothing was concealed.",
        "failed": "The diagnosis failed.",
    }
    words = [sentences[scored["score"]]]
    friction = scored["f_overall"]
    if friction is not None:
        verb = "holds" if friction["holds"] else "does not hold"
        interval = f"{friction['q05']:.4f} to {friction['q95']:.4f} N m s"
        words.append(f"Its 90 % interval of f_overall, {interval}, {verb} the true {friction['true']:.4f}.")
    return words


def refuse_of_another(contents: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> list[str]:
    """Refuse a diagnosis that cannot be of a run of this seal's bench, by what its recordings say of themselves.

    Returns what each is of, as far as that is said. Raises ChallengeError: of another bench or seal, or older than it.
    """
    told = []
    for one in diagnosis.get("recordings") or [{}]:
        origin, place = one.get("origin", {}), shown(str(one.get("folder", "the diagnosis")), 200)
        run, bench, seal = (shown(said, 200) for said in run_bench_and_seal(origin) or ("", "", ""))
        if run and bench != contents["bench"]:
            raise ChallengeError(
                f"{place} is run {run} of bench {bench}, and the seal is of bench {contents['bench']}; {GIVE}"
            )
        if seal and seal != contents["truth_sha256"]:
            raise ChallengeError(f"{place} is run {run}, which was taken with another seal; {GIVE}")
        taken, sealed = parsed(origin.get("date")), parsed(contents.get("sealed"))
        if taken and sealed and taken.date() < (sealed - BEFORE).date():
            raise ChallengeError(
                f"{place} was taken on {taken.date()}, before anything was sealed ({sealed.date()}); {GIVE}"
            )
        known = f"is run {run} of bench {bench}" if run else "does not say of which run it is"
        sure = ", taken with this seal" if seal else ": see for yourself that it was taken with this seal"
        told.append(f"{place} {known}{sure}")
    return told


def read_diagnosis(file: Path) -> dict[str, Any]:
    """A diagnosis/1 from its file, or the folder that it was written to. Raises ChallengeError when it is none."""
    file = file / JSON if file.is_dir() else file
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise ChallengeError(f"{file}: no JSON ({problem}); give what `spinbench diagnose --json FILE` wrote") from None
    if not isinstance(found, dict) or found.get("format") != "diagnosis/1":
        raise ChallengeError(f"{file}: no diagnosis/1; give what `spinbench diagnose --json FILE` wrote")
    return found


def _f_overall(true: float, diagnosis: Mapping[str, Any]) -> dict[str, Any] | None:
    found = diagnosis.get("f_overall_after")
    if not found:
        return None
    low, high = found["q05"], found["q95"]
    return {
        "true": true,
        "mean": found["mean"],
        "sd": found["sd"],
        "q05": low,
        "q95": high,
        "holds": low <= true <= high,
    }


def _effect(effect: Mapping[str, Any]) -> str:
    """An effect in a sentence: the library's own where its usual form is, else its name and its figures."""
    name, values = effect["id"], FIXED.get((effect["id"], effect["form"]), {}) | effect["values"]
    if USUAL.get(name) == effect["form"] and set(values) == {p.name for p in effects()[name].parameters}:
        told = effect_in_words(
            {"id": name, "parameters": {key: {"mean": value, "sd": 0.0} for key, value in values.items()}}, {}
        )
        return f"{name}: {told}"
    title = f"{name}, in the form '{effect['form'].replace('_', ' ')}'" if name in USUAL else name.replace("_", " ")
    outside = "" if name in USUAL else " (in no list: right is to name nothing)"
    figures = ", ".join(f"{_plain(key)} {value:.3g}{_unit(key)}" for key, value in values.items())
    return f"{title}{outside}: {figures}."


def _unit(name: str) -> str:
    ending = max((end for end in UNITS if name.endswith(f"_{end}")), key=len, default="")
    return f" {powers(UNITS[ending])}" if ending else ""


def _plain(name: str) -> str:
    ending = max((end for end in UNITS if name.endswith(f"_{end}")), key=len, default="")
    return name.removesuffix(f"_{ending}").replace("_", " ") if ending else name.replace("_", " ")
