"""spinbench from Python: what a script or a notebook needs, by name; a room is imported when a name of it is used.

>>> import spinbench
>>> recording = spinbench.read_recording(spinbench.published_sweep())
>>> found = spinbench.fit(recording, spinbench.Settings(seed=1))
"""

from __future__ import annotations

import importlib
import os
from typing import Any

# Its matrices are small: threads that share one of them cost more than they save. Set before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Every public name, and the room that it is in.
ROOMS = {
    # the model
    "read_motor": "model.motor",
    "set_values": "model.motor",
    "operating_points": "model.operation.performance",
    "spin_up": "model.operation.runs",
    "coast_down": "model.operation.runs",
    "sensitivities": "model.operation.sensitivity",
    # recordings and runs
    "read_recording": "rig.recording",
    "write_recording": "rig.recording",
    "published_sweep": "spinbench.published",
    "read_run": "rig.runlog",
    "list_runs": "rig.runlog.listing",
    "recording_of": "rig.exchange.export",
    "verify": "rig.runlog",
    # the calibration
    "fit": "calibration.fit.fit",
    "judge": "calibration.fit_quality",
    "Settings": "calibration.fit.sampling",
    "diagnose": "calibration.diagnosis",
    "together": "calibration.diagnosis",
    "compare": "calibration.diagnosis.changes",
    # the command line
    "main": "spinbench.cli",
}

__all__ = list(ROOMS)


def __getattr__(name: str) -> Any:
    if name not in ROOMS:
        raise AttributeError(f"module 'spinbench' has no attribute '{name}'")
    return getattr(importlib.import_module(ROOMS[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *ROOMS})
