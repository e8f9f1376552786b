"""Several simulations of one recording at once, in threads: the integrators leave Python's lock while they run."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from typing import TypeVar

Argument = TypeVar("Argument")
Answer = TypeVar("Answer")

_pool: ContextVar[ThreadPoolExecutor | None] = ContextVar("pool", default=None)


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Have `each` use threads; none of theirs uses further ones.

    `count`: threads; with less than 2 everything is done in this one [-].
    """
    if count < 2:
        yield
        return
    with ThreadPoolExecutor(count) as pool:
        before = _pool.set(pool)
        try:
            yield
        finally:
            _pool.reset(before)


def each(function: Callable[[Argument], Answer], arguments: Iterable[Argument]) -> list[Answer]:
    """What a function that changes nothing answers to each argument, in their order; the same to the bit in threads."""
    pool = _pool.get()
    return [function(one) for one in arguments] if pool is None else list(pool.map(function, arguments))
