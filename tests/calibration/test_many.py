"""One task over many items: processes and a Dask cluster, killed on the way, interrupted, gone on with."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import psutil
import pytest

from calibration.challenge.campaign import running
from calibration.challenge.campaign.campaign import make
from calibration.challenge.campaign.layout import ChallengeError
from calibration.challenge.campaign.sealing import SealError
from calibration.work.many import MOST_TRIES, ClusterError, Item, read_results, run_many
from tests import fake_rig
from tests.fake_rig import square

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0


def items_of(count, **more):
    return [Item(f"item{n}", {"n": n, **more}) for n in range(count)]


def squares(results):
    return [result.value and result.value["square"] for result in results]


def wait_for(path):
    end = time.monotonic() + PATIENCE_S
    while not (path.exists() and path.read_text(encoding="utf-8")):
        assert time.monotonic() < end, f"{path} never came"
        time.sleep(0.02)
    return path.read_text(encoding="utf-8")


def kill_once_started(mark):
    """In the background: kill -9 the worker that says it has begun."""
    thread = threading.Thread(target=lambda: os.kill(int(wait_for(mark)), signal.SIGKILL))
    thread.start()
    return thread


WORKER_WITH_NUMBA = """
import numba  # before the worker begins, as with a script that is started with -m
from calibration.work.processes import begin_worker
begin_worker()

@numba.njit(parallel=True)
def sum_of(n):
    total = 0.0
    for i in numba.prange(n):
        total += i
    return total

assert sum_of(5) == 10.0
assert numba.get_num_threads() == 1
begin_worker()
assert numba.njit(lambda n: n)(3) == 3
"""


@pytest.mark.parametrize("threads", ["1", "2", None])
def test_a_worker_compiles_with_any_number_of_threads_asked_for(threads):
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_NUM_THREADS"}
    environment |= {"PYTHONPATH": str(ROOT)} | ({"NUMBA_NUM_THREADS": threads} if threads else {})
    begun = [sys.executable, "-c", WORKER_WITH_NUMBA]
    subprocess.run(begun, env=environment, check=True, timeout=PATIENCE_S)


@pytest.mark.parametrize("workers", [0, 2])
def test_every_item_has_its_result_in_order(tmp_path, workers):
    assert squares(run_many(square, items_of(5), tmp_path, workers)) == [0, 1, 4, 9, 16]


def test_what_is_on_disk_is_not_done_again(tmp_path):
    run_many(square, items_of(3), tmp_path, 0)
    told = []
    again = run_many(None, items_of(3), tmp_path, 0, tell=lambda *step: told.append(step))
    assert squares(again) == [0, 1, 4]
    assert told == [(3, 3, "")]


def test_a_result_of_another_mark_is_done_again(tmp_path):
    run_many(square, [Item("one", {"n": 2}, "first code")], tmp_path, 0)
    assert squares(run_many(square, [Item("one", {"n": 3}, "second code")], tmp_path, 0)) == [9]


def test_a_torn_result_is_done_again(tmp_path):
    (tmp_path / "item0.json").write_text('{"name": "item0", "val', encoding="utf-8")
    assert squares(run_many(square, items_of(1), tmp_path, 0)) == [0]


def test_an_item_that_fails_says_why_and_stops_no_other(tmp_path):
    items = [Item("bad", {"n": 7, "fails": True}), Item("good", {"n": 3})]
    bad, good = run_many(square, items, tmp_path, 1)
    assert (bad.value, bad.error) == (None, "ValueError: 7 cannot be squared")
    assert good.value == {"square": 9}


def test_an_error_is_of_its_class_and_of_those_that_it_derives_from(tmp_path):
    def fails(_):
        raise SealError("the seal is broken")

    items = items_of(1)
    (made,) = run_many(fails, items, tmp_path, 0)
    (read,) = read_results(items, tmp_path)
    assert made == read
    assert [made.failed_by(kind) for kind in (SealError, ChallengeError, OSError)] == [True, True, False]


def test_an_error_of_an_older_file_is_of_the_class_that_it_names(tmp_path):
    items = items_of(2)
    for item, error in zip(items, ("ChallengeError: other code", ""), strict=True):
        made = {"name": item.name, "mark": "", "value": None, "error": error, "seconds": 1.0}
        (tmp_path / f"{item.name}.json").write_text(json.dumps(made), encoding="utf-8")
    assert [result.failed_by(ChallengeError) for result in read_results(items, tmp_path)] == [True, False]


def test_an_item_that_failed_is_tried_again_the_next_time(tmp_path):
    run_many(square, [Item("one", {"n": 2, "fails": True})], tmp_path, 0)
    assert squares(run_many(square, [Item("one", {"n": 2})], tmp_path, 0)) == [4]


def test_two_items_of_one_name_are_refused(tmp_path):
    with pytest.raises(ValueError, match="share a name"):
        run_many(square, [Item("one", {"n": 1}), Item("one", {"n": 2})], tmp_path, 0)


def test_progress_counts_up_to_all(tmp_path):
    told = []
    run_many(square, items_of(4), tmp_path, 2, tell=lambda done, total, name: told.append((done, total)))
    assert told == [(n, 4) for n in range(5)]


def test_a_worker_process_killed_on_the_way_loses_nothing(tmp_path):
    mark = tmp_path / "started"
    items = [Item("slow", {"n": 9, "started": str(mark), "sleep": 1.0}), *items_of(4)]
    killer = kill_once_started(mark)
    found = run_many(square, items, tmp_path / "out", 2)
    killer.join()
    assert squares(found) == [81, 0, 1, 4, 9]
    assert not any(result.error for result in found)


def test_an_item_that_kills_every_worker_is_given_up_alone(tmp_path):
    deadly = Item("deadly", {"n": 1, "dies_without": str(tmp_path / "cure")})
    deadly_result, *others = run_many(square, [deadly, *items_of(4)], tmp_path / "out", 2)
    assert f"died {MOST_TRIES} times" in deadly_result.error
    assert squares(others) == [0, 1, 4, 9]


INTERRUPTED = """
    import sys
    from pathlib import Path
    from calibration.work.many import Item, run_many
    from tests.fake_rig import square

    if __name__ == "__main__":
        out = Path(sys.argv[1])
        items = [Item("quick", {"n": 2}), Item("slow", {"n": 3, "started": str(out / "started"), "sleep": 600.0})]
        run_many(square, items, out / "results", 1)
"""


@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_is_stopped_leaves_no_worker_and_goes_on(tmp_path, blow):
    script = tmp_path / "run.py"
    script.write_text(textwrap.dedent(INTERRUPTED), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(script), str(tmp_path)], env=environment, stderr=subprocess.DEVNULL)
    worker = psutil.Process(int(wait_for(tmp_path / "started")))
    parent.send_signal(blow)
    parent.wait(PATIENCE_S)
    worker.wait(PATIENCE_S)  # raises when it lives on
    items = [Item("quick", {"n": 2, "fails": True}), Item("slow", {"n": 3})]  # done anew, the first would fail
    assert squares(run_many(square, items, tmp_path / "results", 0)) == [4, 9]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, each a process that can be killed; what a person would start by hand."""
    folder = tmp_path_factory.mktemp("cluster")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "5"}
    common = ["--no-dashboard"]
    commands = [["scheduler", "--host", "127.0.0.1", "--port", str(port), *common]]
    commands += [["worker", address, "--nthreads", "1", "--no-nanny", "--local-directory", str(folder), *common]] * 2
    dask = [sys.executable, "-m", "dask"]
    running = [
        subprocess.Popen([*dask, *command], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for command in commands
    ]
    try:
        from distributed import Client

        with Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=PATIENCE_S)
        yield address
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait(PATIENCE_S)


def test_a_worker_of_a_cluster_killed_on_the_way_loses_nothing(cluster, tmp_path):
    mark = tmp_path / "started"
    items = [Item("slow", {"n": 9, "started": str(mark), "sleep": 1.0}), *items_of(20)]
    killer = kill_once_started(mark)
    found = run_many(square, items, tmp_path / "out", scheduler=cluster)
    killer.join()
    assert squares(found) == [81, *(n**2 for n in range(20))]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(f"{item.name}.json" for item in items)


def test_a_failing_item_stops_no_other_on_a_cluster(cluster, tmp_path):
    bad, good = run_many(
        square, [Item("bad", {"n": 7, "fails": True}), Item("good", {"n": 3})], tmp_path, scheduler=cluster
    )
    assert bad.error == "ValueError: 7 cannot be squared"
    assert good.value == {"square": 9}


def test_a_campaign_run_on_a_cluster_has_the_verdicts_of_one_process(cluster, tmp_path):
    """The verdict of each case is a function of its recording and seed, wherever it is found."""
    blind = tmp_path / "blind"
    make(blind, 6, seed=5, maker=fake_rig.NAME, workers=0)
    shutil.copytree(blind, tmp_path / "again" / "blind")
    there = running.run(blind, scheduler=cluster, task=fake_rig.diagnose)
    here = running.run(tmp_path / "again" / "blind", 0, task=fake_rig.diagnose)
    assert there.sha256 == here.sha256
    assert not any(one.error for one in there.results)


def test_no_scheduler_is_told_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr("calibration.work.many.CONNECT_S", 0.5)
    with pytest.raises(ClusterError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9 .*--workers"):
        run_many(square, items_of(1), tmp_path, scheduler="tcp://127.0.0.1:9")
