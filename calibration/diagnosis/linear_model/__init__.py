"""Columns of the linear model about a point: what each cause would do to the readings.

signatures      each listed effect
forces          a torque or a flow of any shape; further_forces: more of them, and errors of instruments
balances        the same, sorted by the balance that they disturb
coordinates     speed, pressure, flow, time, direction and angle at each reading
terms           terms of which a law may be made
"""
