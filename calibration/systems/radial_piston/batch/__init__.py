"""The fit's likelihood: many sets of parameters at once, compiled.

likelihood   speed and flow of the plateaus, the pressure an uncertain input
rows         of single rows
polynomials  speed and flow, cheaply, in the place of the model
states       steady states of many sets of parameters with effects
effects      the effects that a fit may be asked for
"""
