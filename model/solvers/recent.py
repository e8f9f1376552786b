"""The last few results of a costly function, by everything it was given: a search asks for the same again and again.

A derivative with an unknown that does not reach a solver leaves the solver's arguments the same to the bit.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np


class Recent:
    """Results of one function; threads may ask at once.

    `most`: results kept; the one not asked for longest goes first [-].
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, np.ndarray] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """A result, the caller's own copy.

        `key`: all that the result hangs on.
        `make`: makes it where it is not kept.
        """
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
                return found.copy()
        made = make()
        with self._lock:
            self._kept[key] = made
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return made.copy()
