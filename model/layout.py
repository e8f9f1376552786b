"""Where each figure stands in the arrays that the compiled solvers take. numba treats these as constants.

A parameter set is one row in SI units, in the order of `model.motor.QUANTITIES` (a test holds the two together), with
the motor's counts at its end; the readings of the article are a row of flags.
"""

from __future__ import annotations

from configs.units import L_MIN as L_MIN
from configs.units import RPM as RPM

# Parameters.
R2_DIAMETER = 0
R3_DIAMETER = 1
R4 = 2
R5_DIAMETER = 3
R6 = 4
DP = 5
LP = 6
LAP = 7
F_R = 8
F_OVERALL = 9
J = 10
P_A = 11
T_A = 12
T_IN = 13
HUMIDITY = 14
DP_IN = 15
DP_OUT = 16
H_A = 17
D_C = 18
K_C = 19
N_SOLVER_PARAMETERS = 20  # what follows (housing diameter, speed limit) enters no equation
# Behind the motor's own parameters stand three that are no property of it. Physics that the article leaves out enters
# the solvers through the first two (model/effects). Neutral, they change no bit.
EXTRA_TORQUE = 22  # opposes the motion, beside roller friction [N m]
HEAT_FACTOR = 23  # times the heat of Eq. 18 [-]
J_ADDED = 24  # of J, a flywheel's, which the effects leave as it is [kg m2]
N_PISTONS = 25
N_LOBES = 26
N_VECTOR = 27
NEUTRAL = (0.0, 1.0, 0.0)

# Readings.
VIRTUAL_WORK = 0
WALL_AS_PRINTED = 1
FRICTION_AS_PRINTED = 2
CONSTANT_AIR = 3
HEAT_TRANSFER = 4

# Curve: what Eq. 1-10 and the counts give from the parameters.
L1 = 0
L2 = 1
L5 = 2
L6 = 3
ALPHA = 4
R5 = 5
V_OFFSET = 6  # V = Ap (L4 + V_OFFSET)
A_P = 7
HALF_LOBE = 8  # from a far point to the next near point [rad]
LOBE_ANGLE = 9  # angle of one lobe [rad]
PULSE_ANGLE = 10  # angle after which the sum of the cylinders repeats [rad]
PITCH = 11  # from one cylinder to the next [rad]
N_CURVE = 12

# Gas of one operating point: R, cp, and quartics in T for viscosity and conductivity, lowest order first.
GAS_R = 0
GAS_CP = 1
GAS_MU = 2
GAS_K = 7
N_GAS = 12
