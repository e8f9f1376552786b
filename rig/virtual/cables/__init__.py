"""Cables of the virtual bench, and who answers on them.

wires      what a cable is; terminals and sockets are the two kinds
bus        who is meant on a line, and what a fault makes of the answer
loop       one thread for all of them
"""
