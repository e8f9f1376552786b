"""Rigs that are not this motor: the same motion equation and the same effects around another machine.

    state                  the operating state that the laws see, and sizes for their parameters
    free_rotor             a rotor that nothing drives: its coast-down
    driven_axis            a shaft or slide with a measured drive: its balance of momentum
    displacement_machine   a machine that turns a volume each revolution: torque and flow of its steady rows

A slide is a shaft whose angle is metres: read N for N m, m/s for rad/s and kg for kg m2.

`chosen`: a set of effects: effect id to the values of its parameters.
`clock`: time of the recording's clock at time 0 [s].
"""
