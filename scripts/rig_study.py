"""How often the diagnosis of other rigs is wrong: simulated recordings with nothing left out, and with one known thing.

    python scripts/rig_study.py 40

Prints, for each kind of rig, what was said of that many recordings with nothing left out and of a quarter as many with
each truth. The simulators are those of the tests (tests/rig_recordings.py); seeds are 1, 2, 3 and so on.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import rig_recordings as rigs  # noqa: E402

from calibration.diagnosis import as_json, diagnose  # noqa: E402
from rig.recording import Recording  # noqa: E402

Make = Callable[[np.random.Generator], Recording]
NULLS: dict[str, Make] = {
    "free_rotor": rigs.rotor,
    "driven_axis": rigs.axis,
    "driven_axis with pressure": rigs.cylinder,
    "displacement_machine": rigs.machine,
}
TRUTHS: dict[str, tuple[str, Make]] = {
    "free_rotor, dry friction": ("coulomb_friction", lambda rng: rigs.rotor(rng, lambda w: 0.012 + 0.0 * w)),
    "free_rotor, quadratic drag": ("windage", lambda rng: rigs.rotor(rng, lambda w: 2e-5 * w**2)),
    "free_rotor, drag by the power 1.5": ("", lambda rng: rigs.rotor(rng, lambda w: 2e-4 * w**1.5)),
    "free_rotor, drag above a speed": ("", lambda rng: rigs.rotor(rng, lambda w: 0.03 * (w > 30.0))),
    "driven_axis, dry friction": ("coulomb_friction", lambda rng: rigs.axis(rng, lambda v: 5.0 + 0.0 * v)),
    "driven_axis, quadratic drag": ("windage", lambda rng: rigs.axis(rng, lambda v: 200.0 * v**2)),
    "driven_axis, drag above a speed": ("", lambda rng: rigs.axis(rng, lambda v: 6.0 * (v > 0.08))),
    "cylinder, friction by the pressure": ("load_friction", lambda rng: rigs.cylinder(rng, 0.0, 1.5e-5)),
    "cylinder, dry friction": ("coulomb_friction", lambda rng: rigs.cylinder(rng, 4.0, 0.0)),
    "machine, leak": ("leakage", lambda rng: rigs.machine(rng, leak=1.5e-14)),
    "machine, throttled inlet": ("inlet_throttling", lambda rng: rigs.machine(rng, loss=5e9)),
    "machine, dry friction": ("coulomb_friction", lambda rng: rigs.machine(rng, lambda w: 0.3 + 0.0 * w)),
}


def main(count: int) -> None:
    """Print both tables.

    Parameters
    ----------
    count : int
        Recordings with nothing left out, of each kind [-].
    """
    began = time.monotonic()
    for kind, make in NULLS.items():
        said = [_said(make(np.random.default_rng(seed)), seed) for seed in range(1, count + 1)]
        low = sum(p < 0.01 for _, p in said), sum(p < 0.05 for _, p in said)
        verdicts = dict(Counter(words for words, _ in said))
        print(f"nothing left out, {kind}: {verdicts}; p < 0.01: {low[0]}, < 0.05: {low[1]}", flush=True)
    for words, (truth, make) in TRUTHS.items():
        found = [_said(make(np.random.default_rng(seed)), seed)[0] for seed in range(1, count // 4 + 1)]
        print(f"{words} ({truth or 'in no list'}): {dict(Counter(found))}", flush=True)
    print(f"{time.monotonic() - began:.0f} s")


def _said(recording: Recording, seed: int) -> tuple[str, float]:
    found = as_json(diagnose(recording, seed))
    names = "+".join(sorted(effect["id"] for effect in found["effects"]))
    others = "".join(f" or {'+'.join(one)}" for one in found["alternatives"])
    return f"{found['verdict']} {names}{others}".strip(), found["mismatch"]["p_value"]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
