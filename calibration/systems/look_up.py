"""The system that a recording is of."""

from __future__ import annotations

from calibration.likelihood.compared import Compared
from calibration.systems.machines import comparison as machines
from calibration.systems.machines.problem import Problem as MachineProblem
from calibration.systems.machines.system import has_system
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from model.motor import Motor
from rig.recording import Recording, RecordingError


def compared(recording: Recording, motor: Motor | None = None) -> Compared:
    """A recording as its system compares it.

    Parameters
    ----------
    motor : Motor or None
        The motor that it names, when left out.

    Raises
    ------
    RecordingError
        When it holds nothing that its system can compare.
    """
    if has_system(recording):
        return machines.Comparison(MachineProblem(recording))
    return Comparison(Problem(recording, motor))


def refuse_another(seen: Recording, unseen: Recording) -> None:
    """Refuse a run of another machine, of which nothing can be predicted.

    Parameters
    ----------
    seen, unseen : Recording
        The recording that is diagnosed, and the run held out.

    Raises
    ------
    RecordingError
        When their machines differ.
    """
    if isinstance(seen.motor, str) or isinstance(unseen.motor, str):
        if unseen.motor != seen.motor:
            raise RecordingError(f"{unseen.folder}: of the motor {unseen.motor}, not {seen.motor}")
        return
    one, other = ((table.get("kind"), "mass_kg" in table) for table in (seen.motor, unseen.motor))
    if one != other:
        raise RecordingError(f"{unseen.folder}: held out is a {other[0]}, and diagnosed a {one[0]}")
