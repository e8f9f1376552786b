"""Drawing the line and the instruments of a case, and what a recording says of them. The ideal step is a rare case."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration.challenge.second_rig.readout import MEANS, PLAIN, TOOTH, WINDOW

IDEAL_SHARE = 0.05
SHUT_SHARE = 0.1  # of lines that are shut and not vented: they empty through the motor alone
MOST_SHUT_L = 1.0  # of such a line: a larger one drives the motor on for longer than a run
# Even in the logarithm between the two.
LINES = {
    "regulator_time_s": (0.01, 1.0),
    "droop_bar_min_l": (1e-4, 2e-3),
    "valve_time_s": (0.005, 0.1),
    "valve_area_mm2": (20.0, 100.0),
    "vent_area_mm2": (10.0, 100.0),
    "line_volume_l": (0.1, 5.0),
}
WINDOWS_S = (0.005, 0.5)
COUNTED_SHARE = 0.75  # of counters, of which the recording tells the teeth
TEETH, TEETH_SHARES = (1, 20, 60), (0.15, 0.4, 0.45)
KINDS, KIND_SHARES = (TOOTH, WINDOW, MEANS), (0.5, 0.3, 0.2)
PITCH_ERRORS = (0.001, 0.01)  # where they are told
SMALL_PITCH_ERRORS = (0.0002, 0.001)  # where not: no more than the noise that is declared
SLOWEST_TOOTH_S = 3.0  # for a turn: slower than that a counter shows 0
GAUGES_HZ = (1.0, 10.0, 100.0)
GAUGE_LAGS_S = (0.0005, 0.005)
HELD_SHARE = 0.2
LAG_SHARE, LAGS_S = 0.2, (0.002, 0.03)  # of tachometers that are no counters; always told
OFF_SHARE, OFF_S = 0.5, (-0.03, 0.06)  # of supply_open
TOLD_SHARE = 0.5  # of each key of [supply]
TOLD_WITH_SD_SHARE = 0.8
TOLD_SDS = (0.05, 0.3)  # relative
IDEAL_SDS = {"regulator_time_s": 0.005, "valve_time_s": 0.003, "line_volume_l": 0.02}  # of what is told of a step
BEYOND = 2.0


def draw_supply(rng: np.random.Generator) -> dict[str, float]:
    """A line, as `supply.line.supply_of` takes it; empty for an ideal step."""
    if rng.random() < IDEAL_SHARE:
        return {}
    found = {name: _log(rng, span) for name, span in LINES.items()}
    if rng.random() < SHUT_SHARE:
        found["vent_area_mm2"] = 0.0
        found["line_volume_l"] = min(found["line_volume_l"], MOST_SHUT_L)
    return found


def draw_instruments(supply: dict[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """Tachometer and gauge of the runs in time, and what the recording says of them and of the line."""
    kind = str(rng.choice(KINDS, p=KIND_SHARES))
    found = dict(PLAIN) | {"tachometer": kind, "told": [], "supply_told": _told(supply, rng)}
    if kind == TOOTH:
        found |= _counter(rng)
    if kind == WINDOW:
        window = round(_log(rng, WINDOWS_S), 3)
        apart = bool(rng.random() < 0.5)
        found |= {"window_s": window, "period_s": window if apart else max(PLAIN["period_s"], round(window / 5.0, 3))}
        if not apart or rng.random() < TOLD_SHARE:
            found["told"] = ["window_s"]
    if kind != TOOTH and rng.random() < LAG_SHARE:
        found |= {"lag_s": round(_log(rng, LAGS_S), 4), "told": [*found["told"], "lag_s"]}
    return found | {
        "gauge_hz": float(rng.choice(GAUGES_HZ)),
        "gauge_phase": float(rng.uniform(0.05, 1.0)),
        "gauge_held": bool(rng.random() < HELD_SHARE),
        "gauge_lag_s": _log(rng, GAUGE_LAGS_S),
        "supply_off_s": float(rng.uniform(*OFF_S)) if rng.random() < OFF_SHARE else 0.0,
    }


def _counter(rng: np.random.Generator) -> dict[str, Any]:
    """A tooth counter. Of one that is not told of, every reading is the mean since the one before: none is 0."""
    teeth = int(rng.choice(TEETH, p=TEETH_SHARES))
    told = ["pulses_per_rev"] if rng.random() < COUNTED_SHARE else []
    if told and teeth > 1 and rng.random() < TOLD_SHARE:
        told.append("pitch_error_sd")
    pitch = _log(rng, PITCH_ERRORS if "pitch_error_sd" in told else SMALL_PITCH_ERRORS)
    zero_after_s = SLOWEST_TOOTH_S / teeth if told else 0.0
    return {"teeth": teeth, "pitch_error_sd": pitch if teeth > 1 else 0.0, "zero_after_s": zero_after_s, "told": told}


def _told(supply: dict[str, float], rng: np.random.Generator) -> dict[str, list[float | None]]:
    """What the recording says of its line: some figures, off by what it says that they may be off."""
    found: dict[str, list[float | None]] = {}
    for name, sd in IDEAL_SDS.items():
        if rng.random() >= TOLD_SHARE:
            continue
        share, z = _log(rng, TOLD_SDS), float(np.clip(rng.standard_normal(), -BEYOND, BEYOND))
        with_sd = bool(rng.random() < TOLD_WITH_SD_SHARE)
        own = share * supply[name] if supply else sd
        value = supply[name] + own * z if supply else 0.0
        found[name] = [_figures(value), _figures(own) if with_sd else None]
    return found


def _figures(value: float) -> float:
    """Three significant figures."""
    return float(f"{value:.3g}")


def _log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(np.log(span[0]), np.log(span[1]))))
