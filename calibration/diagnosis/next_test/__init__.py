"""Which test would tell explanations apart that a recording cannot.

planned      tests that this bench could make
quantities   single quantities, and the instrument that reads each
information  what a test is expected to tell
recommend    the tests in their order
"""
