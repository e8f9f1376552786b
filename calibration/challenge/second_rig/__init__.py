"""The second rig: it makes the challenge's recordings, and shares rig.recording alone with what it tests.

Another integrator, gas that flows through ports at a finite rate, other functional forms, its own sensors. Nothing of
`model` or of the rest of the calibration is imported here (an import contract holds it). docs/second-rig.md tells what
it does, and how far it and the article's reference figures agree.

machine     the motor
concealed, instruments  effects: their laws on the motor, and on what is read
bench       what the instruments would read without noise; loaded: where the line stands under load
readout     what tachometer and gauge make of a run in time
sizes, draws, truth    what a case conceals; equipment: the line and the instruments that are drawn
live        motor and line carried on in a bench's time, behind the virtual bench's instruments
sheets, recordings     recording/1, and a further test
signatures, runs_seen, small_torques, separable  what a recording can tell apart
"""

from calibration.challenge.second_rig.draws import draw
from calibration.challenge.second_rig.recordings import another_day, follow_up, make_recording
from calibration.challenge.second_rig.separable import separable
from calibration.challenge.second_rig.truth import Truth

__all__ = ["Truth", "another_day", "draw", "follow_up", "make_recording", "separable"]
