"""A run on a bench or a virtual one, from its start record to its seal, and the person at the terminal.

running    one run, with everything of the rig
place      the bench's ports and clock; a virtual one is started
terminal   a bar, and questions
"""
