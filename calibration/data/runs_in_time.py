"""Readings of a run in time as they come: which zeros are bad, where a coast-down begins, which rows that leaves.

A run may hold rest, a spin-up and a driven stretch before its coast-down, and rest behind it. The
first row of a coast-down is where it starts: its speed is a mean since a row that still was driven, or an instantaneous
value where a log was cut, and is compared with nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc, stdtr

from model.layout import RPM
from rig.recording import Recording, RecordingFile

STANDS = 3.0  # sds of noise, or digits, up to which a speed read is that of a rotor at rest
AT_END = 3  # readings that tell whether a rotor stands at either end of a run
TURNS = 0.1  # share of a run's highest speed above which a rotor is well on its way, and cannot stand a row later
ALIKE = 0.5  # share of the faster neighbour's speed that the slower one has, on both sides of zeros that are bad
LEAST_WINDOW = 4  # rows on each side of a release that is looked for in the speeds
LEVEL = 0.3  # of the fall after a release: what falls more slowly than this before it is driven
NEAR_TOP = 0.9  # of the highest speed before it, which a rotor still has at its release
CHANCE = 1e-4  # that noise alone looks like a release
QUIETER = 2.0  # factor by which a gauge may be quieter than its declared noise, before readings that repeat are no news
MOST_SPANS = 6  # of rows that a sentence names

SLOWED = "before the coast-down begins"
STOOD = "after the rotor stood"
LONE = "a 0 among turning rows, which is a bad reading"
UNREAD = "no speed, or one off the scale"
START = "where the coast-down starts, compared with nothing"


def turns(recording: Recording, file: RecordingFile) -> bool:
    """Whether the rotor turns in a file: a reading is above noise and digit.

    In a run two in a row are, for one is a lurch. A motor that started from rest and stands again though its supply is
    open has been caught at a dead point, unless it has turned by a whole turn before.

    `file`: of any kind; without speeds nothing says that it stands.
    """
    column, figures = file.columns.get("speed_rpm"), recording.channels.get("speed_rpm")
    if column is None or figures is None:
        return True
    read = column.values[np.isfinite(column.values)]
    above = read > max(STANDS * figures.noise_sd * file.noise_scale, figures.resolution)
    if file.kind != "transient":
        return bool(np.any(above))
    if not np.any(above[1:] & above[:-1]):
        return False
    clock = file.columns.get("time_s")
    is_shut = file.is_open is not None and not file.is_open[-1]
    is_at_rest = not np.any(above[:AT_END]) and not np.any(above[-AT_END:])
    if clock is None or is_shut or not is_at_rest or not recording.is_of_radial_piston:
        return True
    at = clock.values[np.isfinite(column.values)]
    passed_s = np.diff(at, prepend=at[0])
    return bool(np.sum((read * passed_s)[above]) / RPM > 2.0 * np.pi)


def lone_zeros(speed: np.ndarray) -> np.ndarray:
    """Zeros among turning rows, shape (n,) of bool: bad readings, for no rotor stands between two rows and turns on.

    A stretch of zeros is bad where the rows before and behind it turn at more than a tenth of the run's highest speed,
    and at speeds not farther apart than two to one. A rotor that comes to rest has slowed down before; one that starts
    from rest has not turned before.

    `speed`, shape (n,): readings in any unit; nan where there is none.
    """
    bad = np.zeros(speed.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(speed))
    if not known.size:
        return bad
    read = speed[known]
    stands = read <= 0.0
    turning = np.flatnonzero(~stands)
    least = TURNS * float(read.max())
    for before, behind in itertools.pairwise(turning):
        slow, fast = sorted((float(read[before]), float(read[behind])))
        if behind - before > 1 and slow > least and slow > ALIKE * fast:
            bad[known[before + 1 : behind]] = True
    return bad


def repeated(values: np.ndarray, noise: float, resolution: float) -> np.ndarray:
    """Readings that only repeat the one before, shape (n,) of bool: an instrument is asked faster than it measures.

    None where noise and resolution alone make as many neighbours equal as there are.

    `values`, shape (n,): readings as written; nan where there is none.
    `resolution`: step in which they are shown, in the same unit; 0 where that is not stated, and then the least between
        two.
    """
    found = np.zeros(values.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(values))
    same = np.diff(values[known]) == 0.0
    apart = np.diff(np.unique(values[known]))
    step = resolution or (float(apart.min()) if apart.size else np.inf)
    # Two readings of one value are shown alike with the chance r / (2 sqrt(pi) sigma), where the step r is not coarse.
    chance = min(1.0, QUIETER * step / (2.0 * np.sqrt(np.pi) * noise)) if noise > 0.0 else 1.0
    if same.size and bdtrc(int(same.sum()) - 1, same.size, chance) < CHANCE:
        found[known[1:][same]] = True
    return found


def placeholders(values: np.ndarray) -> np.ndarray:
    """Values for readings that nobody has taken yet, shape (n,): no two neighbours are equal, but where they are 0.

    `values`, shape (n,): about what they are, in any unit.
    """
    return values * (1.0 + 1e-9 * np.arange(values.size))


def release(time: np.ndarray, speed: np.ndarray) -> int:
    """Index of the first row of which the whole interval is after the release; 0 where the rotor never was driven.

    Looked for is the sharpest bend from a speed that rises, or holds, to one that falls: lines through the rows on both
    sides differ by more than noise would make them, what was before falls at most a third as fast, and the speed is
    still near its highest. A coast-down without a drive before it falls most steeply at its beginning.

    `time`, shape (n,): increasing [s].
    `speed`, shape (n,): of a rotor that turns in every row, in any unit.
    """
    n = speed.size
    found: list[tuple[int, int]] = []  # window, row
    window = LEAST_WINDOW
    while 2 * window <= n and not found:
        slope, middle, square = _lines(time, speed, window)
        a, b = np.arange(0, n - 2 * window + 1), np.arange(window, n - window + 1)
        freedom = 2 * window - 4
        noise = np.sqrt((square[a] + square[b]) / freedom) + 1e-12 * np.abs(speed).max()
        spread = np.sqrt(_inertia(time, window)[a] ** -1.0 + _inertia(time, window)[b] ** -1.0)
        score = (slope[a] - slope[b]) / (noise * spread)
        top = np.maximum.accumulate(middle)[a]
        bends = (slope[b] < 0.0) & (slope[a] > LEVEL * slope[b]) & (speed[b - 1] > NEAR_TOP * top)
        bends &= stdtr(freedom, -score) * n < CHANCE
        if bends.any():
            found.append((window, int(b[np.argmax(np.where(bends, score, -np.inf))])))
        window *= 2
    if not found:
        return 0
    window, row = found[0]
    return _bend(time, speed, row, window)


def _inertia(time: np.ndarray, window: int) -> np.ndarray:
    """Sum of squares of the times about their mean in each window, shape (n - window + 1,) [s2]."""
    views = np.lib.stride_tricks.sliding_window_view(time, window)
    return np.sum((views - views.mean(axis=1, keepdims=True)) ** 2, axis=1)


def _lines(time: np.ndarray, speed: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slope, middle and sum of squared residuals of the line through each window, shape (n - window + 1,)."""
    t = np.lib.stride_tricks.sliding_window_view(time, window)
    w = np.lib.stride_tricks.sliding_window_view(speed, window)
    t = t - t.mean(axis=1, keepdims=True)
    middle = w.mean(axis=1)
    slope = np.sum(t * w, axis=1) / np.sum(t * t, axis=1)
    rest = w - middle[:, None] - slope[:, None] * t
    return slope, middle, np.sum(rest * rest, axis=1)


def _bend(time: np.ndarray, speed: np.ndarray, row: int, window: int) -> int:
    """The first row behind the bend of two lines that meet within a window of a row, as far as it can be placed."""
    near = slice(row - window, row + window)
    t, w = time[near], speed[near]
    best, at = np.inf, row
    for k in range(row - window // 2, row + window // 2 + 1):
        after = np.maximum(t - time[min(k, time.size - 1)], 0.0)
        columns = np.column_stack([np.ones(t.size), t - t[0], after])
        rest = w - columns @ np.linalg.lstsq(columns, w, rcond=None)[0]
        if float(rest @ rest) < best:
            best, at = float(rest @ rest), k
    # The bend may be anywhere within an interval of the row where it shows, whose mean is driven in part.
    return min(at + 1, speed.size - 1)


@dataclass(frozen=True)
class CoastDown:
    """Which rows of a file are its coast-down.

    `begin`, `end`: of its rows, in the file's: a start, which is not compared, and the first row behind.
    `compared`, shape (n,): rows of the file that are compared with a model.
    """

    begin: int
    end: int
    compared: np.ndarray
    left: dict[str, np.ndarray]


def coast_down(time: np.ndarray, speed: np.ndarray, is_open: np.ndarray | None = None) -> CoastDown:
    """The rows of a file from its release until the rotor stands.

    `time`, shape (n,): increasing [s].
    `speed`, shape (n,): readings in any unit; nan where there is none.
    `is_open`, shape (n,) of bool: whether the rotor is driven. The release is where that ends for the last time, and is
        looked for in the speeds where it never does.
    """
    n = speed.size
    lone, known = lone_zeros(speed), np.isfinite(speed)
    turning = np.flatnonzero(known & (speed > 0.0))
    closes = np.zeros(0, dtype=int)
    if is_open is not None:
        closes = np.flatnonzero(is_open[:-1] & ~is_open[1:]) + 1
    if closes.size:
        begin = int(closes[-1])
    else:
        begin = int(turning[release(time[turning], speed[turning])]) if turning.size else n
    while begin < n and not (known[begin] and speed[begin] > 0.0):
        begin += 1
    rows = np.arange(n)
    stands = np.flatnonzero(known & (speed <= 0.0) & ~lone & (rows > begin))
    end = int(stands[0]) if stands.size else n
    inside = (rows > begin) & (rows < end)
    compared = inside & known & ~lone
    left = {
        SLOWED: rows < begin,
        START: rows == begin,
        LONE: inside & lone,
        UNREAD: inside & ~known,
        STOOD: rows >= end,
    }
    return CoastDown(begin, end, compared, {why: mask for why, mask in left.items() if mask.any()})


def why_left(left: Mapping[str, np.ndarray]) -> str:
    """Why rows are not used, in words that name them; empty where there are none.

    `left`, shape (n,): rows by the reason.
    """
    return "; ".join(f"{rows_in_words(mask)}: {why}" for why, mask in left.items() if mask.any())


def rows_in_words(mask: np.ndarray) -> str:
    """Rows by their numbers, from 1, spans joined. `mask`, shape (n,): the rows."""
    rows = np.flatnonzero(mask) + 1
    spans = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    words = [f"{span[0]}" if span.size == 1 else f"{span[0]} to {span[-1]}" for span in spans]
    rest = int(sum(span.size for span in spans[MOST_SPANS:]))
    more = f" and {rest} more" if rest else ""
    return f"row{'s' * (rows.size > 1)} {', '.join(words[:MOST_SPANS])}{more}"
