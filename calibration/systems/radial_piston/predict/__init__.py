"""What the instruments beside the article's motor would read.

problem   a recording as the model sees it: predictions of its readings
nuisances the unknowns of motor, instruments and runs
kinds     the kinds of readings
in_time   a run in time
supply    the line between valve and motor
wheel     the tachometer's teeth
standing  what flows while the rotor stands
gauge     what the pressure gauge reads
carried   what one recording says of the unknowns of another
"""
