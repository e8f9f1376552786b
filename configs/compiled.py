"""Functions that numba compiles, kept on disk and made anew when a file changes that they are made of.

numba itself looks at the file that holds a function, not at those whose functions and constants went into it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config, njit
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from configs.sources import is_ours, made_of_sha256

__all__ = ["njit"]

NUMBA_S = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"


class _MadeOf:
    """Of a function of ours: where it is kept, and the state of the sources that it is made of."""

    _py_file: str

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any:
        """None where the function is not ours, or nothing can be kept there."""
        return super().from_function(py_func, py_file) if is_ours(py_file) else None  # type: ignore[misc]

    def get_source_stamp(self) -> str:
        """A hash of the function's file, and of ours that it imports, directly or not."""
        return made_of_sha256(self._py_file)


class Provided(_MadeOf, UserProvidedCacheLocator):  # type: ignore[misc]
    """Kept in the folder of ``NUMBA_CACHE_DIR``."""


class Beside(_MadeOf, InTreeCacheLocator):  # type: ignore[misc]
    """Kept beside the source."""


class OfUser(_MadeOf, UserWideCacheLocator):  # type: ignore[misc]
    """Kept in the user's folder of caches, where the source's is read only."""


_ours = ",".join(f"{__name__}.{one.__name__}" for one in (Provided, Beside, OfUser))
_others = config.CACHE_LOCATOR_CLASSES or NUMBA_S  # type: ignore[attr-defined]
config.CACHE_LOCATOR_CLASSES = f"{_ours},{_others}"  # type: ignore[attr-defined]
