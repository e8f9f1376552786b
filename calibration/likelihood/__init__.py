"""How probable a recording's readings are at a point, and where they are most so, whatever the system.

compared    what a system is to the likelihood and the diagnosis
function    predictions of a set of effects, and their derivatives
bad_reading the law of a bad reading
mode        the most probable point, and the evidence by Laplace's approximation
descent     the search for it
linearized  the least-squares problem about a point
signatures  what each effect would do to the readings there
noise_test  the noise in the test for a mismatch
expected    what a test that nobody has made yet would read
shapes      forces and errors of any shape
tails       the prior of an effect's size
"""
