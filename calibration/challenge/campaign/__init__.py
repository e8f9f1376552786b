"""A campaign, from its draws to its verdicts.

layout    the folder of a campaign, and what is told of mistakes
sealing   the truths, encrypted, with a hash that is committed to
campaign  make: recordings and the seal
freezing  code, thresholds and versions, written down before the first verdict
running   run: a verdict a recording, the seal untouched
"""
