"""The model alone: operating points and runs in time as tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from model.motor import Motor

Values = Mapping[str, float | str | bool]
SHORTEST_S, DURATION_S, LONGEST_S = 0.001, 0.6, 60.0  # of a run in time; for the command line too


def motor_of(motor: str | Path | Motor, assignments: Iterable[str] = ()) -> Motor:
    """A motor by its name in configs/motors or by its file, with what ``NAME=VALUE`` changes.

    Raises
    ------
    ConfigError
        When there is no such motor, or a value is none of its own.
    TypeError
        For what is no motor.
    """
    from model.motor import Motor, read_motor, set_values

    if isinstance(motor, str | Path):
        text = str(motor)
        is_file = isinstance(motor, Path) or text.endswith(".toml") or "/" in text or "\\" in text
        motor = read_motor(Path(text) if is_file else text)
    if not isinstance(motor, Motor):
        raise TypeError(f"motor: expected a name, a file or a Motor; given {motor!r:.60}")
    return set_values(motor, list(assignments))


def assignments_of(values: Values | None) -> list[str]:
    """Changed values of a motor as the command line takes them, ``NAME=VALUE``; TypeError for what is no mapping."""
    import numpy as np

    if not isinstance(values, Mapping | None):
        raise TypeError(f'values: expected a mapping, such as {{"f_overall": 0.0633}}; given {values!r:.60}')
    words = {
        name: str(one).lower() if isinstance(one, bool | np.bool_) else one for name, one in (values or {}).items()
    }
    return set_once([f"{name}={one}" for name, one in words.items()])


def set_once(assignments: list[str]) -> list[str]:
    """``NAME=VALUE`` changes as given; ConfigError where one parameter is changed twice, by any of its names."""
    from configs import ConfigError
    from model.motor import QUANTITIES, name_with_unit

    names = {name_with_unit(name): name for name in QUANTITIES}
    first: dict[str, str] = {}
    for one in assignments:
        name = one.partition("=")[0].strip()
        before = first.setdefault(names.get(name, name), one)
        if before is not one:
            raise ConfigError(f"--set {one[:60]}: {before[:60]} is given too; set one parameter once")
    return assignments


def simulate(
    pressure_bar_abs: float | Sequence[float] | np.ndarray | pd.Series,
    motor: str | Path | Motor = "ptm3600",
    *,
    values: Values | None = None,
    transient: Literal["spin-up", "coast-down"] | None = None,
    duration_s: float | None = None,
) -> pd.DataFrame:
    """What a motor does without load: a row for each pressure, or for each moment of a run in time.

    Parameters
    ----------
    pressure_bar_abs : float or array of float
        Absolute inlet pressure [bar]; one for a run in time.
    motor : str, Path or Motor
        A name in configs/motors, a file, or one that was read.
    values : mapping, optional
        Parameters and readings that are changed, such as ``{"f_overall": 0.0633}``.
    duration_s : float, optional
        Length of a run in time, 0.001 to 60 [s]; 0.6 if left out.

    Returns
    -------
    DataFrame
        Columns with units, as `OperatingPoint` has them; of a run in time ``time_s``,
        ``speed_rpm`` and ``angle_rad``.

    Raises
    ------
    ConfigError
        For a motor or a value that there is not.
    OperatingPointError
        For a pressure that the model does not reach, and a duration out of bounds or without a run in time.
    TypeError
        For what is no motor, or no mapping.
    """
    import numpy as np
    import pandas as pd

    from configs.units import BAR, RPM
    from model.operation.performance import OperatingPointError, operating_points
    from model.operation.runs import coast_down, spin_up
    from spinbench.api import frames
    from spinbench.api.opened import argument

    with argument("values", "--set"):
        chosen = motor_of(motor, assignments_of(values))
    pressures = [float(bar) * BAR for bar in np.ravel(pressure_bar_abs)]
    if not pressures:
        raise OperatingPointError("no pressure is given; name one or more, absolute, in bar")
    if transient is None and duration_s is not None:
        raise OperatingPointError("duration_s is that of a run in time: say transient, or leave it out")
    if transient is None:
        points = operating_points(chosen, pressures)
        return frames.with_units(pd.DataFrame([vars(one) for one in points]), motor=chosen.name)
    if transient not in ("spin-up", "coast-down"):
        raise OperatingPointError(f"transient '{transient}': expected 'spin-up' or 'coast-down'")
    if len(pressures) != 1:
        raise OperatingPointError("a run in time has one pressure")
    length_s = DURATION_S if duration_s is None else duration_s
    if not SHORTEST_S <= length_s <= LONGEST_S:
        raise OperatingPointError(f"duration_s: expected {SHORTEST_S:g} to {LONGEST_S:g} s; given {length_s:g}")
    run = (spin_up if transient == "spin-up" else coast_down)(chosen, pressures[0], length_s)
    columns = {"time_s": run.time_s, "speed_rpm": run.speed_rad_s * RPM, "angle_rad": run.angle_rad}
    return frames.with_units(pd.DataFrame(columns), motor=chosen.name, transient=transient)
