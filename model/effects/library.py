"""The effects that there are, found by looking: a module below `definitions` that has an `EFFECT` is one."""

from __future__ import annotations

import functools
import importlib
import pkgutil

from model.effects.effect import Effect


@functools.cache
def effects() -> dict[str, Effect]:
    """Every effect by its id, in alphabetical order.

    Raises ValueError when a module's effect has another id than the module's name.
    """
    room = importlib.import_module("model.effects.definitions")
    found = {}
    for name in (info.name for info in pkgutil.walk_packages(room.__path__, f"{room.__name__}.")):
        effect = getattr(importlib.import_module(name), "EFFECT", None)
        if isinstance(effect, Effect):
            if effect.id != name.rpartition(".")[2]:
                raise ValueError(f"{name.replace('.', '/')}.py holds the effect '{effect.id}'; the names are the same")
            found[effect.id] = effect
    return dict(sorted(found.items()))
