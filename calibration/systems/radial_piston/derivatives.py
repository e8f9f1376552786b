"""What nuisances of the motor do to the readings where that needs no simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibration.systems.radial_piston.predict import wheel
from calibration.systems.radial_piston.predict.in_time import follows_angle
from calibration.systems.radial_piston.predict.kinds import FLOW, RUN, STANDING
from calibration.systems.radial_piston.predict.nuisances import TURN
from calibration.unknowns.priors import Error, OfInstrument, OfRun
from rig.recording.columns import OF_CHANNEL

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison


def known_derivative(
    comparison: Comparison, i: int, z: np.ndarray, raw: np.ndarray, names: Sequence[str]
) -> np.ndarray | None:
    """What a nuisance does to the readings [SI], shape (m,); None where only a simulation tells.

    `z`, shape (n,): the point [-].
    `raw`, shape (m,): the prediction there [SI].
    `names`: the effects of the point.
    """
    problem = comparison.problem
    of = problem.nuisances[i].of
    if isinstance(of, OfInstrument) and of.channel != "pressure":
        return _of_an_instrument(comparison, i, of, raw, z)
    if not isinstance(of, OfRun):
        return None
    if of.what == TURN and not follows_angle(names):
        return np.zeros_like(raw)
    run = problem.run_of(i)
    if run is None or of.what not in wheel.WAVES:
        return None
    found = np.zeros_like(comparison.read)
    one = problem.blocks.runs[run]
    column = wheel.seen(one, of.what)[one.used]
    found[comparison.kind == RUN + run] = column * problem.nuisances[i].b
    return found


def _of_an_instrument(comparison: Comparison, i: int, of: OfInstrument, raw: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Of an offset or a scale of flow or speed."""
    problem = comparison.problem
    unknown = problem.nuisances[i]
    mine = np.isin(comparison.kind, (FLOW, STANDING)) if of.channel == "flow" else comparison.kind > FLOW
    if of.error is Error.OFFSET:
        return np.where(mine, unknown.b * OF_CHANNEL[of.channel].to_si, 0.0)
    scale = 1.0 + unknown.b * z[i]
    place = problem.place(f"{of.channel}_{Error.OFFSET}")
    offset = 0.0 if place is None else problem.nuisances[place].b * z[place] * OF_CHANNEL[of.channel].to_si
    return np.where(mine, (raw - offset) / scale * unknown.b, 0.0)
