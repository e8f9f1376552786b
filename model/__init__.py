"""The motor of the article: pure functions of SI floats and arrays. Imports neither rig nor calibration.

motor, layout     the motor's parameters, and where each figure stands in the solvers' arrays
geometry, motion  Sections 2.1 and 2.3 of the article
gas               Section 2.2, and moist air
solvers           the equations solved: as published, in time, steady
effects           what the article leaves out
operation         operating points, runs, sensitivities
article           the article's results computed anew
rigs              machines that are not this motor

What means the same in the whole package is told here; a function tells only what is special to it. So it is with what
a package or a module of this one tells at its top.

`motor`: the motor.
`parameters`, shape (27,): one parameter set [SI], in the order of `layout`.
`readings`, shape (5,): which equations are read as printed, and which not: `motor.Readings.vector`.
`gas`, shape (12,): gas of an operating point, of `gas.cylinder.gas_state`.
`c`, shape (12,): the guide curve, of `geometry.curve`.
`P_in`: absolute inlet pressure [Pa].
`pressures`, shape (n,): absolute inlet pressures [Pa].
`ambient`: ambient pressure [Pa].
`A_p`: piston area [m2].
`f_r`: roller friction factor [-].
`friction`: viscous coefficient f_overall [N m s].
`omega`: angular velocity [rad/s].
"""

import os

# The solvers' threads wait asleep, not spinning: on a busy machine a spinning wait costs a hundred times the work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
