"""Run in a process of its own: wall time of the imports and of the first call of each solver, as JSON [s]."""

from __future__ import annotations

import json
import time


def _lap(begun: float, laps: dict[str, float], name: str) -> float:
    now = time.perf_counter()
    laps[name] = now - begun
    return now


def main() -> None:
    """Call each once, from the innermost out; what one compiles the next does not."""
    laps: dict[str, float] = {}
    begun = time.perf_counter()

    import numpy as np

    from calibration.fit import fit
    from model.motor import read_motor
    from model.solvers import steady, transient
    from rig.recording import read_recording
    from spinbench.published import published_sweep

    motor = read_motor("ptm3600")
    begun = _lap(begun, laps, "imports")
    steady.steady(motor, [2.0e5])
    begun = _lap(begun, laps, "steady")
    transient.simulate(motor, [transient.Supply(0.0, 2.0e5)], np.array([0.0, 0.01]))
    begun = _lap(begun, laps, "transient")
    _, _, likelihood = fit.prepare(read_recording(published_sweep()))
    likelihood.log_prob(np.zeros((1, len(likelihood.unknowns))))
    _lap(begun, laps, "likelihood")
    print(json.dumps(laps))


if __name__ == "__main__":
    main()
