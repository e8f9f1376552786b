"""The no-load sweep: which levels, when a plateau is settled, what it amounts to, and the machine that goes through it.

plan      levels in their order
series    means, slopes and their errors from correlated readings (pure)
settle    whether readings have settled (pure)
plateau   means and standard errors of a plateau (pure)
orders    what the machine of a sweep is shown, and what it wants done
course    what a sweep goes through, and its states
judge     what the readings of a moment say (pure)
machine   goes through the course (pure)
capturing one run in time within it (pure)
runner    does what the machine wants, on a bench
capture   single runs in time, and whether the bench can resolve them
ambient   the room at the start and the end of a run
entry     what a person types in answer to a prompt (pure)
manual    a sweep whose instruments a person reads
sheet     a printed sheet, and its entry afterwards
"""
