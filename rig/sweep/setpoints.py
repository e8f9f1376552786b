"""From absolute pressures to a regulator's set-points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rig.bench.bench import Bench
from rig.plateaus.plan import SweepError
from rig.sweep.orders import VENTED


def set_points(bench: Bench, ambient_bar: float) -> Callable[[float], float]:
    """From an absolute pressure [bar] to the regulator's set-point, as a function.

    Raises SweepError when the regulator's unit is not known here.
    """
    device = bench.file.roles.regulator
    if device is None:
        return lambda bar_abs: bar_abs
    driver: Any = bench.build(device)
    zero = {"bar gauge": ambient_bar, "bar abs": 0.0}.get(driver.unit)
    if zero is None:
        raise SweepError(f"{device}: its set-point is in '{driver.unit}'; a sweep needs bar gauge or bar abs")
    none = max(driver.lowest, 0.0)

    def set_point(bar_abs: float) -> float:
        if bar_abs == VENTED:
            return float(none)
        return float(min(max(bar_abs - zero, none), driver.highest))

    return set_point
