"""Searches of one recording, one after another or side by side in processes of their own: the result is the same."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, TypeVar

from calibration.diagnosis.threads import threads
from calibration.processes import begin_worker

Answer = TypeVar("Answer")


class SideBySide:
    """A context manager whose value calls a function with several sets of arguments.

    Its processes are started by `begin`, so that they have loaded what they need when there is work.

    Parameters
    ----------
    workers : int
        Processes; with less than 2 everything is done in this one [-].
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[BaseProcess] = set()

    def __enter__(self) -> SideBySide:
        return self

    def begin(self) -> None:
        """Start the processes."""
        if self._workers > 1 and self._pool is None:
            with contextlib.suppress(OSError):  # no more processes: then all is done in this one
                self._others = set(multiprocessing.active_children())
                context = multiprocessing.get_context("spawn")
                self._pool = ProcessPoolExecutor(self._workers, context, initializer=begin_worker)
                for _ in range(self._workers):
                    self._pool.submit(_load)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is None:
            return
        ours = set(multiprocessing.active_children()) - self._others
        self._pool.shutdown(wait=False, cancel_futures=True)
        if kind is not None:  # such as Ctrl-C: nobody waits for what they are at
            for process in ours:
                with contextlib.suppress(ValueError):  # it has been closed already
                    process.kill()

    def __call__(self, function: Callable[..., Answer], arguments: Sequence[tuple[Any, ...]]) -> list[Answer]:
        """What a function of a module answers to each set of arguments, in their order.

        Parameters
        ----------
        function : callable
            Of a module: it is called in other processes.
        arguments : sequence of tuple
            Of each call.
        """
        if self._pool is not None and len(arguments) > 1:
            try:
                asked = [self._pool.submit(function, *each) for each in arguments]
                return [one.result() for one in asked]
            except (BrokenProcessPool, OSError):  # a worker was killed, for want of memory perhaps
                self._pool.shutdown(wait=False, cancel_futures=True)
                self._pool = None
        with threads(self._workers if self._pool is not None else 1):  # one alone has all the cores
            return [function(*each) for each in arguments]


def _load() -> None:
    """Load what a search needs."""
    import calibration.diagnosis.detect
    import calibration.diagnosis.name  # noqa: F401
