"""What the instruments beside the article's motor would read.

problem        the unknowns of a recording, and the model's predictions of its readings
in_time        a run in time
supply         the line between valve and motor
wheel          the tachometer's teeth
standing       what flows while the rotor stands
gauge          what the pressure gauge reads
effect_states  steady states of many sets of parameters with effects
with_effects   the effects that a fit may be asked for
"""
