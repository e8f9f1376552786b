"""What a mismatch that no listed effect explains looks like: a torque as a sum of few terms, found from the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.mode import Mode
from calibration.diagnosis.signatures import force_column, project, torque_column

LARGEST_N_M = 0.3  # sd of a term's prior at the top speed
PRICE = 4.4  # nats that a term costs: one of some eighty
MOST_TERMS = 2
STARTS = 37  # speeds tried at which a drag may set in
EDGE = 0.01  # width of a step, of the top speed


@dataclass(frozen=True)
class Term:
    """A torque found from the data.

    Attributes
    ----------
    balance, expression, unit : str
        As in diagnosis/1.
    gain : float
        Log evidence over the base model, in the linear model [-].
    column : ndarray
        What it does to the readings [SI].
    """

    balance: str
    expression: str
    unit: str
    gain: float
    column: np.ndarray


def discover(comparison: Comparison, mode: Mode, u: np.ndarray) -> Term | None:
    """The few terms in speed that explain a torque mismatch best; None where none gains its price.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The base model.
    u : ndarray, shape (3,)
        Noise scales of the detection [-].
    """
    top = float(np.nanmax(mode.prediction.speed)) if comparison.n else 40.0
    torque = torque_column(comparison, mode)
    laws = _laws(top)
    columns = np.column_stack([force_column(comparison, mode, torque, law) for _, law in laws]) * LARGEST_N_M
    white = comparison.whitener(mode.prediction, u)
    good = (mode.bad < 0.5).astype(float)
    J = white(mode.D) * good[:, None]
    G = white(columns) * good[:, None]
    y = good * white(np.nan_to_num(comparison.read - comparison.raw(mode.prediction)) + mode.D @ mode.z)
    chosen: list[int] = []
    gained = 0.0
    while len(chosen) < MOST_TERMS:
        scores = [_gain(J, G[:, [*chosen, i]], y) if i not in chosen else -np.inf for i in range(len(laws))]
        best = int(np.argmax(scores))
        if scores[best] - PRICE * (len(chosen) + 1) <= gained - PRICE * len(chosen):
            break
        chosen.append(best)
        gained = scores[best]
    if not chosen:
        return None
    X = np.column_stack([J, G[:, chosen]])
    fit = np.linalg.solve(X.T @ X + np.eye(X.shape[1]), X.T @ y)[J.shape[1] :] * LARGEST_N_M
    parts = [laws[i][0].format(a=f"{fit[j] * _unit(laws[i][0], top):.4g}") for j, i in enumerate(chosen)]
    column = columns[:, chosen] @ (fit / LARGEST_N_M)
    return Term("torque", " + ".join(parts), "N m", gained - PRICE * len(chosen), column)


def _laws(top: float) -> list[tuple[str, Callable[[np.ndarray], np.ndarray]]]:
    """Candidate laws, of size 1 at the top speed, with the text that prints them."""

    def power(p: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda w: np.abs(w / top) ** p

    def ramp(start: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda w: np.maximum(0.0, w - start) / (top - start)

    def step(start: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda w: 0.5 * (1.0 + np.tanh((w - start) / (EDGE * top)))

    found: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [("{a}", np.ones_like)]
    found += [(f"{{a}}*abs(omega)**{p:g}", power(p)) for p in (0.5, 1.5, 2.0, 3.0)]
    for start in np.linspace(0.05, 0.95, STARTS) * top:
        found.append((f"{{a}}*max(0, omega - {start:.3g})", ramp(float(start))))
        found.append((f"{{a}}*(omega > {start:.3g})", step(float(start))))
    return found


def _unit(text: str, top: float) -> float:
    """From the size at the top speed to the coefficient that is printed."""
    if "**" in text:
        return float(top ** -float(text.rpartition("**")[2]))
    if "max(" in text:
        return 1.0 / (top - float(text.rpartition("- ")[2].rstrip(")")))
    return 1.0


def _gain(J: np.ndarray, G: np.ndarray, y: np.ndarray) -> float:
    r = project(J, y)
    P = G.T @ project(J, G) + np.eye(G.shape[1])
    b = G.T @ r
    return float(0.5 * b @ np.linalg.solve(P, b) - 0.5 * np.linalg.slogdet(P)[1])
