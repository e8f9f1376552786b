"""The motor's equations solved.

published   the article's own algorithm, explicit steps in time
transient   in time, resolved in the crank angle (`crank_angle`, `port_edges`)
steady      the periodic state directly (compiled in steady_points); pulse: the ripple within it
averaged    in time, by the mean torque over a turn
recent      results that are asked for again
"""
