"""What the instruments of a typical bench declare, for recordings that tests write."""

from __future__ import annotations

from collections.abc import Iterable

FIGURES = {
    "pressure_bar_abs": {"noise_sd": 0.0015, "bias_sd": 0.005, "scale_sd": 0.002, "resolution": 0.001},
    "pressure_bar_gauge": {"noise_sd": 0.0015, "bias_sd": 0.005, "scale_sd": 0.002, "resolution": 0.001},
    "flow_l_min": {"noise_sd": 0.5, "bias_sd": 0.5, "scale_sd": 0.02, "resolution": 0.5},
    "speed_rpm": {"noise_sd": 0.4, "bias_sd": 0.1, "scale_sd": 0.0005, "resolution": 0.1},
}
READ = ("pressure_bar_abs", "flow_l_min", "speed_rpm")


def figures(column: str, **changed: float) -> str:
    """The figures of an instrument as lines of TOML."""
    return "".join(f"{key} = {value}\n" for key, value in (FIGURES[column] | changed).items())


def channels(columns: Iterable[str] = READ, **noise_sd: float) -> str:
    """The tables of a recording's instruments. `noise_sd`: of a column, where it is another."""
    changed = {name: {"noise_sd": sd} for name, sd in noise_sd.items()}
    return "".join(f"[channels.{name}]\n{figures(name, **changed.get(name, {}))}" for name in columns)
