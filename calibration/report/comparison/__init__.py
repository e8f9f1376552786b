"""The report of what changed between two recordings, and the trend of many."""
