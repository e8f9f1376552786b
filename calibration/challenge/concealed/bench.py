"""A virtual bench that conceals something: the second rig, with what was drawn and sealed, behind the instruments.

    python -m calibration.challenge.concealed.bench BENCH --state DIR --seal SEAL --key FILE

It is the process of `rig.virtual` in all but the motor. It alone knows what is concealed: whoever sweeps it, exports
and diagnoses gets bytes of instruments. A seal that is there already is opened with its key, and the same rig stands
behind the bench again: a further test can be taken on it.
"""

from __future__ import annotations

import secrets
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.campaign import sealing
from calibration.challenge.campaign.layout import ChallengeError
from calibration.challenge.scoring.judging import SINGLE
from calibration.challenge.second_rig import concealed
from calibration.challenge.second_rig.bench import Rig
from calibration.challenge.second_rig.draws import draw
from calibration.challenge.second_rig.live import LivePlant
from calibration.challenge.second_rig.machine.slots import BAR, DEFAULTS
from calibration.challenge.second_rig.sizes import SWEEP_S
from calibration.challenge.second_rig.truth import Truth, generator
from configs.units import ZERO_C
from rig.bench.bench import Bench
from rig.virtual.__main__ import bench_of, options_of
from rig.virtual.plant.truth import LINE_TRUTH, LineTruth, read_truth
from rig.virtual.serve import motor_in_room, serve

FAMILY = "proof"
MOST_DRAWS = 1000
COUNTS = (7, 4)  # pistons and lobes of the second rig
ON_THE_WIRE = "bad_reading"  # single readings are of a sheet that a person fills in; a bench has its menu of faults
SETTLES_S, RAMPS_S = 4.0, 2.0  # of a plateau, besides its window and its dwell
# What is drawn of a line: even in the logarithm between the two.
LINES = {
    "regulator_lag_s": (0.05, 0.5),
    "line_volume_l": (0.1, 1.5),
    "valve_time_s": (0.005, 0.1),
    "regulator_droop_bar_min_l": (1e-4, 2e-3),
}


class ConcealError(ChallengeError):
    """Nothing can be concealed as asked; the message says what to do."""


def command(seal: Path, key: Path | None, seed: int | None, only: str) -> tuple[str, ...]:
    """Module and options of the process, for `rig.virtual.launch`.

    `key`: its key; `sealing.default_key` when left out.
    `seed`: of what is drawn; drawn itself when left out.
    `only`: an effect's id or a category that is to be drawn; anything when empty.
    """
    more = [*(("--conceal-seed", str(seed)) if seed is not None else ()), *(("--only", only) if only else ())]
    place = key or sealing.default_key()
    return ("calibration.challenge.concealed.bench", "--seal", str(seal), "--key", str(place), *more)


def contents_of(bench: Bench, seed: int | str, only: str = "") -> dict[str, Any]:
    """What is concealed on a bench: the same for the same bench, seed and wish.

    `only`: an effect's id or a category that is to be drawn; anything when empty.
    Returns ``format``, ``truth``, ``line`` and ``bench``: what a seal holds. Raises ConcealError when no draw is as
    wished.
    """
    in_time = bool(bench.file.sweep.captures)
    for index in range(MOST_DRAWS):
        truth = draw(FAMILY, index, f"concealed {seed}")
        kinds = {truth.category, *(effect["id"] for effect in truth.effects)}
        if only and (only not in kinds or (only in concealed.LISTED and truth.category != SINGLE)):
            continue
        if truth.near_nuisance or ON_THE_WIRE in truth.ids:
            continue
        if in_time or not set(truth.ids) & set(concealed.TRANSIENT_ONLY):
            return {
                "format": sealing.CONCEALED,
                "bench": bench.name,
                "truth": asdict(_here(truth, bench)),
                "line": _line(truth),
            }
    place = f"{bench.name}{'' if in_time else ', which takes no captures'}"
    raise ConcealError(
        f"--only {only}: no such thing can be concealed on {place}; name an effect of docs/effects.md, or a category "
        "such as none or pair"
    )


def plant_of(contents: Mapping[str, Any], bench: Bench) -> LivePlant:
    """The second rig as a seal describes it, behind a bench.

    `bench`: its ``[virtual.truth]`` may set the line's figures, and none of the motor's.
    Raises ConcealError when the seal is of another bench, or the bench file sets the motor's figures.
    """
    if contents.get("format") != sealing.CONCEALED:
        raise ConcealError(f"the seal is no {sealing.CONCEALED}: it is that of a campaign")
    told = bench.file.virtual.truth if bench.file.virtual else {}
    refused = [name for name in told if name not in LINE_TRUTH]
    motor, _ = read_truth(motor_in_room(bench), told, bench.name)
    if refused:
        raise ConcealError(f"{bench.name}: virtual.truth.{refused[0]}: a bench that conceals something draws its motor")
    line = LineTruth(**{**contents["line"], **told})
    truth = Truth(**contents["truth"])
    rig = Rig(truth.nuisances, {}, concealed.from_json(truth.effects), bench.file.added_inertia_kg_m2)
    room_k = motor.si("ambient_temperature")
    trial = LivePlant(rig, line, room_k)  # compiles the march before the clock starts
    trial.order(2.0)
    trial.advance(10_000_000)
    return LivePlant(rig, line, room_k)


def opened_or_drawn(bench: Bench, seal: Path, key: Path, seed: int | None, only: str) -> dict[str, Any]:
    """What is concealed: as sealed, or drawn now and sealed.

    `seed`: of what is drawn; drawn itself when left out.
    `only`: an effect's id or a category that is to be drawn; anything when empty.
    Raises ConcealError when a seal that is there holds something else than what is asked for, the key lies in the
    seal's folder, or the bench's motor has other counts than the second rig's.
    """
    rotor = motor_in_room(bench)
    if (rotor.n_pistons, rotor.n_lobes) != COUNTS:
        raise ConcealError(
            f"{bench.name}: its motor has {rotor.n_pistons} pistons on {rotor.n_lobes} lobes; only a motor with "
            f"{COUNTS[0]} on {COUNTS[1]} can conceal something"
        )
    if seal.resolve() in key.resolve().parents:
        raise ConcealError(f"{key}: the key lies in the seal's own folder; name a place elsewhere with --key")
    if sealing.is_sealed(seal):
        there, _ = sealing.open_seal(seal, key)
        asked = {"seed": seed, "only": only}
        if any(value not in (None, "", there.get(name)) for name, value in asked.items()):
            raise ConcealError(f"{seal}: it is sealed already, with something else; name another folder")
        return there
    drawn = contents_of(bench, secrets.token_hex(16) if seed is None else seed, only)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    sealing.seal(seal, drawn | {"seed": seed, "only": only, "sealed": now}, key)
    return drawn


def concealed_plant(seal: Path, key: Path | None, conceal_seed: int | None, only: str) -> Callable[[Bench], LivePlant]:
    """What makes the line and the motor of a bench that conceals something.

    `key`: its key; `sealing.default_key` when left out.
    `conceal_seed`: of what is drawn; drawn itself when left out.
    `only`: an effect's id or a category that is to be drawn; anything when empty.
    """
    return lambda bench: plant_of(opened_or_drawn(bench, seal, key or sealing.default_key(), conceal_seed, only), bench)


def _here(truth: Truth, bench: Bench) -> Truth:
    """A truth in this bench's room and time: its sweep is shorter, and its instruments have errors of their own."""
    share = length_s(bench) / SWEEP_S
    effects = [effect | {"values": _sooner(effect, share)} for effect in truth.effects]
    sizes = {effect["id"]: effect["values"] for effect in effects if effect["id"] in truth.sizes}
    room = bench.file.ambient
    nuisances = dict(truth.nuisances)
    if room.pressure_bar_abs is not None:
        nuisances["ambient_pa"] += room.pressure_bar_abs * BAR - DEFAULTS["ambient_pa"]
    if room.temperature_c is not None:
        nuisances["inlet_k"] += room.temperature_c + ZERO_C - DEFAULTS["inlet_k"]
    place = dict(truth.place)
    if place.get("coordinate") == "time" and place.get("where"):
        place["where"] = [edge * share for edge in place["where"]]
    return replace(
        truth, effects=effects, sizes=sizes, nuisances=nuisances, place=place, errors={}, sensors={},
        with_transients=bool(bench.file.sweep.captures), misdeclared=False, supply={}, instruments={},
    )  # fmt: skip


def _sooner(effect: Mapping[str, Any], share: float) -> dict[str, float]:
    values = dict(effect["values"])
    slow = ("time_s", "moment_s") if effect["id"] != "speed_lag" else ()
    return {name: value * share if name in slow else value for name, value in values.items()}


def length_s(bench: Bench) -> float:
    """About how long a bench's sweep takes, by its own clock [s]."""
    sweep = bench.file.sweep
    legs = 2 if "-" in sweep.order else 1
    plateau_s = sweep.window_s + sweep.dwell_s + SETTLES_S + RAMPS_S
    return 2.0 * sweep.zero_s + legs * sweep.repeats * len(sweep.levels_bar_abs) * plateau_s


def _line(truth: Truth) -> dict[str, float]:
    chance = generator(truth.seed, "line")
    return {
        name: float(np.exp(chance.uniform(np.log(low), np.log(high)))) for name, (low, high) in LINES.items()
    }  # fmt: skip


def main() -> int:
    """Serve, and return the exit code: 0, or 2 when it cannot be done."""
    parser = options_of("python -m calibration.challenge.concealed.bench", __doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--seal", type=Path, required=True, metavar="DIR", help="folder of the seal")
    parser.add_argument("--key", type=Path, metavar="FILE", help="its key; of the user when left out")
    parser.add_argument("--conceal-seed", type=int, help="of what is drawn; drawn itself when left out")
    parser.add_argument("--only", default="", metavar="ID", help="an effect or a category that is to be drawn")
    o = parser.parse_args()
    made = concealed_plant(o.seal, o.key, o.conceal_seed, o.only)
    try:
        serve(bench_of(o), o.state, o.rate, o.owner, o.seed, o.linger, made, seal=lambda: sealing.hash_of(o.seal))
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
