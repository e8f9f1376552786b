"""Machines that are written out in their recordings: a file a kind.

system          the protocol that a kind obeys, and how the kinds are found
free_rotor      a rotor that nothing drives
driven_axis     a shaft or a slide with a measured drive
displacement_machine  a machine that turns a volume each revolution
readings, table what kinds share: arrays of readings; the motor table of their recording
problem         the unknowns, and the predictions
comparison      a recording as a vector of readings: what the diagnosis sees
noise           how large their noise is, and how alike neighbours are; noise_test: in the test for a mismatch
forces          forces of any shape
next_tests      what the tests that a machine could make would read
"""
