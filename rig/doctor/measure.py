"""Latency and rate: what a device takes, what its line bears, and what the bench file asks for."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from rig.bench.instrument import ChannelFile, Instrument
from rig.doctor.finding import Finding, Level, printable
from rig.instruments.codecs.registers import WORD_ORDERS
from rig.instruments.modbus import ModbusDevice
from rig.lines import Line, LineError, LostError
from rig.readings import NS, Quality

LONGEST_GAP_S = 0.1  # real time between two polls
MOST_FAILURES = 3  # in a row; then it is known
TIGHT = 0.7  # share of the timeout that the slow replies may take
BUSY_SHARE = 0.8  # share of a line's time that may be taken
BELOW_ALL = 1e-9
# Whole numbers of 16, 32 and 64 bits, all ones or the ends of the signed ones: a sensor that is off, or there is none.
NO_VALUE = {str(number) for bits in (16, 32, 64) for number in ((1 << bits) - 1, 1 << bits - 1, (1 << bits - 1) - 1)}
NO_VALUE |= {str(-(1 << bits - 1)) for bits in (16, 32, 64)}
MOST = 1e30  # no instrument's number lies beyond; those of bytes in a wrong order often do
LEAST = 1e-12  # share of the scale: what is less, and not 0, is often one of these too


@dataclass(frozen=True)
class Latency:
    """How long polls took.

    `p50_s`, `p99_s`: of the polls that gave a reading, on the bench's clock [s].
    `mute`: channels that gave none in any poll, and why.
    `raw`: of each channel that gave one, the last number as it came.
    `only_late`: whether every failure was one of time.
    """

    p50_s: float
    p99_s: float
    polls: int
    failures: int
    faults: str
    mute: dict[str, str]
    raw: dict[str, str]
    only_late: bool


def poll_times(line: Line, driver: Instrument, polls: int, gap_s: float) -> Latency:
    """Poll a device and take the time.

    `polls`: how many; fewer when it fails several times in a row [-].
    `gap_s`: between polls [s]; shorter where that is long in real time.
    Raises LostError when the port fails meanwhile.
    """
    times, faults, failures, in_a_row, made, only_late = [], Counter[str](), 0, 0, 0, True
    mute: dict[str, str] = {}
    heard: dict[str, str] = {}
    for _ in range(polls):
        made += 1
        start_ns = line.clock.now_ns()
        try:
            readings = driver.poll(line)
        except LostError:
            raise
        except LineError as error:
            readings = []
            faults[str(error)] += 1
        heard.update((reading.channel, reading.raw) for reading in readings if reading.usable)
        mute.update((one.channel, f"{one.quality} {one.detail}".strip()) for one in readings if not one.usable)
        took_s = (line.clock.now_ns() - start_ns) / NS
        if any(reading.usable for reading in readings):
            times.append(took_s)
            in_a_row = 0
        else:
            faults.update(f"{reading.quality} {reading.detail}".strip() for reading in readings[:1])
            only_late &= all(reading.quality is Quality.TIMEOUT for reading in readings)
            failures += 1
            in_a_row += 1
            if in_a_row == MOST_FAILURES and not times:
                break
        line.take_events()
        line.clock.sleep(min(gap_s, LONGEST_GAP_S * line.clock.rate) - took_s)
    times = times[1:] or times  # the first poll after opening asks for more, or waits for a stream to start
    p50_s, p99_s = np.quantile(times, [0.5, 0.99]) if times else (np.nan, np.nan)
    named = "; ".join(f"{printable(fault)} ({count} x)" for fault, count in faults.most_common(3))
    silent = {channel: printable(why) for channel, why in mute.items() if channel not in heard}
    return Latency(float(p50_s), float(p99_s), made, failures, named, silent, heard, only_late)


def of_device(
    device: str, identity: str, latency: Latency, period_s: float, timeout_s: float, update_s: float
) -> list[Finding]:
    """What the latency of a device means. `update_s`: the instrument's own [s]; 0 when not known."""
    if latency.failures == latency.polls:
        what = f"{identity} answers, but no poll gave a reading: {latency.faults}"
        fix = "raise timeout_s" if latency.only_late else "compare the instrument file with the device's manual"
        return [Finding(Level.FAULT, device, what, fix)]
    rates = f"asked {1 / period_s:.3g} /s, bears {1 / max(latency.p50_s, BELOW_ALL):.3g} /s"
    figures = f"latency p50 {latency.p50_s * 1e3:.1f} ms, p99 {latency.p99_s * 1e3:.1f} ms; {rates}"
    found = [Finding(Level.OK, device, f"{identity}: {figures}")]
    for channel, why in latency.mute.items():
        fix = "see whether the device shows it; if so, compare the instrument file with the device's manual"
        found.append(Finding(Level.WARNING, device, f"{channel} gave no reading: {why}", fix))
    for channel, raw in latency.raw.items():
        if raw in NO_VALUE:
            fix = f"if the device shows none, write invalid = [{raw}] at channels.{channel} in the instrument file"
            what = f"{channel} came as {raw}, which many devices send where they have no value"
            found.append(Finding(Level.WARNING, device, what, fix))
    if latency.p50_s > period_s:
        fix = f"set period_s to {np.ceil(latency.p50_s * 120) / 100:g} or more, or find what makes it slow"
        found.append(Finding(Level.FAULT, device, f"slower than asked: {rates}", fix))
    if latency.failures:
        what = f"{latency.failures} of {latency.polls} polls gave no reading: {latency.faults}"
        found.append(Finding(Level.WARNING, device, what, "check cable, termination and earth; raise timeout_s"))
    if latency.p99_s > TIGHT * timeout_s:
        what = f"the slow replies ({latency.p99_s * 1e3:.0f} ms) come close to timeout_s ({timeout_s * 1e3:.0f} ms)"
        found.append(Finding(Level.WARNING, device, what, f"set timeout_s to {np.ceil(latency.p99_s * 20) / 10:g}"))
    if update_s > period_s * 1.01:
        what = f"asked every {period_s:g} s, and the instrument makes a new value every {update_s:g} s"
        found.append(Finding(Level.WARNING, device, what, f"set period_s to {update_s:g}; the rest are repeats"))
    return found


def of_silence(device: str, latency: Latency, period_s: float, slowest_s: float, stale_s: float) -> list[Finding]:
    """Whether one lost answer ends a run: the line is silent until the slowest reply could have come, and then waits as
    long for a second answer.

    `slowest_s`: `slowest_reply_s` of the line or the device [s].
    `stale_s`: how long a run goes on without a reading [s].
    """
    gap_s = period_s + 2.0 * slowest_s
    if gap_s <= stale_s or latency.failures == latency.polls:
        return []
    what = f"one lost answer leaves {gap_s:.2g} s without a reading, and speed_stale_s ({stale_s:g} s) ends a run then"
    fix = (
        f"lower slowest_reply_s ({slowest_s:g} s; the slow replies took {latency.p99_s:.2g} s), or raise speed_stale_s"
    )
    return [Finding(Level.WARNING, device, what, fix)]


def of_line(where: str, taken: dict[str, tuple[float, float]]) -> list[Finding]:
    """Whether a line bears what is asked of it.

    `taken`: device to what a poll takes and to its period, in the same time [s].
    """
    share = sum(cost_s / period_s for cost_s, period_s in taken.values())
    parts = ", ".join(f"{device} {100 * cost_s / period_s:.0f} %" for device, (cost_s, period_s) in taken.items())
    what = f"the polls asked for take {100 * share:.0f} % of the line's time ({parts})"
    if share > 1.0:
        return [
            Finding(Level.FAULT, where, what, "raise period_s, raise the baud rate, or put a device on its own line")
        ]
    if share > BUSY_SHARE:
        return [Finding(Level.WARNING, where, what, "raise period_s: one retry and a poll is late")]
    return [Finding(Level.OK, where, what)] if taken else []


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
    keys = " or ".join(
        'word_order = "{}" and byte_order = "{}" ({})'.format(*WORD_ORDERS[order], order) for order in likely
    )
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
