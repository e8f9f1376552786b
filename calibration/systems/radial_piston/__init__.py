"""The article's motor as a system: what the instruments beside it would read, and what the diagnosis asks of it.

comparison   a recording as a vector of readings: what the diagnosis sees
noise        how large their noise is, and how long it lasts
base         the base model's search; run_starts: where a run in time may start; valley: where the good fits lie
derivatives  what needs no simulation
not_described  whether the base model describes the readings at all
predict      the unknowns of a recording, and the model's predictions of its readings
places       torques, flows and errors of any shape, and the law that may be in them
next_tests   tests that its bench could make
batch        the fit's likelihood of many sets of parameters at once
"""
