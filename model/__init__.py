"""The motor of the article: pure functions of SI floats and arrays. Imports neither rig nor calibration."""

import os

# The solvers' threads wait asleep, not spinning: on a busy machine a spinning wait costs a hundred times the work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
