"""Where nobody answers: other baud rates and parities on a serial line, the other framing, other addresses on a bus.

Only what opens and identifies a device is sent, the same as at the start of a run; no set-point is ordered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from configs import ConfigError
from rig.acquisition.opening import line_of
from rig.bench.bench import Bench, LineTable, Place
from rig.bench.instrument import IdentityError, Instrument, InstrumentError
from rig.clock import Clock
from rig.lines import LineError, Port
from rig.lines.modbus import RefusedError

BAUDS = (9600, 19200, 38400, 57600, 115200, 4800, 2400, 1200)
PARITIES = ("N", "E", "O")
PATIENT_S = 3.0  # for an answer
OTHER_BITS = {7: 8, 8: 7}

Ports = Callable[[str, LineTable, Clock], Port]


def other_settings(
    bench: Bench, device: str, ports: Ports, clock: Clock, too_old: bool = False, too_slow: bool = False
) -> LineTable | None:
    """The line's table with which a device answers: another baud rate or parity, or of a socket another framing of
    Modbus; None when it does with none.

    `too_old`: whether its answers were taken for old ones, by their transaction numbers or since they came too soon;
        that the line is to be read otherwise is tried first.
    `too_slow`: whether bytes came, but no whole answer in time; a longer time is tried first.
    """
    name = bench.file.devices[device].line
    table = bench.file.lines[name]
    candidates: list[dict[str, Any]]
    if table.kind == "tcp":
        candidates = [{"transaction_numbers": "any"}] if too_old and table.transaction_numbers == "checked" else []
        candidates += [{"framing": "tcp" if table.framing == "rtu" else "rtu"}]
    else:
        candidates = [{"paced": False}] if too_old else []
        candidates += [{"baud": baud} for baud in BAUDS if baud != table.baud]
        candidates += [{"parity": parity} for parity in PARITIES if parity != table.parity]
        other_bits = OTHER_BITS[table.data_bits]
        candidates += [{"data_bits": other_bits, "parity": parity} for parity in ("E", "O", "N")]
    if too_slow and table.timeout_s < PATIENT_S:
        candidates.insert(0, {"timeout_s": PATIENT_S, "slowest_reply_s": max(PATIENT_S, table.slowest_reply_s)})
    for change in candidates:
        changed = table.model_copy(update=change)
        try:
            driver = bench.build(device, Place(bench.file.devices[device], changed))
        except ConfigError:  # a device that cannot be on such a line
            continue
        if _answers(driver, name, changed, ports, clock):
            return changed
    return None


def other_units(bench: Bench, device: str, units: Sequence[int], ports: Ports, clock: Clock) -> list[int]:
    """The Modbus addresses, of some that no device of the line has, at which somebody answers, whoever it is."""
    of_device = bench.file.devices[device]
    table = bench.file.lines[of_device.line]
    taken = {other.unit_id for other in bench.file.devices.values() if other.line == of_device.line}
    found = []
    for unit in units:
        changed = of_device.model_copy(update={"unit_id": unit})
        if unit not in taken and _answers(
            bench.build(device, Place(changed, table)), of_device.line, table, ports, clock
        ):
            found.append(unit)
    return found


def _answers(driver: Instrument, name: str, table: LineTable, ports: Ports, clock: Clock) -> bool:
    """Whether somebody answers, be it another device or a refusal."""
    line = line_of(name, table, ports(name, table, clock), clock)
    try:
        line.open()
        driver.open(line)
        driver.identify(line)
    except (IdentityError, RefusedError, InstrumentError):
        return True
    except LineError:
        return False
    finally:
        line.close()
    return True
