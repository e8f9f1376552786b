"""A number of several registers in all four orders of its bytes, for a person to see which is right."""

from __future__ import annotations

import math

from rig.bench.instrument import ChannelFile, Instrument
from rig.doctor.finding import Finding, Level
from rig.instruments.codecs.registers import ORDERS
from rig.instruments.modbus import ModbusDevice
from rig.lines import Line, LineError, LostError

MOST = 1e30  # no instrument's number lies beyond; those of bytes in a wrong order often do
LEAST = 1e-12  # share of the scale: what is less, and not 0, is often one of these too


def of_orders(line: Line, device: str, driver: Instrument) -> list[Finding]:
    """What a generic Modbus device reads in each order; nothing of others. Raises LostError when the port fails."""
    if not isinstance(driver, ModbusDevice):
        return []
    try:
        shown = driver.in_all_orders(line)
    except LostError:
        raise
    except LineError:
        return []  # its polls tell
    if shown is None:
        return []
    channel = driver.channels[shown.channel]
    readings = ", ".join(f"{value:g} as {order}" for order, value in shown.values.items())
    what = f"{shown.channel} ({shown.registers}) in {channel.unit}: {readings}; the file has {shown.chosen}"
    level = _level(shown.values[shown.chosen], channel)
    if level is Level.OK:
        return [Finding(level, device, what)]
    likely = [order for order, value in shown.values.items() if _level(value, channel) is Level.OK]
    keys = " or ".join('word_order = "{}" and byte_order = "{}" ({})'.format(*ORDERS[order], order) for order in likely)
    fix = f"if one of these is what the device shows, write {keys}" if keys else "compare its address and type with"
    where = f"at channels.{shown.channel} in the instrument file" if keys else "the device's manual"
    return [Finding(level, device, f"{what}, which is no reading on its scale", f"{fix} {where}")]


def _level(value: float, channel: ChannelFile) -> Level:
    """A fault far outside the scale, or where no instrument's number is; a warning just outside, or a breath from 0."""
    if not math.isfinite(value) or abs(value) > MOST:
        return Level.FAULT
    lowest = -math.inf if channel.lowest is None else channel.lowest
    highest = math.inf if channel.highest is None else channel.highest
    ends = [abs(end) for end in (lowest, highest) if math.isfinite(end)]
    span = highest - lowest if len(ends) == 2 else max(ends, default=1.0)
    beyond = max(lowest - value, value - highest)
    if beyond > 0.0:
        return Level.FAULT if beyond > span else Level.WARNING
    return Level.WARNING if 0.0 < abs(value) < LEAST * span else Level.OK
