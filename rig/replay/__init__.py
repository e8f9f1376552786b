"""Replay: the logged bytes of a run go back through the same drivers and the same acquisition.

player    a run, exchange by exchange, over a port that plays its bytes back; channels: what its samples are compared in
replaying a run beside its replay, sample by sample
saving    mended instrument files, and the replay as a run of its own
"""
