"""The effects that a fit's model holds beyond the article: which may be asked for, and their unknowns and priors."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.data.clock import needs_clock, times_of_rows
from calibration.data.measurement import Measurement
from calibration.systems.radial_piston.batch.states import Way, way_of
from calibration.unknowns.effects import sampled
from calibration.unknowns.priors import Unknown
from configs import close_to
from model.effects import effects
from model.effects.effect import Effect, EffectParameter
from model.effects.laws import Chosen
from model.motor import Motor
from rig.recording import Recording


class EffectsError(ValueError):
    """An effect that does not exist, or that this fit cannot hold."""


@dataclass(frozen=True)
class Effects:
    """The effects of a fit.

    `time`, shape (n_rows,): of each steady row on the recording's clock [s]; zeros where a row has none.
    """

    names: tuple[str, ...]
    time: np.ndarray
    way: Way

    def unknowns(self) -> list[Unknown]:
        """Their unknowns, named ``effect.parameter``, with the priors of `model.effects`."""
        return [sampled(name, parameter) for name, parameter in self._parameters()]

    def chosen(self, values: np.ndarray) -> list[Chosen]:
        """The set that each point stands for. `values`, shape (n, k): of their unknowns, in their order [own units]."""
        found: list[Chosen] = []
        for row in values:
            one: dict[str, dict[str, float]] = {name: {} for name in self.names}
            for (name, parameter), value in zip(self._parameters(), row, strict=True):
                one[name][parameter.name] = float(value)
            found.append(one)
        return found

    def inside(self, values: np.ndarray) -> np.ndarray:
        """Which points lie within the effects' bounds, shape (n,).

        `values`, shape (n, k): as in `chosen` [own units].
        """
        low = np.array([parameter.low for _, parameter in self._parameters()])
        high = np.array([parameter.high for _, parameter in self._parameters()])
        return np.all((values >= low) & (values <= high), axis=1)

    def _parameters(self) -> list[tuple[str, EffectParameter]]:
        return [(name, parameter) for name in self.names for parameter in effects()[name].parameters]


def in_fit(names: Sequence[str], motor: Motor, recording: Recording, measured: Measurement) -> Effects | None:
    """The effects that a fit was asked for; None where it was asked for none.

    Raises EffectsError for an id that there is not (one that is close is named), or an effect of which steady rows say
    nothing.
    """
    if not names:
        return None
    for name in names:
        _check(name, names, measured)
    files = {file.file: file for file in recording.files}
    rows = measured.steady
    places = [(files[name], int(number)) for name, number in zip(rows.file, rows.row, strict=True)]
    time, untimed = times_of_rows(places)
    if untimed:
        for name in names:
            if needs_clock(effects()[name]):
                raise EffectsError(
                    f"{name} changes with time, and {recording.folder}/{untimed}, has no time_s; give each row its time"
                )
    return Effects(tuple(names), time, way_of(names, motor, time))


def seen(names: Sequence[str], channels: Sequence[str]) -> list[str]:
    """Those of some effects that a fit to these channels can see."""
    return [name for name in names if "flow" in channels or not _in_flow_alone(effects()[name])]


def refuse_effects(names: Sequence[str], could: Container[str]) -> None:
    """Refuse effects that a fit to everything in its recordings cannot hold.

    `could`: effects that these recordings could show.
    Raises EffectsError for an id that there is not (one that is close is named), or an effect that they could not show.
    """
    for name in names:
        _check_name(name, names)
        if name not in could:
            raise EffectsError(f"{name} could not show in these recordings; leave it out")


def _check_name(name: str, names: Sequence[str]) -> None:
    known = effects()
    if name not in known:
        close = close_to(name, known)
        meant = f"the nearest is {close}. All" if close else "known"
        raise EffectsError(f"no effect is called {name[:60]!r}; {meant}: {', '.join(known)}")
    if list(names).count(name) > 1:
        raise EffectsError(f"{name} is named twice; name it once")
    if name == "bad_reading":
        raise EffectsError("bad_reading: every fit looks for bad readings; leave it out")


def _check(name: str, names: Sequence[str], measured: Measurement) -> None:
    _check_name(name, names)
    known = effects()
    if known[name].transient_only:
        raise EffectsError(f"{name} shows in runs in time only, and this fit uses steady rows; leave it out")
    if not seen([name], measured.channels):
        raise EffectsError(f"{name} acts on the flow alone, which this fit does not use; leave it out")


def _in_flow_alone(effect: Effect) -> bool:
    on_motor = effect.torque or effect.inlet_drop or effect.outlet_rise or effect.factors
    return not on_motor and not set(effect.reads) - {"flow"}
