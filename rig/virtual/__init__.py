"""The virtual bench: every instrument of a bench file served as real bytes, with the motor's transient model behind.

plant          line and motor, carried on in the bench's time
sensors        what an instrument makes of the truth
served         what a simulated instrument is; served_<family>, one each
faults         the menu of what can go wrong
wires          what a cable is; terminals and sockets are the two kinds
bus            who answers on a line, and what a fault makes of the answer
serve, control the process (`python -m rig.virtual BENCH --state DIR`), and the socket that asks it
launch         starts the process from Python
person         answers like a person who reads a dial
"""

from rig.virtual.launch import VirtualBench, VirtualBenchError, launch

__all__ = ["VirtualBench", "VirtualBenchError", "launch"]
