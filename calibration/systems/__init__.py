"""What predicts the readings of a recording, a kind of machine each.

radial_piston         the article's motor, in a folder of its own
free_rotor            a rotor that nothing drives
driven_axis           a shaft or a slide with a measured drive
displacement_machine  a machine that turns a volume each revolution
system                the protocol that the last three obey, and how they are found
readings, table       what these three share: readings and unknowns; the motor table of their recording
"""
