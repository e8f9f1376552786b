"""Levels and plateaus, as pure functions.

plan      the levels of a sweep in their order
series    means and slopes of readings, with errors that allow for their correlation
settle    whether a reading has settled
plateau   what a plateau amounts to
"""
