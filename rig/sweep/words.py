"""What a run says to a person."""

from __future__ import annotations

from rig.plateaus.plateau import Mean, Plateau


def sentence(plateau: Plateau) -> str:
    """A plateau in one line."""
    parts = [f"{plateau.step.level_bar_abs:g} bar abs {plateau.step.direction}"]
    units = {"pressure": "bar", "flow": "L/min", "speed": "rpm"}
    parts += [_figure(plateau.means[role], unit) for role, unit in units.items() if role in plateau.means]
    if not plateau.settled:
        parts.append("not settled")
    return ", ".join(parts)


def _figure(mean: Mean, unit: str) -> str:
    if mean.mean is None:
        return f"no {unit}"
    sign = {-1: "<", 0: "", 1: ">"}[mean.shown_censored]
    error = f" +- {mean.se:.2g}" if mean.se else ""
    return f"{sign}{mean.mean:.5g}{error} {unit}"
