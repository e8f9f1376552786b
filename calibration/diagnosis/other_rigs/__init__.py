"""What physics a recording of another rig shows that viscous friction, or displacement, leaves out.

problem, coordinates, noise, fit   readings and predictions, and the most probable point
linear                             a fitted model made linear
places                             forces of any shape, and where along what they act
detect, name, confirm, verdict, next_test: the steps
diagnose                           all of them
document                           the result as diagnosis/1; words: for people
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from calibration.diagnosis.other_rigs.diagnose import RigDiagnosis, look
from calibration.diagnosis.other_rigs.document import as_json
from rig.recording import Recording

__all__ = ["RigDiagnosis", "as_json", "diagnose_rig", "look"]


def diagnose_rig(
    recording: Recording, seed: int = 1, tell: Callable[[str], None] = lambda _: None, held_out: Recording | None = None
) -> dict[str, Any]:
    """Diagnose a recording whose motor is written out in it, as diagnosis/1.

    Parameters
    ----------
    recording : Recording
        With an inline motor: a free rotor, a driven axis or a displacement machine.
    held_out : Recording or None
        An unseen run of the same rig; blocks of the recording are held out where there is none.

    Raises
    ------
    RecordingError
        When a recording does not hold what its kind of rig needs.
    """
    return as_json(look(recording, seed, tell, held_out))
