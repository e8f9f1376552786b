"""What a case conceals, as plain data: JSON can hold it, and the rig is rebuilt from it to the bit."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.challenge.second_rig import concealed
from calibration.challenge.second_rig.bench import Rig
from calibration.challenge.second_rig.readout import PLAIN
from calibration.challenge.second_rig.supply.line import supply_of


@dataclass(frozen=True)
class Truth:
    """A case.

    `seed`: of everything random in the case; the campaign's seed cannot be told from it.
    `ids`: what would be right to name; ``unknown`` for what is in no library.
    `effects`: ``id``, ``form`` and ``values`` [SI] of each effect at work; an unlisted one has this rig's word as id.
    `sizes`: by id, the values in SI under the names that a diagnosis reports; only effects in their usual form.
    `place`: ``balance``, ``channel``, ``coordinate`` (a word or a list of right ones), ``where`` (a range in SI, or
        None); of two effects ``any_of``, such a place each.
    `f_overall`: the motor's [N m s].
    `nuisances`: figures of the motor off their defaults [SI].
    `errors`: of the instruments: offsets in the columns' units, scales less 1.
    `with_transients`: whether a spin-up and a coast-down stand beside the sweep.
    `near_nuisance`: whether an effect with the form of a nuisance has, alone or with it, at most 4 declared standard
        deviations.
    `total_sds`: by id, effect and nuisance together in declared standard deviations [-].
    `supply`: the line between regulator and motor, as `line.Supply.of` takes it; empty for an ideal step in pressure.
    `instruments`: tachometer and gauge of the runs in time, and what the recording says of them, as in `readout.PLAIN`;
        what is not there is as it says.
    """

    family: str
    index: int
    seed: str
    category: str
    ids: list[str]
    effects: list[dict[str, Any]]
    sizes: dict[str, dict[str, float]]
    place: dict[str, Any]
    f_overall: float
    nuisances: dict[str, float]
    errors: dict[str, float]
    sensors: dict[str, float]
    with_transients: bool
    misdeclared: bool
    near_nuisance: bool
    total_sds: dict[str, float]
    supply: dict[str, float] = field(default_factory=dict)
    instruments: dict[str, Any] = field(default_factory=dict)

    def rig(self, added_inertia: float = 0.0) -> Rig:
        """The motor and its instruments as this case has them. `added_inertia`: of a flywheel [kg m2]."""
        effects = concealed.from_json(self.effects)
        return Rig(self.nuisances, self.errors, effects, added_inertia, supply_of(self.supply))

    @property
    def is_behind_wires(self) -> bool:
        """Whether a bench's own instruments read it, and not those of a written recording."""
        return not self.sensors

    def told(self) -> dict[str, Any]:
        """Tachometer and gauge, and what the recording says of them and of the line."""
        return PLAIN | self.instruments

    def rng(self, purpose: str) -> np.random.Generator:
        """Random numbers of the case for one purpose, the same each time."""
        return generator(self.seed, purpose)


def generator(seed: str | int | bytes, *purpose: object) -> np.random.Generator:
    """Random numbers from a seed and a purpose, through a hash: neighbouring seeds have nothing in common."""
    return np.random.default_rng(int(digest(seed, *purpose), 16))


def digest(seed: str | int | bytes, *purpose: object) -> str:
    """Hexadecimal SHA-256 of a seed and a purpose."""
    start = seed if isinstance(seed, bytes) else f"{type(seed).__name__}:{seed}".encode()
    return hashlib.sha256(b"|".join([start, *(str(word).encode() for word in purpose)])).hexdigest()
