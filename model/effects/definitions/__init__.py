"""The effects, a file each: its law, parameters, bounds and source.

`p`: values of the parameters that the module's ``EFFECT`` lists, each in the unit of its name.
`true`, shape (n,): the true value of what the instrument reads: pressure [Pa], flow [m3/s] or speed [rad/s].
"""
