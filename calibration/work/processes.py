"""Processes that work for another: one thread each, and no longer than the one that they work for."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from multiprocessing.process import BaseProcess

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def begin_worker() -> None:
    """A worker has one thread, leaves Ctrl-C to its parent, and ends when that does, however it ended."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    if "numba" in sys.modules:  # loaded with the caller's own script: its number of threads can no longer be changed
        numba = sys.modules["numba"]
        os.environ["NUMBA_NUM_THREADS"] = str(numba.config.NUMBA_NUM_THREADS)
        numba.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
