"""The steps of a diagnosis, each from values to a value.

detect        whether anything is missing
locate        where: balance, channel and coordinate; correction: the smooth curve that closes a balance
search, name  which set of effects explains it, and how sets are weighed
residual      what a set leaves unexplained
confirm       whether the set predicts readings that it has not seen; unseen: those of another run
discover      what a mismatch looks like that no listed effect explains
unexplained   what stands in the place of a name
abrupt        what is otherwise from one moment on
misread       readings that are taken for bad
verdict       what may be said of a candidate, a set of effects that was weighed
"""
