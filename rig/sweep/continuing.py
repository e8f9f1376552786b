"""What a sweep that was broken off has taken already."""

from __future__ import annotations

from rig.runlog import Run
from rig.sweep.plan import Step


def finished_steps(run: Run) -> tuple[Step, ...]:
    """The steps of a run whose plateau counts and had settled.

    Parameters
    ----------
    run : Run
        The run that is continued.
    """
    return tuple(
        Step(plateau.level_bar_abs, plateau.direction, plateau.repeat)
        for plateau in run.plateaus
        if plateau.settled and plateau.level_bar_abs is not None
    )
