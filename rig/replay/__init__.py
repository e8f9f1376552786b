"""Replay: the logged bytes of a run go back through the same drivers and the same acquisition.

port     a port that plays back what crossed the wire
replay   a run, exchange by exchange
compare  the samples of a run beside those of its replay
"""
