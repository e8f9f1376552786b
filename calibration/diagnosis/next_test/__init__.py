"""Which test would tell explanations apart that a recording cannot.

information  what a test is expected to tell
refitted     the same, by fitting explanations to the recording and the test together
recommend    the tests in their order
promised     what a test promised, against what it gave
"""
