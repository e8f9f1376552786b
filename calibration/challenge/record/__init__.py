"""What is kept of campaigns.

opening   score: the seal is opened last, and the campaign enters the ledger
ledger    every scored campaign, a line each, chained by hashes
keeping   scored campaigns as files, and counting them together
"""
