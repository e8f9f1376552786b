"""The motor of the article: pure functions of SI floats and arrays. Imports neither rig nor calibration.

motor, layout     the motor's parameters, and where each figure stands in the solvers' arrays
geometry, motion  Sections 2.1 and 2.3 of the article
gas               Section 2.2, and moist air
solvers           the equations solved: as published, in time, steady
effects           what the article leaves out
operation         operating points, runs, sensitivities
article           the article's results computed anew
rigs              machines that are not this motor
"""

import os

# The solvers' threads wait asleep, not spinning: on a busy machine a spinning wait costs a hundred times the work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
