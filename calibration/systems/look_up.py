"""The system that a recording is of."""

from __future__ import annotations

from collections.abc import Sequence

from calibration.data.joined import names_of
from calibration.likelihood.compared import Compared
from calibration.systems.machines import comparison as machines
from calibration.systems.machines.problem import Problem as MachineProblem
from calibration.systems.machines.system import has_system
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.systems.several.comparison import Several
from model.motor import Motor
from rig.recording import Recording, RecordingError


def compared(recordings: Recording | Sequence[Recording], motor: Motor | None = None) -> Compared:
    """A recording, or several of one motor, as their system compares them.

    Parameters
    ----------
    motor : Motor or None
        The motor that it names, when left out.

    Raises
    ------
    RecordingError
        When one holds nothing that its system can compare, or several are of machines that are written out in them.
    """
    if not isinstance(recordings, Recording):
        for one in recordings[1:]:
            refuse_another(recordings[0], one)
        machine = next((one for one in recordings if has_system(one)), None)
        if machine is not None:
            raise RecordingError(
                f"{machine.folder}: its motor is written out in it, and such recordings are diagnosed one by one "
                "(spinbench many diagnose), or together where ambient, inertia and instruments are the same"
            )
        parts = [Comparison(Problem(one, motor, any_turn=k > 0)) for k, one in enumerate(recordings)]
        return Several(parts, names_of(recordings))
    recording = recordings
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
    one, other = _machine(seen), _machine(unseen)
    if one != other:
        raise RecordingError(f"{unseen.folder}: of {other}, not of {one}")


def _machine(recording: Recording) -> str:
    """What a recording is of, in words."""
    motor = recording.motor
    if isinstance(motor, str):
        return f"the motor {motor}"
    return f"a {motor.get('kind')}{' that slides' if 'mass_kg' in motor else ''}"
