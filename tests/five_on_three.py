"""A motor with other counts than the article's: five pistons on three lobes, short enough for the stroke."""

from __future__ import annotations

from pathlib import Path

from model.motor import MOTORS, Motor, read_motor


def text() -> str:
    """Its motor file."""
    published = (MOTORS / "ptm3600.toml").read_text(encoding="utf-8")
    counted = published.replace("n_pistons = 7", "n_pistons = 5").replace("n_lobes = 4", "n_lobes = 3")
    return counted.replace('name = "ptm3600"', 'name = "five_on_three"').replace("value = 35.07", "value = 25.0")


def five_on_three(folder: Path) -> Motor:
    """Write the file into a folder, and read it."""
    path = folder / "five_on_three.toml"
    path.write_text(text(), encoding="utf-8")
    return read_motor(path)
