"""From recordings and the model to what is known of a motor.

Lowest first; a room imports those before it.

work         processes, threads and clusters that share work; the hash of the code
unknowns     every unknown and its prior
data         a recording's plateaus and runs as arrays in SI
likelihood   how probable the readings are, and where they are most so
systems      what predicts the readings
diagnosis    which physics is missing
fit          the posterior, by emcee
report       pages, pictures and words
fit_quality  whether a fit's model explains its readings; fleet: many recordings; live_checks: a sweep that still runs
challenge    sealed campaigns
studies      how far the tool's own figures hold: not part of the product
"""
