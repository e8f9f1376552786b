"""How probable a recording's readings are at a point, and where they are most so.

steady, rows  the fit's likelihood: speed and flow of the plateaus, the pressure an uncertain input
linear      the diagnosis' readings and predictions as one vector, and its whitening
noise       how large the noise is, and how long it lasts
function    predictions of a set of effects, and their derivatives
mode        the most probable point, and the evidence by Laplace's approximation
descent     the search for it
linearized  the least-squares problem about a point
tails       the prior of an effect's size
carried     what one recording says of the unknowns of another
"""
