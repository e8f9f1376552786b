"""Sealed blind campaigns, and their score.

campaign    made, sealed, frozen and run
scoring     held against the truths; intervals: shares of cases with their intervals
record      the ledger, and what is kept
pages       what a person reads
concealed   a virtual bench that conceals something
second_rig  the rig that makes the recordings; shares rig.recording alone with what it tests
"""
