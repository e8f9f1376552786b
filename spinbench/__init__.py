"""spinbench from Python: what a script or a notebook needs, by name; a room is imported when a name of it is used.

>>> import spinbench as sb
>>> run = sb.open("published_sweep")
>>> post = sb.fit(run, sb.Settings(seed=1))
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what a type checker sees; the same names as in ROOMS
    from calibration.data.joined import together as together
    from calibration.fit.sampling import Settings as Settings
    from calibration.fit_quality import judge as judge
    from calibration.systems.machines.system import System as System
    from calibration.systems.machines.system import add_system as add_system
    from model.motor import read_motor as read_motor
    from model.motor import set_values as set_values
    from model.operation.performance import operating_points as operating_points
    from model.operation.runs import coast_down as coast_down
    from model.operation.runs import spin_up as spin_up
    from model.operation.sensitivity import sensitivities as sensitivities
    from rig.exchange.export import recording_of as recording_of
    from rig.recording import RecordingError as RecordingError
    from rig.recording import read_recording as read_recording
    from rig.recording import write_recording as write_recording
    from rig.recording.schema import MotorTable as MotorTable
    from rig.runlog import RunError as RunError
    from rig.runlog import read_run as read_run
    from rig.runlog import verify as verify
    from rig.runlog.listing import list_runs as list_runs
    from spinbench.api.comparing import ComparisonResult as ComparisonResult
    from spinbench.api.comparing import compare as compare
    from spinbench.api.diagnosing import DiagnosisResult as DiagnosisResult
    from spinbench.api.diagnosing import diagnose as diagnose
    from spinbench.api.fitting import FitResult as FitResult
    from spinbench.api.fitting import fit as fit
    from spinbench.api.opened import Opened as Opened
    from spinbench.api.opened import open as open
    from spinbench.api.opened import without as without
    from spinbench.api.simulating import simulate as simulate
    from spinbench.cli import main as main
    from spinbench.published import published_sweep as published_sweep

# Its matrices are small: threads that share one of them cost more than they save. Set before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Every public name, and the room that it is in.
ROOMS = {
    # a run or a recording, and what it tells
    "open": "spinbench.api.opened",
    "without": "spinbench.api.opened",
    "simulate": "spinbench.api.simulating",
    "fit": "spinbench.api.fitting",
    "diagnose": "spinbench.api.diagnosing",
    "compare": "spinbench.api.comparing",
    "Opened": "spinbench.api.opened",
    "FitResult": "spinbench.api.fitting",
    "DiagnosisResult": "spinbench.api.diagnosing",
    "ComparisonResult": "spinbench.api.comparing",
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
    "RecordingError": "rig.recording",
    "published_sweep": "spinbench.published",
    "read_run": "rig.runlog",
    "RunError": "rig.runlog",
    "list_runs": "rig.runlog.listing",
    "recording_of": "rig.exchange.export",
    "verify": "rig.runlog",
    # the calibration
    "judge": "calibration.fit_quality",
    "Settings": "calibration.fit.sampling",
    "together": "calibration.data.joined",
    # a machine of one's own
    "System": "calibration.systems.machines.system",
    "MotorTable": "rig.recording.schema",
    "add_system": "calibration.systems.machines.system",
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
