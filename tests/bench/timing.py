"""Wall time of things that are to be compared: in one process, in turn, so that a busy machine slows all of them."""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numba

LEAST_S = 0.02  # a measurement is repeated within itself until it takes this long


@dataclass(frozen=True)
class Timing:
    """Wall time of one call [s].

    Attributes
    ----------
    median, least, most : float
        Over the rounds.
    first : float
        Of the very first call, which compiles or loads what is compiled.
    """

    median: float
    least: float
    most: float
    first: float


def round_robin(tasks: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Timing]:
    """Time every task once a round, one after the other.

    Parameters
    ----------
    tasks : mapping of str to callable
        What to time, by name.
    rounds : int
        Number of rounds [-].
    """
    first, inner, taken = {}, {}, {name: list[float]() for name in tasks}
    for name, task in tasks.items():
        first[name] = once(task)
        inner[name] = max(1, round(LEAST_S / once(task)))
    for _ in range(rounds):
        for name, task in tasks.items():
            begun = time.perf_counter()
            for _ in range(inner[name]):
                task()
            taken[name].append((time.perf_counter() - begun) / inner[name])
    return {name: Timing(statistics.median(t), min(t), max(t), first[name]) for name, t in taken.items()}


def once(task: Callable[[], object]) -> float:
    """Wall time of one call [s].

    Parameters
    ----------
    task : callable
        What to time.
    """
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Compiled loops keep to one core inside: no time is lost on waking threads for a single point."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
