"""The JSON that commands write, as types: `scripts/schemas.py` makes configs/schemas from them.

Numbers are SI unless a name ends in another unit. A later version may add keys, and takes none away.

parts          what several of them hold
of_recordings  what is found out of recordings: a fit, a diagnosis, a comparison, what was revealed
of_model       what the model says by itself
"""
