"""Where something may be missing at the motor: what torques, flows and errors of any shape do to the readings.

coordinates     what every compared reading happened at
forces          free-form forces that a mismatch is tested with; further_forces: those that place it
balances        what may be off, and along what
terms           what a law found from the data may be made of
steps_in_time   something that is otherwise from one moment on
"""
