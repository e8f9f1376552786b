"""The effects that there are, found by looking: a module of `definitions` that has an `EFFECT` is one."""

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
    for module in sorted(pkgutil.iter_modules(room.__path__), key=lambda info: info.name):
        effect = getattr(importlib.import_module(f"{room.__name__}.{module.name}"), "EFFECT", None)
        if isinstance(effect, Effect):
            if effect.id != module.name:
                raise ValueError(
                    f"model/effects/definitions/{module.name}.py holds the effect '{effect.id}'; the names are the same"
                )
            found[effect.id] = effect
    return found
