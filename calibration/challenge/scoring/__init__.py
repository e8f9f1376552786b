"""How verdicts are held against truths.

judging, places  one case
cases            a line a case: what failed
calibrated       whether intervals, held-out gains and probabilities keep what they promise
goals            what is aimed at
scoring          all cases
"""
