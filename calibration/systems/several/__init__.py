"""Several recordings of one motor, each with its own day: one vector of readings, one posterior.

The motor's own unknowns and the effects are shared, unless an effect was asked to be each recording's own. Of each
recording alone are its ambient, the errors of its instruments, its supply, the angles at which its runs begin, and its
noise.

sharing     of which effects each recording has its own sizes
problem     the unknowns, and the predictions
places      where something may be missing in them
noise       each recording's noise, and the map that it sets
comparison  the recordings as one vector: what the diagnosis sees
taken       recordings and a test that nobody has taken yet, as one vector
"""
