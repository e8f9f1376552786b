"""The second rig: it makes the challenge's recordings, and shares rig.recording alone with what it tests.

Another integrator, gas that flows through ports at a finite rate, other functional forms, its own sensors. Nothing of
`model` or of the rest of the calibration is imported here (an import contract holds it), and of `configs` only
`compiled`, which says when what numba compiled is made anew. docs/second-rig.md tells what it does, and how far it and
the article's reference figures agree.

machine     the motor
supply      the line ahead of it, and where it stands under load
concealed, instruments  effects: their laws on the motor, and on what is read
bench       what the instruments would read without noise
readout     what tachometer and gauge make of a run in time
sizes, draws, truth    what a case conceals; equipment: the line and the instruments that are drawn
live        motor and line carried on in a bench's time, behind the virtual bench's instruments
sheets, recordings     recording/1, and a further test
signatures, runs_seen, small_torques, separable  what a recording can tell apart

What stands in many signatures: `p` figures of the motor as `slots` lays them out, `rows`, shape (n, k), of a motor a
row; `y` its state as `motor` lays it out, changed in place, and `table` of `curve`; `line` and `lines` pressure at the
gauge [Pa]; `figures`, shape (6,), of `Supply`, and `s`, shape (5,), the state of the line, changed in place; `target`
what the regulator is set to [Pa]; `less` how much less than the line's pressure the motor gets [Pa]; `clock` the
recording's [s]; `cell` duration of a cell and `dt` (largest) step [s]; `theta` the shaft's angle and `psi` that within
a lobe [rad]; `gauge` and `line_gauge` pressure of the line above the ambient's [Pa]; `nuisances` figures of the motor
off their defaults [SI]; `omega` and `speed` the shaft's speed [rad/s], `pressure` that at the gauge [Pa], `T`
temperature [K], `mass_flow` out of the line [kg/s].

Kernels take their arrays one by one, however many: in a tuple they cost a short kernel time at every call.
"""

from calibration.challenge.second_rig.draws import draw
from calibration.challenge.second_rig.recordings import another_day, follow_up, make_recording
from calibration.challenge.second_rig.separable import separable
from calibration.challenge.second_rig.truth import Truth

__all__ = ["Truth", "another_day", "draw", "follow_up", "make_recording", "separable"]
