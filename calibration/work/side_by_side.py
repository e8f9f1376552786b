"""Searches of one recording, one after another or side by side in processes of their own: the result is the same."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, TypeVar

from calibration.work.processes import begin_worker
from calibration.work.threads import threads

Answer = TypeVar("Answer")


class SideBySide:
    """A context manager whose value calls a function with several sets of arguments.

    Its processes are started by `begin`, so that they have loaded what they need when there is work.

    `workers`: processes; with less than 2 everything is done in this one [-].
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[BaseProcess] = set()

    def __enter__(self) -> SideBySide:
        return self

    def begin(self, modules: Sequence[str]) -> None:
        """Start the processes."""
        if self._workers > 1 and self._pool is None:
            with contextlib.suppress(OSError):  # no more processes: then all is done in this one
                self._others = set(multiprocessing.active_children())
                context = multiprocessing.get_context("spawn")
                self._pool = ProcessPoolExecutor(self._workers, context, initializer=begin_worker)
                for _ in range(self._workers):
                    self._pool.submit(_load, tuple(modules))

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
        """What a function of a module answers to each set of arguments, in their order."""
        if self._pool is not None and len(arguments) > 1:
            try:
                asked = [self._pool.submit(function, *each) for each in arguments]
                return [one.result() for one in asked]
            except (BrokenProcessPool, OSError):
                self._give_up()
        return [self._here(function, each) for each in arguments]

    def in_turn(
        self,
        function: Callable[..., Answer],
        turns: int,
        ask: Callable[[int], tuple[Any, ...]],
        take: Callable[[int, Answer], None],
        at_once: int,
    ) -> None:
        """Call a function of a module turn after turn, so many side by side; what is asked may hang on earlier answers.

        An answer is taken when ``at_once`` turns have been asked and not taken: which answers a turn knows does not
        hang on the number of processes, nor on their speed.
        """
        asked: deque[Callable[[], Answer]] = deque()
        for turn in range(turns):
            if len(asked) == at_once:
                take(turn - at_once, asked.popleft()())
            arguments = ask(turn)
            asked.append(self._asked(function, arguments) if turns > 1 else partial(self._here, function, arguments))
        for turn in range(turns - len(asked), turns):
            take(turn, asked.popleft()())

    def _asked(self, function: Callable[..., Answer], arguments: tuple[Any, ...]) -> Callable[[], Answer]:
        """What gives the answer to one call that has begun in another process, or has been made in this one."""
        if self._pool is None:
            answer = self._here(function, arguments)
            return lambda: answer
        try:
            begun = self._pool.submit(function, *arguments)
        except (BrokenProcessPool, OSError):
            self._give_up()
            return self._asked(function, arguments)

        def answer_of() -> Answer:
            try:
                return begun.result()
            except (BrokenProcessPool, OSError):
                self._give_up()
                return self._here(function, arguments)

        return answer_of

    def _here(self, function: Callable[..., Answer], arguments: tuple[Any, ...]) -> Answer:
        """The answer, found in this process; where nothing runs beside it, it has all the cores."""
        with threads(self._workers if self._pool is not None else 1):
            return function(*arguments)

    def _give_up(self) -> None:
        """Do without processes: one was killed, for want of memory perhaps."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _load(modules: Sequence[str]) -> None:
    for name in modules:
        importlib.import_module(name)
