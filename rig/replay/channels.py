"""The channels of a run as series in SI, for what compares them with a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from configs.units import BAR, M3_S, RAD_S, STANDARD_BAR
from rig.readings import NS
from rig.runlog import Run, RunError
from rig.runlog.phases import Series, quantity_channels, room_said, series

LONG_S = 1e9
STEP_S = 0.05  # of what the model gives to be set beside it


@dataclass(frozen=True)
class Measured:
    """What a run measured, usable readings only.

    `pressure_time_s`, `pressure_pa`, shape (m,): absolute line pressure [s], [Pa].
    `speed_time_s`, `speed_rad_s`, shape (n,): speed [s], [rad/s].
    `flow_time_s`, `flow_m3_s`, shape (k,): flow at the inlet [s], [m3/s].
    """

    pressure_time_s: np.ndarray
    pressure_pa: np.ndarray
    speed_time_s: np.ndarray
    speed_rad_s: np.ndarray
    flow_time_s: np.ndarray
    flow_m3_s: np.ndarray


def channels_of(run: Run) -> Measured:
    """The channels of a run's roles.

    Raises RunError when it has no pressure or no speed, or too short a record of the pressure.
    """
    names = quantity_channels(run)
    pressure = next((name for name in ("pressure_bar_abs", "pressure_bar_gauge") if name in names), None)
    if pressure is None or "speed_rpm" not in names:
        raise RunError(f"{run.folder}: no pressure or no speed was read, so there is nothing to drive a model with")
    added = 0.0
    if pressure.endswith("_gauge"):
        added = room_said(run).pressure_bar_abs or STANDARD_BAR
    P = _all(run, names[pressure])
    if P.time_ns.size < 2 or (P.time_ns[-1] - P.time_ns[0]) / NS < 2.0 * STEP_S:
        raise RunError(
            f"{run.folder}: the pressure was read {P.time_ns.size} times within less than {2.0 * STEP_S:g} s; a model "
            "needs a record of it to be driven with"
        )
    n = _all(run, names["speed_rpm"])
    q = _all(run, names["flow_l_min"]) if "flow_l_min" in names else None
    nothing = np.empty(0)
    return Measured(
        P.time_ns / NS,
        (P.value + added) * BAR,
        n.time_ns / NS,
        n.value * RAD_S,
        nothing if q is None else q.time_ns / NS,
        nothing if q is None else q.value * M3_S,
    )


def _all(run: Run, channel: str) -> Series:
    return series(run, channel, -LONG_S, LONG_S)
