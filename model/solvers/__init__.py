"""The motor's equations solved.

published   the article's own algorithm, explicit steps in time
transient   in time, resolved in the crank angle (`crank_angle`, `port_edges`)
steady      the periodic state directly (compiled in steady_points); pulse: the ripple within it
averaged    in time, by the mean torque over a turn
recent      results that are asked for again

Kernels take their arrays one by one, however many: numba counts the references to what a tuple holds at every call,
which costs a short kernel a fifth of its time (`effects.averaged._rate`). Some are long, where parts that share a
dozen running values would have to hand them to and fro. They divide as numpy does: without a look at every divisor they
take a sixth less time, and what comes out of a division by 0 is told by its state, as what does not converge is.

`y`, shape (9 + 2 n,): state of the motor [SI], laid out as in `crank_angle`, of a motor with n cylinders.
`work`, shape (6, 9 + 2 n): rates k1..k4 (``work[0]`` the rate at the start), the state at the end, and scratch.
`port`, shape (n,): which port each cylinder sees: OUTLET, INLET or CLOSED.
`sense`: direction of motion that friction opposes, +1 or -1 [-].
`T_port`, shape (2,): temperature behind outlet and inlet [K].
`refine`: steps between two neighbouring edges [-]; more for smaller errors.
"""
