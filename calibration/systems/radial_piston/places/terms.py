"""Terms that a law found from the data may be made of: torques and flows, each of size 1 at the top of its coordinate.

Every coefficient carries the unit that makes its term a torque or a flow. Thresholds are tried at many places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import expit

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Along, Form
from calibration.systems.radial_piston.places.coordinates import coordinates, same_coordinates
from calibration.systems.radial_piston.places.forces import TorqueAnswer, torque_column

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

LARGEST_N_M = 0.3  # sd of a torque's prior, at the top of its coordinate
LARGEST_SHARE = 0.3  # sd of a flow's prior, of the middle flow
STARTS = 37  # thresholds tried along a coordinate
EDGES = (0.01, 0.1)  # widths of a step, of the top: sharp, and one that sets in over a span
POWERS = (0.5, 1.0, 1.5, 2.0, 3.0)
HARMONICS = (1, 2, 3)  # of a turn of the shaft
A_PERIOD = 6.0  # samples that a harmonic needs in a period, or it is not looked for

Law = Callable[[np.ndarray], np.ndarray]


def forms(comparison: Comparison, mode: Mode) -> list[Form]:
    """All terms that a law of this recording may be made of."""
    at = coordinates(comparison, mode)
    answer = TorqueAnswer(comparison, torque_column(comparison, mode))

    def torque(along: Along, laws: list[tuple[str, str, float, float, Law]]) -> list[Form]:
        if not laws:
            return []
        steady = np.column_stack([law(np.nan_to_num(along.plateaus)) for *_, law in laws])
        runs = [np.column_stack([law(values) for *_, law in laws]) for values in along.runs]
        columns = answer(steady * LARGEST_N_M, [one * LARGEST_N_M for one in runs])
        return _made("torque", laws, columns, LARGEST_N_M)

    def flow(along: Along, laws: list[tuple[str, str, float, float, Law]]) -> list[Form]:
        size = LARGEST_SHARE * float(np.nanmedian(np.abs(comparison.problem.blocks.plateaus.flow)))
        columns = np.zeros((comparison.read.size, len(laws)))
        columns[: comparison.n] = np.column_stack([law(np.nan_to_num(along.plateaus)) for *_, law in laws]) * size
        return _made("mass", laws, columns, size)

    speed = list(_laws("omega", 0.0, float(np.nanmax(at["speed"].everything))))
    constant = ("constant", "{a}", 1.0, 0.0, np.ones_like)
    found = torque(at["speed"], [constant, *(one for one in speed if one[0] != "{a}*abs(omega)")])  # f_overall's form
    found += torque(at["time"], _clock(at["time"]))
    if np.isfinite(comparison.problem.blocks.plateaus.flow).any():
        found += flow(at["speed"], [constant, *speed])
        if "speed" not in same_coordinates(comparison, mode, "pressure"):
            low, top = (float(end(at["pressure"].plateaus)) for end in (np.nanmin, np.nanmax))
            found += flow(at["pressure"], list(_laws("P", low, top)))
    return [*found, *harmonics(comparison, at["angle"], at["speed"], answer)]


def _made(balance: str, laws: list[tuple[str, str, float, float, Law]], columns: np.ndarray, size: float) -> list[Form]:
    kept = np.any(columns != 0.0, axis=0)
    return [
        Form(balance, kind, text, unit, start, columns[:, [i]], size)
        for i, (kind, text, unit, start, _) in enumerate(laws)
        if kept[i]
    ]


def _laws(x: str, low: float, top: float) -> Iterator[tuple[str, str, float, float, Law]]:
    """Kind, text, unit and threshold of each law along a coordinate that begins at a value."""
    shown = x if low == 0.0 else f"({x} - {low:.4g})"
    for p in POWERS:
        power = "" if p == 1.0 else f"**{p:g}"
        text = f"{{a}}*abs({shown.strip('()')}){power}"

        def raised(w: np.ndarray, p: float = p) -> np.ndarray:
            return np.abs((w - low) / (top - low)) ** p

        yield text, text, (top - low) ** -p, 0.0, raised
    for share in np.linspace(0.05, 0.95, STARTS):
        start = low + float(share) * (top - low)

        def ramp(w: np.ndarray, start: float = start) -> np.ndarray:
            return np.maximum(0.0, w - start) / (top - start)

        yield f"ramp in {x}", f"{{a}}*max(0, {x} - {start:.3g})", 1.0 / (top - start), float(share), ramp
        for edge in EDGES:
            scale = 0.5 * edge * (top - low)
            sharp = f"{{a}}*({x} > {start:.3g})"
            text = sharp if edge == EDGES[0] else f"{{a}}/(1 + exp(({start:.3g} - {x})/{scale:.2g}))"

            def step(w: np.ndarray, start: float = start, scale: float = scale) -> np.ndarray:
                return expit((w - start) / scale)

            yield f"step in {x}", text, 1.0, float(share), step


def _clock(time: Along) -> list[tuple[str, str, float, float, Law]]:
    """A drift and steps in the running time, between the plateaus and the runs."""
    known = np.unique(time.plateaus[np.isfinite(time.plateaus)])
    if known.size < 4:
        return []
    low, top = float(known[0]), float(time.everything.max())
    drift = ("drift", f"{{a}}*(t - {low:.4g})", 1.0 / (top - low), 0.0, lambda t: (t - low) / (top - low))
    found: list[tuple[str, str, float, float, Law]] = [drift]
    for start in np.linspace(low, top, STARTS // 2 + 2)[1:-1]:
        share = (float(start) - low) / (top - low)

        def step(t: np.ndarray, start: float = float(start)) -> np.ndarray:
            return (t > start).astype(float)

        found.append(("step in t", f"{{a}}*(t > {start:.4g})", 1.0, share, step))
    return found


def harmonics(comparison: Comparison, angle: Along, speed: Along, answer: TorqueAnswer) -> list[Form]:
    """Torques that go with the shaft's angle, as far as the samples resolve them.

    At what angle each run begins is not known, so each has a phase of its own.
    """
    runs = comparison.problem.blocks.runs
    found = []
    for k in HARMONICS:
        columns = []
        for i, run in enumerate(runs):
            step = float(np.median(np.diff(run.time)))
            if 2.0 * np.pi / (k * float(np.nanmax(speed.runs[i])) * step) < A_PERIOD:
                continue
            for wave in (np.cos, np.sin):
                forces = [np.zeros((values.size, 1)) for values in angle.runs]
                forces[i][:, 0] = LARGEST_N_M * wave(k * angle.runs[i])
                columns.append(answer(np.zeros((comparison.n, 1)), forces))
        if columns:
            times = f"{k}*" if k > 1 else ""
            text = f"{{a}}*cos({times}theta + phase)"
            found.append(Form("torque", text, text, 1.0, 0.0, np.hstack(columns), LARGEST_N_M))
    return found
