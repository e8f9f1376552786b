"""From a line's table in the bench file to a line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.clock import Clock
from rig.lines.line import Line, Timing
from rig.lines.port import Port
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort

if TYPE_CHECKING:
    from rig.bench.bench import LineTable


def port_of(name: str, table: LineTable, clock: Clock) -> Port:
    """The port that a line's table describes, not opened yet."""
    if table.kind == "serial":
        return SerialPort(table.port, clock, table.baud, table.parity, table.stop_bits, table.data_bits)
    if table.kind == "tcp":
        return TcpPort(table.host, table.tcp_port, clock)
    from rig.lines.keyboard import KeyboardPort

    return KeyboardPort(clock)


def line_of(name: str, table: LineTable, port: Port, clock: Clock) -> Line:
    """A line with the times that its table says."""
    return Line(name, port, clock, timing_of(table))


def timing_of(table: LineTable) -> Timing:
    """The times of a line."""
    bits = 1 + table.data_bits + (table.parity != "N") + table.stop_bits
    byte_s = bits / table.baud if table.kind == "serial" and table.paced else 0.0
    # Modbus RTU separates frames by 3.5 characters of silence; no line is drained for less than 5 ms
    return Timing(table.timeout_s, table.slowest_reply_s, max(0.005, 3.5 * byte_s), byte_s)
