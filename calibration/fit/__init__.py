"""The posterior of a recording's unknowns, sampled by emcee.

fit                from the plateaus of a recording to a posterior
proposed           how plateaus are sampled: polynomials propose
whole              from everything that recordings hold, runs in time too
integrated         its target: what is a run's own is integrated out
surrogate          its stand-in, which proposes
peak               where the walkers start
transport, moves   how they walk
sampling           how long
store              the chain on disk
posterior          what the chain says
document           a fit as posterior/1
"""
