"""The article's sweep, Table 3, as a recording that comes with the program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from model.article.reproduction import Measured

NAME = "published_sweep"
IN_PACKAGE = Path(__file__).resolve().parent / NAME  # of an installed program
IN_CHECKOUT = Path(__file__).resolve().parents[1] / "logs" / NAME


def published_sweep() -> Path:
    """The folder of the article's sweep, which comes with the program."""
    return IN_PACKAGE if IN_PACKAGE.is_dir() else IN_CHECKOUT


def measured() -> Measured:
    """Its readings in the model's units."""
    from model.article.reproduction import Measured
    from model.operation.performance import BAR
    from rig.recording import read_recording

    columns = read_recording(published_sweep()).files[0].columns
    return Measured(columns["pressure_bar_abs"].values * BAR, columns["speed_rpm"].values, columns["flow_l_min"].values)
