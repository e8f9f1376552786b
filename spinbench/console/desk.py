"""What all windows of a console share: the run that goes on, who controls, STOP, and the alarms that were seen."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rig.bench.bench import FOLDER, Bench
from rig.runlog import RunError
from rig.runlog.folder import END, is_locked
from rig.runlog.reader import BEING_WRITTEN, read_end, read_start, state_of
from rig.runlog.tail import Tail
from rig.sweep.capture import level_of
from spinbench.console import stopping
from spinbench.console.access import Kept, RefusedError, reports_of
from spinbench.console.facts import facts, readings
from spinbench.console.live import Live
from spinbench.console.planned import kinds_of
from spinbench.console.queue import Queue
from spinbench.console.recommended import recommended
from spinbench.console.stopping import Stopping
from spinbench.console.sweeps import RANGES, Sweeps
from spinbench.console.words import CLOSE_SUPPLY, is_imported

LOOK_FOR_RUNS_S = 0.5
SHOWN_RUNS = 200
STOP_SHOWN_S = 60.0  # how long a STOP that was delivered is told; one that was not stays
NAME = 40  # characters of a window's name


class Showing:
    """One run followed, or played again, for whoever looks. Its methods may be called from several threads.

    `replay`: seconds of the run in one of the wall; 0 shows all of it [-].
    """

    def __init__(self, folder: Path, replay: float = 0.0) -> None:
        self.tail = Tail(folder)
        self._replay, self._began = replay, time.monotonic()
        self._lock = threading.Lock()
        self._grown, self._size = time.monotonic(), -1

    def follow(self) -> None:
        """Take in what is new, a megabyte at a time."""
        more = True
        while more:
            with self._lock:
                more = self.tail.advance(self._until_s(), blocks=4)
                size = self.tail.samples + self.tail.last_event
                if size != self._size:
                    self._size, self._grown = size, time.monotonic()

    def _until_s(self) -> float | None:
        return (time.monotonic() - self._began) * self._replay if self._replay else None

    def facts(self, span_s: float, acknowledged: list[int], bench: str = "") -> dict[str, Any]:
        """The run as it stands. `span_s`: of the charts [s]. `bench`: as it is typed; its name where empty."""
        with self._lock:
            is_live = self.tail.state == BEING_WRITTEN and not self._replay
            silent_s = time.monotonic() - self._grown if is_live else 0.0
            now_s = self.tail.now_s + silent_s * self.tail.start.clock.rate
            found = facts(self.tail, now_s, span_s, acknowledged, silent_s, bench)
        found["run"]["replay"] = self._replay
        for figure in found["figures"] if self._replay else []:
            figure |= {"mark": "past", "quality": f"replayed: {figure['quality']}"}
        return found

    def readings(self) -> dict[str, dict[str, Any]]:
        """The newest reading of each role, as numbers."""
        with self._lock:
            return readings(self.tail)

    def answered(self, one: Stopping) -> None:
        """See whether the run's log answers a STOP."""
        with self._lock:
            one.look(self.tail)


class Desk:
    """The console's own state. `follow` is called several times a second, from one thread."""

    def __init__(
        self, path: Path, bench: Bench, logs: Path, options: tuple[str, ...] = (), published: Sequence[Live] = ()
    ) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self.bench, self.logs, self._published = bench, logs, published
        self.kept = Kept(logs)
        self.sweeps = Sweeps(path, bench, logs, options)
        self.queue = Queue(bench, self.sweeps, self.kept.queue, self.kept.keep_queue)
        self.showing: Showing | None = None
        self.unreadable = ""
        self.windows: dict[str, int] = {}
        self.controller: dict[str, str] | None = None
        self._stops: list[Stopping] = []
        self._told: dict[str, Any] | None = None
        self._followers: dict[Path, Showing] = {}
        self._looked = 0.0

    # What goes on.

    def follow(self) -> None:
        """Look for the newest run, and take in what is new of it."""
        try:
            if time.monotonic() - self._looked > LOOK_FOR_RUNS_S:
                self._looked = time.monotonic()
                folder = self._latest()
                if folder is not None and (self.showing is None or self.showing.tail.folder != folder):
                    self.showing = Showing(folder)
            if self.showing is not None:
                self.showing.follow()
            self._follow_stops()
            self.queue.follow()
            for one in self._published:
                one.publish(self._live)
            self.unreadable = ""
        except (RunError, OSError) as error:
            self.unreadable = str(error)
        except Exception as error:  # whatever it is: the windows are told, and STOP goes on
            self.unreadable = f"the run cannot be followed: {type(error).__name__}: {error}"

    def _live(self) -> dict[str, Any] | None:
        """What is published of the run."""
        showing = self.showing
        return None if showing is None else self.facts(showing, 1.0) | {"readings": showing.readings()}

    def _latest(self) -> Path | None:
        """The run that is being written, or the newest one of a bench: an import says nothing of the bench here."""
        going_on = stopping.being_written(self.logs)
        if going_on:
            self.sweeps.forget_refusal()
        return going_on[-1] if going_on else next(stopping.runs_of_benches(self.logs), None)

    def _follow_stops(self) -> None:
        for one in self._stops:
            showing = self.showing
            if showing is None or showing.tail.folder != one.run:
                showing = self._followers.setdefault(one.run, Showing(one.run))
                showing.follow()
            showing.answered(one)

    # What a window asks for.

    def stop(self, by: str) -> dict[str, Any]:
        """STOP, for every run that is being written here."""
        by = by[:NAME] or "a window"
        self.queue.hold(f"STOP was pressed by {by}.")
        is_starting = self.sweeps.starting  # asked first: a run that begins between the two is told as well
        runs = stopping.being_written(self.logs)
        self._followers.clear()
        self._stops = [Stopping.of(run, by) for run in runs]
        if runs:
            self._told = None
        elif is_starting and not self.sweeps.stop():
            by_hand = self.bench.file.roles.regulator is None
            valve = f"A person has the valve. {CLOSE_SUPPLY}" if by_hand else "The regulator has not been raised."
            text = f"The run that was being started is told to end. {valve}"
            self._told = {"word": "NOT DELIVERED" if by_hand else "DELIVERED", "text": text, "run": "", "by": by}
        else:
            self._told = stopping.nothing_to_stop(self.logs) | {"by": by}
        return self.stop_told() or {}

    def stop_told(self) -> dict[str, Any] | None:
        """What became of the last STOP; of several runs, the one that needs a person most."""
        told = [one.told() for one in self._stops if not self._is_old(one)]
        order = ("NOT DELIVERED", "asked", "DELIVERED")
        return min(told, key=lambda one: order.index(one["word"])) if told else self._told

    @staticmethod
    def _is_old(one: Stopping) -> bool:
        return one.delivered and time.time() - one.at > STOP_SHOWN_S

    def take_control(self, window: str, name: str) -> None:
        """A window takes control; every window is shown that."""
        self.controller = {"window": window[:NAME], "name": name[:NAME]}
        self._told = None

    def refuse_without_control(self, window: str) -> None:
        """Refuse a window that only watches."""
        if self.controller is None or self.controller["window"] != window:
            raise RefusedError(409, "another window controls, or none does: take control first")

    # What a window is shown.

    def facts(self, showing: Showing, span_s: float) -> dict[str, Any]:
        """A run with the alarms that were seen, and with commands that can be typed. `span_s`: of the charts [s]."""
        seen = self.kept.acknowledged.get(showing.tail.folder.name, [])
        path = self.sweeps.path
        is_here = showing.tail.start.bench == self.bench.name and path.parent != FOLDER
        return showing.facts(span_s, seen, str(path) if is_here else "")

    def console(self, window: str) -> dict[str, Any]:
        """Of the console itself."""
        sweep = self.bench.file.sweep
        controller = self.controller
        return {
            "bench": {
                "name": self.bench.name,
                "title": self.bench.file.title,
                "by_hand": self.bench.file.roles.regulator is None,
                "kinds": kinds_of(self.bench),
                "levels": sweep.levels_bar_abs,
                "order": sweep.order,
                "repeats": sweep.repeats,
                "ranges": RANGES,
                "captures": list(sweep.captures),
                "capture_level": level_of(self.bench),
                "added_inertia": self.bench.file.added_inertia_kg_m2,
                "highest_speed_rpm": self.bench.file.safety.highest_speed_rpm,
                "highest_pressure_bar_abs": self.bench.file.safety.highest_pressure_bar_abs,
            },
            "logs": str(self.logs),
            "windows": len(self.windows),
            "controller": None if controller is None else controller["name"],
            "queue": self.queue.told(),
            "entries": self.sweeps.asked(),
            "controls": controller is not None and controller["window"] == window,
            "controller_is_there": controller is not None and controller["window"] in self.windows,
            "stop": self.stop_told(),
            "stop_token": self.kept.stop_token,
            "starting": self.sweeps.starting,
            "running": self.sweeps.running,
            "start_failed": self.sweeps.failed(),
            "unreadable": self.unreadable,
            "latest": self.showing.tail.folder.name if self.showing is not None else None,
            "latest_state": self.showing.tail.state if self.showing is not None else "",
        }

    def runs(self) -> list[dict[str, Any]]:
        """The runs in the logs folder, newest first, with their reports."""
        folders = stopping.newest_first(self.logs)[:SHOWN_RUNS]
        return [_row(folder) | {"tests": recommended(self.logs, folder.name, self.bench)} for folder in folders]


def _row(folder: Path) -> dict[str, Any]:
    row: dict[str, Any] = {"name": folder.name, "reports": reports_of(folder.parent, folder.name)}
    row |= {"outcome": "", "kind": "", "bench": "", "plateaus": "", "imported": False}
    try:
        start = read_start(folder)
        locked = not (folder / END).exists() and is_locked(folder)
        end = read_end(folder)
    except RunError as error:
        return row | {"outcome": f"unreadable: {str(error).splitlines()[0][:160]}"}
    plateaus = "" if end is None else end.counts.get("plateaus", "")
    row |= {"outcome": state_of(end, locked), "kind": start.kind, "bench": start.bench}
    return row | {"plateaus": plateaus, "imported": is_imported(start)}


def as_text(part: Any) -> str:
    """A part of what is shown, as JSON."""
    return json.dumps(part, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
