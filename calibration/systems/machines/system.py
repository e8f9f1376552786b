"""What a kind of machine is to the diagnosis: a file of this folder with a class that obeys `System`."""

from __future__ import annotations

import functools
import importlib
import math
import pkgutil
from collections.abc import Callable, Mapping
from typing import Protocol, get_args

import numpy as np

from calibration.data.rows_used import FileUse
from calibration.systems.machines.readings import Flat, Readings
from calibration.systems.machines.table import MachineTable
from calibration.unknowns.priors import Unknown
from model.effects.laws import Chosen
from model.rigs.state import Sizes
from rig.recording import Recording, RecordingError
from rig.recording.schema import MotorTable, add_motor_table

FOLDS = 6
Simulate = Callable[[Mapping[str, float], Chosen], tuple[np.ndarray, np.ndarray]]  # readings and their sd [SI]
Coordinates = dict[str, np.ndarray]


class System(Protocol):
    """A recording of one kind of machine.

    `kind`: as ``kind`` of the motor table has it.
    `balances`: where a mismatch may be: channel of the readings, or all where it is empty; balance; coordinate.
    `weight`: the drive where that is constant, as of a falling weight [N m, N].
    `timed`: whether it is known when each reading was taken.
    `files`: rows used of each file that was looked at, of `table.rows_used`.
    """

    readings: list[Readings]
    flats: list[Flat]
    unknowns: list[Unknown]
    sizes: Sizes
    timed: bool
    files: list[FileUse]

    def __init__(self, table: MachineTable) -> None: ...

    @property
    def kind(self) -> str: ...

    @property
    def balances(self) -> tuple[tuple[str, str, str], ...]: ...

    @property
    def weight(self) -> float | None: ...

    def could_show(self) -> list[str]:
        """Those of its effects that this recording could show."""

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """What the instruments would read, an array for each of ``readings`` [SI].

        `values`: of flats and unknowns by their names [SI].
        `chosen`: effect id to the values of its parameters.
        """

    def coordinates(self) -> list[Coordinates]:
        """Of each of ``readings`` its speed (with its sign), the time on its own clock, pressure or others [SI]."""

    def answer(self, i: int, pieces: np.ndarray, balance: str, friction: float) -> np.ndarray:
        """What torques, forces or flows do to the readings ``i`` [SI], shape (n, k).

        `pieces`, shape (n, k): against the motion [SI].
        `friction`: viscous coefficient [N m s].
        """

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of all readings that are held out together, and what they are."""

    def tests(self, noise: Callable[[str], float]) -> dict[str, Simulate]:
        """Tests that the rig could make, by their words.

        `noise`: of a channel: sd of one reading as the best explanation has it [SI].
        """


@functools.cache
def systems() -> dict[str, type[System]]:
    """The kinds that there are, found by looking: a module of this folder that has a `SYSTEM` is one."""
    room = importlib.import_module("calibration.systems.machines")
    modules = (importlib.import_module(f"{room.__name__}.{one.name}") for one in pkgutil.iter_modules(room.__path__))
    found = [module.SYSTEM for module in modules if hasattr(module, "SYSTEM")]
    return {one.kind: one for one in found}


def add_system(system: type[System], table: type[MotorTable]) -> None:
    """Have a further kind of machine diagnosed, until this process ends; one that was added before is replaced.

    `table`: the keys of its ``[motor]`` in recording.toml.
    Raises RecordingError when the kind comes with the program, or the two are not of the same kind.
    """
    field, name = table.model_fields.get("kind"), getattr(system, "kind", None)
    known = systems().get(str(name))
    if name == "radial_piston" or (known and known.__module__.startswith(f"{__package__}.")):
        raise RecordingError(f"{system.__name__}: the kind '{name}' comes with the program; take another name")
    if field is None or get_args(field.annotation) != (name,):
        raise RecordingError(f'{table.__name__}: expected kind: Literal["{name}"], as {system.__name__} has it')
    add_motor_table(str(name), table)
    systems()[str(name)] = system


def has_system(recording: Recording) -> bool:
    """Whether the motor of a recording is written out in it, and of a kind that there is."""
    return not isinstance(recording.motor, str) and recording.motor.get("kind") in systems()


def segments(sizes: list[int], pieces: int) -> list[np.ndarray]:
    """Masks that cut each array of readings into so many pieces."""
    starts = np.concatenate([[0], np.cumsum(sizes)])
    found = []
    for start, size in zip(starts, sizes, strict=False):
        for part in np.array_split(np.arange(size), pieces):
            mask = np.zeros(starts[-1], dtype=bool)
            mask[start + part] = True
            found.append(mask)
    return [mask for mask in found if mask.any()]


def pieces_of(arrays: int) -> int:
    """Pieces that each of so many arrays is cut into, for some six in all."""
    return max(3, math.ceil(FOLDS / arrays))
