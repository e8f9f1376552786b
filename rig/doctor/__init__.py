"""What is wrong with a bench, and what to do: opens each port, identifies each device, measures, names the culprits.

examine   the order of the examination
measure   latency and rate of a device, what a line bears, and a number in all four orders of its bytes
trials    other baud rates, parities and addresses, where nobody answers
host      what the machine tells: ports, who holds them, programs that take them, the FTDI timer
finding   one result, and the table of them

It orders no set-point.
"""

from rig.doctor.examine import examine
from rig.doctor.finding import Finding, Level, table

__all__ = ["Finding", "Level", "examine", "table"]
