"""The posterior of a recording's unknowns, sampled by emcee.

fit                from a recording to a posterior
peak               where the walkers start
transport, moves   how they walk
sampling           how long
posterior          what the chain says, in the words of posterior/1
"""
