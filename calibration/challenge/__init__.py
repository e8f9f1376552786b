"""Sealed blind campaigns, and their score.

layout     the folder of a campaign, and what is told of mistakes
sealing    the truths, encrypted, with a hash that is committed to
campaign   make: recordings and the seal
freezing   code, thresholds and versions, written down before the first verdict
running    run: a verdict a recording, the seal untouched
cases      a line a case: what failed, and the table of all
judging, places, intervals: one case, and how shares of cases are counted
calibrated whether intervals, held-out gains and probabilities keep what they promise
goals      what is aimed at
scoring    all cases: tables as plain data
opening    score: the seal is opened last, and the campaign enters the ledger
ledger     every scored campaign, a line each, chained by hashes
keeping    scored campaigns as files, and counting them together
tables, figures, page: what a person reads
concealed_bench, revealing  a virtual bench with the second rig behind its instruments, sealed, and its seal opened
second_rig the rig that makes the recordings; shares rig.recording alone with what it tests
"""
