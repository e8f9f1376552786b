"""The motor's equations solved.

published   the article's own algorithm, explicit steps in time
transient   in time, resolved in the crank angle
steady      the periodic state directly; pulse: the ripple within it
averaged    in time, by the mean torque over a turn
recent      results that are asked for again
"""
