"""A sweep whose instruments a person reads, at the terminal or on paper.

entry                  what typed readings amount to (pure)
by_hand                which device a person reads
conversation, prompter talking with a person
manual                 the sweep itself
sheet, sheet_entry     the same on paper
sheet_check            a sheet held to what the prompt is held to
"""
