"""A first look at a sweep that may still be running: whether the model explains it so far, and if not, where.

Only the steps detect and locate, and only on plateaus: what is missing is named once the run is over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.data.measurement import gather
from calibration.diagnosis.mismatch import detect_mismatch
from calibration.diagnosis.steps.detect import MISMATCH_P
from calibration.diagnosis.steps.locate import Place, locate
from rig.recording import Recording

FEWEST = 6  # plateaus: offsets and scales of the instruments, f_overall, lap and f_r follow almost any fewer


@dataclass(frozen=True)
class Checked:
    """What a check found.

    `p_value`: of the model without anything added [-]; None when it is too early to say.
    `places`: where the balances do not close, the clearest first; empty where the model explains the recording.
    `extrapolated`: whether the p-value lies beyond the draws of its null law.
    """

    p_value: float | None
    places: list[Place]
    sentence: str
    plateaus: int
    extrapolated: bool = False

    @property
    def differs(self) -> bool:
        """Whether there is a difference worth acting on."""
        return self.p_value is not None and self.p_value < MISMATCH_P


def check(recording: Recording, seed: int = 0) -> Checked:
    """Look at the plateaus of a recording; runs in time are left aside.

    `recording`: of a motor that `model.motor` knows; its plateaus so far.
    """
    steady = tuple(file for file in recording.files if file.kind != "transient")
    swept = replace(recording, files=steady)
    count = _comparable(swept) if any(file.kind == "steady" for file in steady) else 0
    if count < FEWEST:
        return Checked(
            None, [], f"too early: {count} settled plateaus that can be compared, {FEWEST} are needed", count
        )
    detected = detect_mismatch(swept, np.random.default_rng(seed))
    found = detected.detection
    told = f"p = {found.p_value:.2g}{', extrapolated' if found.extrapolated else ''}"
    if found.p_value >= MISMATCH_P:
        return Checked(found.p_value, [], f"the model explains {count} plateaus ({told})", count, found.extrapolated)
    places = locate(detected.comparison, detected.base, found, detected.free)
    where = "" if places else " Where along the sweep, it cannot be told yet."
    sentence = f"the model does not explain {count} plateaus ({told}).{where}"
    return Checked(found.p_value, places, sentence, count, found.extrapolated)


def _comparable(recording: Recording) -> int:
    """Plateaus with a pressure, and a speed or a flow on its scale."""
    return int(np.sum(gather(recording).steady.compared))
