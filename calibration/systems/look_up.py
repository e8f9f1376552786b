"""The system that a recording is of."""

from __future__ import annotations

from collections.abc import Sequence

from calibration.data.joined import by_flywheel, names_of
from calibration.data.measurement import gather
from calibration.data.together import refuse_unlike
from calibration.likelihood.compared import Compared
from calibration.systems.machines import comparison as machines
from calibration.systems.machines.problem import Problem as MachineProblem
from calibration.systems.machines.system import has_system
from calibration.systems.radial_piston.batch.effects import refuse_effects
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.systems.several.comparison import Several
from calibration.systems.several.sharing import SHARED, Sharing
from model.motor import Motor
from rig.recording import Recording, RecordingError


def compared(
    recordings: Recording | Sequence[Recording], motor: Motor | None = None, sharing: Sharing = SHARED
) -> Compared:
    """A recording, or several of one motor, as their system compares them.

    `motor`: the motor that it names, when left out.
    `sharing`: of which effects each recording has its own sizes.
    Raises RecordingError when one holds nothing that its system can compare, or several are of machines that are
    written out in them.
    """
    given = [recordings] if isinstance(recordings, Recording) else recordings
    parts = [part for one in given for part in by_flywheel(one)]
    is_one = isinstance(recordings, Recording) and len(parts) == 1
    if not is_one:
        refuse_unlike(parts)
        machine = next((one for one in parts if has_system(one)), None)
        if machine is not None:
            raise RecordingError(
                f"{machine.folder}: its motor is written out in it, and such recordings are diagnosed one by one "
                "(spinbench many diagnose), or together where ambient, inertia and instruments are the same"
            )
    elif has_system(parts[0]):
        return machines.Comparison(MachineProblem(parts[0]))
    each = [Comparison(Problem(one, motor, any_turn=k > 0)) for k, one in enumerate(parts)]
    if not any(one.n for one in each):
        gather(parts[0])  # says that a plateau is missing
    if is_one:
        return each[0]
    several = Several(each, names_of(parts), sharing)
    refuse_effects(sorted(sharing.own), {effect.id for effect in several.problem.effects_that_could()})
    return several
