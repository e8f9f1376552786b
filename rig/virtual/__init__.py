"""The virtual bench: every instrument of a bench file served as real bytes, with the motor's transient model behind.

plant          line and motor
devices        the simulated instruments, and their faults
cables         serial lines and sockets
serve, control the process (`python -m rig.virtual BENCH --state DIR`), and the socket that asks it
launch         starts the process from Python
"""

from rig.virtual.launch import VirtualBench, VirtualBenchError, launch

__all__ = ["VirtualBench", "VirtualBenchError", "launch"]
