"""What carries the bytes: serial ports and sockets, and the timing of question and answer.

port      what a port is, and the errors of a line
serial    pyserial behind one adapter
tcp       a TCP socket
keyboard  a person at a terminal, as a port
modbus    pymodbus behind one adapter: frames to registers and back
line      question and answer: timeouts, draining
"""

from rig.lines.line import Line, Timing
from rig.lines.port import BadReplyError, LineError, LostError, NoReplyError, Port

__all__ = ["BadReplyError", "Line", "LineError", "LostError", "NoReplyError", "Port", "Timing"]
