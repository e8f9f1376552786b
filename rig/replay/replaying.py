"""A whole run played back, its samples beside those of the log, row by row and bit by bit."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rig.bench.bench import BENCH_SOURCE, Bench, bench_of, instrument_source
from rig.readings import NS, Exchange, Reading
from rig.replay.player import Player
from rig.runlog import Run, RunError, RunWriter
from rig.runlog.folder import SAMPLES
from rig.runlog.lines import whole_lines
from rig.runlog.reader import KILLED
from rig.runlog.rows import sample_line

SHOWN = 5


class Listener(Protocol):
    """Who is told how far a replay is, and hears each exchange."""

    def __call__(self, done: int, exchange: Exchange) -> None:
        """After an exchange."""


@dataclass(frozen=True)
class Replayed:
    """What a replay gave.

    `different`: rows that are not the same to the bit, those missing on either side included [-].
    `tail`: rows more than the log has, of a run that was killed between its two files [-].
    """

    exchanges: int
    samples: int
    logged: int
    different: int
    differences: tuple[str, ...]
    asked: tuple[str, ...]
    tail: int

    @property
    def same(self) -> bool:
        """Whether every sample of the log came again, bit for bit."""
        return self.different == 0 and not self.asked


def bench_of_run(run: Run) -> Bench:
    """The bench as it was, from the texts that the run kept.

    Raises RunError when it kept none, ConfigError when today's program does not take them any more.
    """
    sources = {name: source.text.encode() for name, source in run.start.sources.items()}
    if BENCH_SOURCE not in sources:
        raise RunError(f"{run.folder}: its start record holds no bench file, so there is nothing to replay it with")
    kept = bench_of(run.start.bench, sources, f"{run.folder.name}: {BENCH_SOURCE}")
    return kept.with_flywheel(run.start.added_inertia_kg_m2)


def replay(
    run: Run,
    bench: Bench | None = None,
    writer: RunWriter | None = None,
    real_time: bool = False,
    listener: Listener | None = None,
) -> Replayed:
    """Play a run back through today's drivers and compare the samples.

    `bench`: with mended instrument files; those that the run kept when left out.
    `writer`: gets the exchanges and events of the replay, where it is kept as a run of its own.
    `real_time`: whether to wait as long between two exchanges as it took then.
    Raises RunError when the run kept no bytes, or is damaged.
    """
    if not run.has_wire:
        raise RunError(f"{run.folder}: the bytes on the wire were not kept, so there is nothing to replay")
    room = run.start.ambient.model_dump()
    player = Player(bench or bench_of_run(run), run.start.simulated, room, run.start.clock.rate)
    pace, events, compared = _Pace(real_time), _Events(run, player, writer), _Compared(run)
    played = 0
    for number, exchange in run.exchanges():
        events.pass_until(exchange.events[-1].time_ns / NS if exchange.events else 0.0)
        again = player.play(exchange)
        pace.wait(again)
        if writer is not None:
            writer.exchange(again)
        for reading in again.readings:
            compared.take(number, reading)
        played += 1
        if listener is not None:
            listener(played, again)
    events.pass_until(math.inf)
    return compared.result(played, player.differences)


class _Events:
    """Tells the player of the run's events, and writes them into its replay, each before what was heard after it."""

    def __init__(self, run: Run, player: Player, writer: RunWriter | None) -> None:
        self._player, self._writer = player, writer
        self._left = deque(run.events)

    def pass_until(self, time_s: float) -> None:
        while self._left and self._left[0].time_s <= time_s:
            event = self._left.popleft()
            self._player.stage.hear(event.event, event.details)
            if self._writer is not None:
                self._writer.event(event.event, int(event.time_s * NS), **event.details)


class _Compared:
    """Holds each new sample against its row of the log."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._logged = (line for _, line in itertools.islice(whole_lines(run.folder / SAMPLES), 1, None))
        self._made = self._rows = self._different = 0
        self._found: list[str] = []
        self._ended = False

    def take(self, number: int, reading: Reading) -> None:
        """A reading of the replay, from the exchange of that number."""
        self._made += 1
        new = sample_line(self._made, number, reading, self._run.start.clock.utc_start_ns).rstrip(b"\n")
        old = None if self._ended else next(self._logged, None)
        self._ended = old is None
        if old is None:
            return
        self._rows += 1
        if old != new:
            self._different += 1
            if len(self._found) < SHOWN:
                self._found.append(f"row {self._made}: {_text(old)} is now {_text(new)}")

    def result(self, played: int, asked: Sequence[str]) -> Replayed:
        """After the last reading; ``asked`` is what today's drivers ask otherwise."""
        lost, tail = sum(1 for _ in self._logged), self._made - self._rows
        different, found = self._different + lost, list(self._found)
        if lost:
            found.append(f"{lost} rows of the log did not come again")
        if tail and self._run.state != KILLED:
            found.append(f"{tail} rows came that the log does not have")
            different += tail
        return Replayed(played, self._made, self._rows + lost, different, tuple(found), tuple(asked[:SHOWN]), tail)


def mended_bench(run: Run, instruments: Iterable[str], find: Callable[[str], Path | None]) -> Bench:
    """The run's bench with today's files of some instruments.

    `find`: gives the file of an instrument by its name; None where there is none.
    """
    sources = {name: source.text.encode() for name, source in run.start.sources.items()}
    for name in instruments:
        if instrument_source(name) not in sources:
            raise RunError(f"{run.folder}: no device of this run is a '{name}'")
        path = find(name)
        if path is None:
            raise RunError(f"{name}.toml: no such file in the project's instruments, nor in configs/instruments")
        sources[instrument_source(name)] = path.read_bytes()
    return bench_of(run.start.bench, sources, f"{run.folder.name}: {BENCH_SOURCE}")


class _Pace:
    """Waits as long between two exchanges as it took then, when that is wanted."""

    def __init__(self, real_time: bool) -> None:
        self.real_time = real_time
        self._start: tuple[int, float] | None = None

    def wait(self, exchange: Exchange) -> None:
        if not self.real_time or not exchange.events:
            return
        now_ns = exchange.events[-1].time_ns
        if self._start is None:
            self._start = (now_ns, time.monotonic())
        began_ns, began = self._start
        left = (now_ns - began_ns) / NS - (time.monotonic() - began)
        if left > 0.0:
            time.sleep(left)


def _text(line: bytes) -> str:
    return line.decode("utf-8", errors="replace")[:160]
