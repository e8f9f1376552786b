"""Replay: the logged bytes of a run go back through the same drivers and the same acquisition.

port     a port that plays back what crossed the wire
player    a run, exchange by exchange; channels: what its samples are compared in
replaying a run beside its replay, sample by sample
saving    mended instrument files, and the replay as a run of its own
"""
