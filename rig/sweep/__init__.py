"""The sweep: which levels, when a plateau is settled, what it amounts to, and who goes through it.

orders, course, judge, capturing, machine     the states of a sweep, what it is shown and what it wants (pure)
hooks     who else has a part: guard, limits, operator, audience
runner    the machine's orders carried out on a bench
capture   whether the bench can resolve a run in time
ambient   the room at the start and the end
continuing  what a sweep that was broken off has taken already
planning  from a bench file to a course
"""
