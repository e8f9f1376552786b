"""One task over many items: worker processes of this machine, or an existing Dask cluster; resumable.

Every result is a file, written whole or not at all by the process that called `run_many`. An item whose file is there
already is not computed again, so a run that was interrupted in any way goes on when it is started anew. A worker that
is killed costs nothing but time: its item is given to another.
"""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from calibration.work.processes import begin_worker
from rig.recording.files import write_file

MOST_TRIES = 3  # deaths of a worker over one item before the item is given up
TASKS_A_WORKER = 100  # after which a worker is replaced, so that leaks of memory stay small
CONNECT_S = 20.0  # longest wait for a scheduler

Task = Callable[[Any], dict[str, Any]]
Tell = Callable[[int, int, str], None]
Keep = Callable[["Item", dict[str, Any]], None]


class ClusterError(OSError):
    """The cluster cannot be reached, or was lost; results so far are on disk."""


@dataclass(frozen=True)
class Item:
    """One thing to do.

    `name`: of its result file; letters, digits, dots, dashes and underscores.
    `argument`: what the task is called with; has to survive pickling.
    `mark`: what the result hangs on besides; a result with another mark is computed anew.
    """

    name: str
    argument: Any
    mark: str = ""


@dataclass(frozen=True)
class Result:
    """What became of an item.

    `error`: why there is no value, in words; empty when there is one.
    `seconds`: wall time of the task in its worker [s].
    `error_types`: names of the error's class and of those that it derives from.
    """

    name: str
    value: dict[str, Any] | None
    error: str
    seconds: float
    error_types: tuple[str, ...] = ()

    def failed_by(self, kind: type[Exception]) -> bool:
        """Whether its error is of this kind."""
        return kind.__name__ in self.error_types


def run_many(
    task: Task,
    items: Sequence[Item],
    out: Path,
    workers: int = 1,
    scheduler: str | None = None,
    tell: Tell = lambda done, total, name: None,
) -> list[Result]:
    """Do all items that are not done yet, and return what became of all, in their order.

    `task`: a function of a module, or a partial of one: it is called in other processes. What it raises becomes the
        item's error, and the item is tried again the next time.
    `items`: what to do; names differ.
    `workers`: processes; 0 works in this one [-].
    `scheduler`: address of a Dask scheduler, ``tcp://host:port``, whose workers are used instead of processes.
    `tell`: told how many are done, of how many, and the last one's name.
    Raises ClusterError when no scheduler answers, or it is lost on the way; ValueError when two items have one name.
    """
    names = [item.name for item in items]
    if len(set(names)) < len(names):
        raise ValueError(f"items that share a name: {[n for n, count in Counter(names).items() if count > 1][:5]}")
    out.mkdir(parents=True, exist_ok=True)
    found = {item.name: result for item in items if (result := _read(out, item)) is not None and not result.error}
    missing = [item for item in items if item.name not in found]
    tell(len(found), len(items), "")

    def keep(item: Item, made: dict[str, Any]) -> None:
        write_file(_place(out, item.name), json.dumps({"name": item.name, "mark": item.mark} | made).encode())
        found[item.name] = _result(item.name, made)
        tell(len(found), len(items), item.name)

    if scheduler is not None and missing:
        _on_cluster(task, missing, scheduler, keep)
    elif workers > 0 and missing:
        _in_processes(task, missing, workers, keep)
    else:
        for item in missing:
            keep(item, call(task, item.argument))
    return [found[name] for name in names]


def read_results(items: Sequence[Item], out: Path) -> list[Result | None]:
    """What is on disk of each item; None where there is nothing, or of another mark."""
    return [_read(out, item) for item in items]


def call(task: Task, argument: Any) -> dict[str, Any]:
    """A task's value, or its error in words with its kinds, and its time [s]."""
    began = time.monotonic()
    try:
        made: dict[str, Any] = {"value": task(argument), "error": "", "error_types": []}
    except Exception as problem:  # whatever one item does, the others are done
        kind = type(problem)
        types = [one.__name__ for one in kind.__mro__ if issubclass(one, Exception)]
        made = {"value": None, "error": f"{kind.__name__}: {problem}", "error_types": types}
    return made | {"seconds": round(time.monotonic() - began, 3)}


def _place(out: Path, name: str) -> Path:
    return out / f"{name}.json"


def _read(out: Path, item: Item) -> Result | None:
    try:
        data = json.loads(_place(out, item.name).read_text(encoding="utf-8"))
        if data["mark"] != item.mark:
            return None
        return _result(item.name, data)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _result(name: str, made: Mapping[str, Any]) -> Result:
    types = made.get("error_types", [made["error"].partition(":")[0]])  # in an older file its class alone is told
    return Result(name, made["value"], made["error"], made["seconds"], tuple(types))


def _gone(how_often: str) -> dict[str, Any]:
    words = f"the worker died {how_often} over this item; it may need more memory than there is"
    return {"value": None, "error": words, "error_types": [], "seconds": 0.0}


class _Worker:
    """A pool of one process, so that a death tells which item it was over, and costs no other item."""

    def __init__(self) -> None:
        self.pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=begin_worker)
        self.tasks = 0
        self.processes: set[BaseProcess] = set()

    def submit(self, task: Task, argument: Any) -> Future[dict[str, Any]]:
        others = set(multiprocessing.active_children())
        future = self.pool.submit(call, task, argument)
        self.processes |= set(multiprocessing.active_children()) - others
        self.tasks += 1
        return future

    def dismiss(self, at_once: bool) -> None:
        self.pool.shutdown(wait=False, cancel_futures=True)
        if at_once:
            for process in self.processes:
                with contextlib.suppress(ValueError):  # it has been closed already
                    process.kill()


def _in_processes(task: Task, items: Sequence[Item], workers: int, keep: Keep) -> None:
    waiting, deaths = deque(items), Counter[str]()
    idle = [_Worker() for _ in range(min(workers, len(items)))]
    busy: dict[Future[dict[str, Any]], tuple[_Worker, Item]] = {}
    try:
        while waiting or busy:
            while idle and waiting:
                worker, item = idle.pop(), waiting.popleft()
                try:
                    busy[worker.submit(task, item.argument)] = (worker, item)
                except BrokenProcessPool:  # killed while it was idle
                    worker.dismiss(at_once=True)
                    idle.append(_Worker())
                    waiting.appendleft(item)
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                worker, item = busy.pop(future)
                try:
                    keep(item, future.result())
                except BrokenProcessPool:
                    worker.tasks = TASKS_A_WORKER
                    deaths[item.name] += 1
                    if deaths[item.name] < MOST_TRIES:
                        waiting.append(item)
                    else:
                        keep(item, _gone(f"{MOST_TRIES} times"))
                if worker.tasks >= TASKS_A_WORKER:
                    worker.dismiss(at_once=False)
                    worker = _Worker()
                idle.append(worker)
    finally:
        for worker in idle:
            worker.dismiss(at_once=False)
        for worker, _ in busy.values():
            worker.dismiss(at_once=True)


def _on_cluster(task: Task, items: Sequence[Item], scheduler: str, keep: Keep) -> None:
    from distributed import KilledWorker, as_completed

    run = uuid.uuid4().hex  # a scheduler remembers keys, also those of an earlier run
    with _client(scheduler) as client:
        submitted = {
            client.submit(call, task, item.argument, key=f"{item.name}-{run}", pure=False): item for item in items
        }
        try:
            for future in as_completed(list(submitted), loop=client.loop):
                item = submitted.pop(future)
                if future.status == "finished":
                    keep(item, future.result())
                elif future.status == "error" and isinstance(future.exception(), KilledWorker):
                    keep(item, _gone("more often than the scheduler allows"))
                elif future.status == "error":
                    raise ClusterError(f"the workers at {scheduler} cannot run the task: {future.exception()}")
                else:
                    raise ClusterError(f"the scheduler {scheduler} was lost; start it and run this again: it goes on")
        finally:
            client.cancel(list(submitted))


@contextlib.contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it would log, we say
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as problem:  # a time-out is an OSError
        raise ClusterError(
            f"no Dask scheduler answers at {scheduler} ({problem}); start one with `dask scheduler`, or use --workers"
        ) from None
    with client:
        yield client
