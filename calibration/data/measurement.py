"""A recording's steady and zero rows as arrays for the likelihood."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calibration.data.runs_in_time import STANDS
from calibration.unknowns.priors import column_of
from rig.recording import Recording, RecordingError, RecordingFile
from rig.recording.columns import pressure_in

OBSERVED, MISSING, BELOW, ABOVE = 0, 1, 2, 3
PRESSURE_LIMITS_BAR = (0.5, 8.0)  # absolute, of the air properties


@dataclass(frozen=True)
class Rows:
    """Readings of one kind, one entry a row; pressures in bar, flows in L/min, speeds in rpm.

    `file`, `row`, shape (n,): where each came from; row 1 is the first under the header.
    `pressure`, `flow`, `speed`, shape (n,): readings; for a censored one the limit of the instrument's scale.
    `pressure_state`, `flow_state`, `speed_state`, shape (n,): OBSERVED, MISSING, BELOW or ABOVE.
    `is_gauge`, shape (n,): the pressure is counted from the ambient's.
    `noise_scale`, shape (n,): the file's random noise, times the channel's.
    """

    file: tuple[str, ...]
    row: np.ndarray
    pressure: np.ndarray
    flow: np.ndarray
    speed: np.ndarray
    pressure_state: np.ndarray
    flow_state: np.ndarray
    speed_state: np.ndarray
    is_gauge: np.ndarray
    noise_scale: np.ndarray

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.row.size)

    @property
    def turning(self) -> np.ndarray:
        """Which have a speed above 0 on its instrument's scale, shape (n,)."""
        return (self.speed_state == OBSERVED) & (self.speed > 0.0)

    @property
    def compared(self) -> np.ndarray:
        """Which have a flow or a turning speed on its instrument's scale, shape (n,)."""
        return (self.flow_state == OBSERVED) | self.turning


@dataclass(frozen=True)
class Measurement:
    """The rows of a recording that a fit uses.

    `steady`, `zero`: plateaus, and readings with the line vented and the rotor at rest.
    `channels`: the channels that the likelihood sees, of pressure, flow and speed.
    """

    steady: Rows
    zero: Rows
    channels: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())


def gather(
    recording: Recording, channels: tuple[str, ...] = ("pressure", "flow", "speed"), needs_plateaus: bool = True
) -> Measurement:
    """Collect the rows that a fit uses.

    `channels`: channels to use; flow or speed may be left out.
    `needs_plateaus`: whether a recording without any is refused.
    Returns rows and notes. Raises RecordingError when no row can be used.
    """
    notes = list(recording.warnings)
    blocks: dict[str, list[Rows]] = {"steady": [], "zero": []}
    for file in recording.files:
        if file.kind == "transient":
            continue
        rows, *unused = _rows_of(file, channels)
        skipped, locked = ([row for row in these if row not in file.left_out] for these in unused)
        if locked:
            these = f"row{'s' * (len(locked) > 1)} {_listed(locked)}"
            notes.append(f"{file.file}: {these} not used by a fit (the rotor is locked); a diagnosis uses their flow")
        if skipped:
            notes.append(
                f"{file.file}: row{'s' * (len(skipped) > 1)} {_listed(skipped)} not used (the pressure is not sampled, "
                "or neither flow nor speed is)"
            )
        blocks[file.kind].append(rows)
    steady_rows, zero_rows = (_at_rest(recording, _joined(blocks[kind])) for kind in ("steady", "zero"))
    if needs_plateaus and not len(steady_rows):
        raise RecordingError(
            f"{recording.folder}: no steady row with a pressure and a speed or flow; the fit needs at least one plateau"
        )
    present = tuple(c for c in ("pressure", "flow", "speed") if c in channels and column_of(recording, c))
    return Measurement(steady_rows, zero_rows, present, tuple(notes))


def _at_rest(recording: Recording, rows: Rows) -> Rows:
    """The rows with a speed of 0 where the speed read is no more than noise: a rotor at rest."""
    declared = recording.channels.get("speed_rpm")
    if declared is None:
        return rows
    stands = (rows.speed_state == OBSERVED) & (rows.speed <= max(STANDS * declared.noise_sd, declared.resolution))
    return replace(rows, speed=np.where(stands, 0.0, rows.speed))


def _rows_of(file: RecordingFile, channels: tuple[str, ...]) -> tuple[Rows, list[int], list[int]]:
    """The rows of one file, the numbers of those that cannot be used, and of those with the rotor locked."""
    n = file.rows
    name, gauge = pressure_in(file.columns)
    pressure, pressure_state = _column(file, name, n)
    flow, flow_state = _column(file, "flow_l_min" if "flow" in channels else "", n)
    speed, speed_state = _column(file, "speed_rpm" if "speed" in channels else "", n)
    if file.kind == "zero":
        used = (pressure_state == OBSERVED) | (flow_state != MISSING) | (speed_state != MISSING)
    else:
        used = (pressure_state == OBSERVED) & ((flow_state != MISSING) | (speed_state != MISSING))
    # A motor held still shows nothing that a model of its turning could be compared with; what leaks, it shows.
    locked = file.columns["rotor_locked"].values > 0.5 if "rotor_locked" in file.columns else np.zeros(n, dtype=bool)
    index = np.flatnonzero(used & ~locked)
    rows = Rows(
        file=(file.file,) * index.size,
        row=index + 1,
        pressure=pressure[index],
        flow=flow[index],
        speed=speed[index],
        pressure_state=pressure_state[index],
        flow_state=flow_state[index],
        speed_state=speed_state[index],
        is_gauge=np.full(index.size, gauge),
        noise_scale=np.full(index.size, file.noise_scale),
    )
    return rows, (np.flatnonzero(~used & ~locked) + 1).tolist(), (np.flatnonzero(locked) + 1).tolist()


def _column(file: RecordingFile, name: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Readings (0 where there is none) and their states, both of shape (n,)."""
    if name not in file.columns:
        return np.zeros(n), np.full(n, MISSING)
    column = file.columns[name]
    state = np.select(
        [np.isnan(column.values), column.censor < 0, column.censor > 0], [MISSING, BELOW, ABOVE], OBSERVED
    )
    return np.nan_to_num(column.values, nan=0.0), state


def _joined(blocks: list[Rows]) -> Rows:
    """The rows of several files as one."""
    if not blocks:
        none = np.empty(0)
        state = np.empty(0, dtype=np.int64)
        return Rows((), state, none, none, none, state, state, state, np.empty(0, dtype=bool), none)
    arrays = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in (
            "row",
            "pressure",
            "flow",
            "speed",
            "pressure_state",
            "flow_state",
            "speed_state",
            "is_gauge",
            "noise_scale",
        )
    )
    return Rows(tuple(name for block in blocks for name in block.file), *arrays)


def _listed(numbers: list[int]) -> str:
    shown = ", ".join(str(number) for number in numbers[:8])
    return shown + (f" and {len(numbers) - 8} more" if len(numbers) > 8 else "")
