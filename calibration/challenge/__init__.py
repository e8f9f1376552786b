"""Sealed blind campaigns, and their score.

layout     the folder of a campaign, and what is told of mistakes
sealing    the truths, encrypted, with a hash that is committed to
campaign   make: recordings and the seal
freezing   code, thresholds and versions, written down before the first verdict
running    run: a verdict a recording, the seal untouched
judging, places, intervals: one case, and how shares of cases are counted
scoring    all cases: tables as plain data
opening    score: the seal is opened last, and the campaign enters the ledger
ledger     every scored campaign, a line each, chained by hashes
tables, figures, page: what a person reads
second_rig the rig that makes the recordings; shares rig.recording alone with what it tests
"""
