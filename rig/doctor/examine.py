"""The examination of a bench: line by line, device by device."""

from __future__ import annotations

from collections.abc import Sequence

from rig.acquisition.opening import line_of, port_of
from rig.acquisition.worker import BUSY_S, BUSY_TRIES
from rig.bench.bench import Bench, LineTable
from rig.bench.instrument import IdentityError, Instrument, InstrumentError
from rig.clock import Clock
from rig.doctor import host as machine
from rig.doctor import measure, trials
from rig.doctor.finding import Finding, Level, printable
from rig.doctor.host import Host
from rig.doctor.measure import of_orders
from rig.doctor.trials import Ports
from rig.instruments import ascii as ascii_family
from rig.instruments.polling import Polled
from rig.lines import Line, LineError, LostError, NoReplyError
from rig.lines.line import LEAST_REAL_WAIT_S
from rig.lines.modbus import RefusedError
from rig.readings import Quality

POLLS = 30
MOST_SHOWN = 40  # bytes that came and are no answer
# How an answer begins that is of another service than an instrument's, and what that is.
SERVICES = {b"HTTP/": "web pages (HTTP)", b"<!DOCTYPE": "web pages", b"<html": "web pages", b"SSH-": "a shell (SSH)"}
SERVICES |= {b"220 ": "files or mail (FTP, SMTP)", b"RFB ": "a screen (VNC)"}

# What to look at in the instrument file, by the code of the exception.
WHERE_REFUSED = {
    1: "; see registers: input or holding",
    2: "; see each address: on the wire they count from 0, so that a manual's 40001 or 30001 is 0; registers; and "
    "largest_gap = 0, if it has none between those that the file names",
    3: "; see most_registers: it may take fewer in one question",
}


def examine(
    bench: Bench,
    ports: Ports | None = None,
    clock: Clock | None = None,
    host: Host | None = None,
    polls: int = POLLS,
    scan_units: Sequence[int] = (),
) -> list[Finding]:
    """Open each port, identify each device, measure, and name what is known to go wrong.

    `ports`: from a line's name, its table and the clock to its port; the ports of the bench file when left out.
    `clock`: the bench's; real time when left out.
    `host`: the machine; this one when left out.
    `scan_units`: Modbus addresses to try where a device does not answer [-].
    Returns the machine first, then each line and its devices, in the order of the bench file.
    """
    examination = _Examination(bench, ports or port_of, clock or Clock(), host or Host(), polls, tuple(scan_units))
    found = []
    if any(table.kind == "serial" and table.port != "virtual" for table in bench.file.lines.values()):
        found += machine.of_programs(examination.host)
    for name, table in bench.file.lines.items():
        found += examination.of_line(name, table)
    return found


class _Examination:
    """What every step of one examination needs."""

    def __init__(
        self, bench: Bench, ports: Ports, clock: Clock, host: Host, polls: int, scan_units: tuple[int, ...]
    ) -> None:
        self.bench, self.ports, self.clock, self.host = bench, ports, clock, host
        self.polls, self.scan_units = polls, scan_units

    def of_line(self, name: str, table: LineTable) -> list[Finding]:
        """Everything about a line."""
        where = f"line {name}"
        devices = [device for device, of_device in self.bench.file.devices.items() if of_device.line == name]
        if not devices:
            return [Finding(Level.WARNING, where, "no device is on it", "delete it from the bench file")]
        if table.kind == "keyboard":
            return [Finding(Level.OK, where, f"a person reads its instruments: {', '.join(devices)}")]
        port = self.ports(name, table, self.clock)
        path = str(getattr(port, "path", table.port)) if table.kind == "serial" else ""
        if "virtual" in (path, getattr(port, "host", "")):
            return [Finding(Level.FAULT, where, "it is virtual, and no virtual bench was started for the examination")]
        is_hardware = self.bench.file.virtual is None  # a virtual bench has its own ports open
        found = machine.of_port(self.host, where, path) if path and is_hardware else []
        line = line_of(name, table, port, self.clock)
        try:
            line.open()
        except LostError as error:
            if path and not any(finding.level is Level.FAULT for finding in found):
                found.append(machine.why_closed(self.host, where, path, error))
            elif not path:
                found.append(Finding(Level.FAULT, where, printable(str(error)), "check power, cable and address"))
            return found
        try:
            found += self._of_devices(line, table, devices)
        except LostError as error:
            other = _service(_heard(line), table)
            fix = "check power, cable and address" if table.kind == "tcp" else "plug it in again; try another cable"
            found.append(Finding(Level.FAULT, where, other or printable(str(error)), _WRONG_PORT if other else fix))
        finally:
            line.close()
        return found

    def _of_devices(self, line: Line, table: LineTable, devices: list[str]) -> list[Finding]:
        found: list[Finding] = []
        taken: dict[str, tuple[float, float]] = {}
        silent: dict[str, tuple[LineError, bytes]] = {}
        for device in devices:
            driver = self.bench.build(device)
            line.take_events()
            try:
                identity = printable(_identified(line, driver)) or "a device"
            except LostError:
                raise
            except IdentityError as error:
                fix = "correct the bench file, or swap cables or addresses"
                found.append(Finding(Level.FAULT, device, f"another device answers: {printable(str(error))}", fix))
            except (RefusedError, InstrumentError) as error:
                found.append(_refusal(device, error))
            except ascii_family.DecimalMarkError as error:
                found.append(Finding(Level.FAULT, device, f"answers, but {printable(str(error))}", error.fix))
            except LineError as error:
                silent[device] = (error, _heard(line))
            else:
                findings, cost_s = self._measured(line, device, driver, identity)
                found += findings + of_orders(line, device, driver)
                if cost_s is not None:
                    taken[device] = (cost_s, self.bench.file.devices[device].period_s)
        found += [Finding(Level.WARNING, f"line {line.name}", text) for text in line.take_remarks()]
        line.close()
        found += self._of_silent(table, silent, anyone=len(silent) < len(devices))
        return found + measure.of_line(f"line {line.name}", taken)

    def _measured(
        self, line: Line, device: str, driver: Instrument, identity: str
    ) -> tuple[list[Finding], float | None]:
        settings, of_device = self.bench.instruments[device], self.bench.file.devices[device]
        latency = measure.poll_times(line, driver, self.polls, of_device.period_s)
        timeout_s = settings.timeout_s or self.bench.file.lines[of_device.line].timeout_s
        if self.clock.rate > 1.0:
            timeout_s = max(timeout_s, LEAST_REAL_WAIT_S * self.clock.rate)
        found = measure.of_device(device, identity, latency, of_device.period_s, timeout_s, settings.update_s)
        roles = self.bench.file.roles
        is_watched = device in {role.partition(".")[0] for role in (roles.pressure, roles.speed)}
        is_asked = isinstance(driver, Polled) and bool(getattr(settings, "query", True))
        if is_watched and is_asked and self.clock.rate <= 1.0:
            slowest_s = max(
                timeout_s, settings.slowest_reply_s or self.bench.file.lines[of_device.line].slowest_reply_s
            )
            stale_s = self.bench.file.safety.speed_stale_s
            found += measure.of_silence(device, latency, of_device.period_s, slowest_s, stale_s)
        return found, latency.p50_s if latency.failures < latency.polls else None

    def _of_silent(self, table: LineTable, silent: dict[str, tuple[LineError, bytes]], anyone: bool) -> list[Finding]:
        """Devices that gave no answer: a wrong setting when the whole line is dumb, else address or power."""
        if other := _service(b"".join(heard for _, heard in silent.values()), table):
            return [Finding(Level.FAULT, device, other, _WRONG_PORT) for device in silent]
        return [self._of_one_silent(table, device, *heard, anyone=anyone) for device, heard in silent.items()]

    def _of_one_silent(self, table: LineTable, device: str, error: LineError, heard: bytes, anyone: bool) -> Finding:
        said = f"bytes come, but no answer: {error}" if heard else f"nobody answers: {error}"
        name, unit = self.bench.file.devices[device].line, self.bench.file.devices[device].unit_id
        settings = self.bench.instruments[device]
        swapped = "" if table.kind == "tcp" else " (A and B swapped?)"
        fix = f"check power, cable{swapped} and the address"
        has_others = unit is not None if table.kind == "tcp" else table.kind == "serial" and table.paced
        if has_others and not anyone:
            too_old, too_slow = error.quality is Quality.STALE, bool(heard) and isinstance(error, NoReplyError)
            right = trials.other_settings(self.bench, device, self.ports, self.clock, too_old, too_slow)
            if right is not None:
                how, key, value = _difference(table, right)
                what = printable(f"{said}. It answers {how}")
                return Finding(Level.FAULT, device, what, f"write {key} = {value} into [lines.{name}]")
            said += f". It answers at no other of the usual settings either ({_tried(table)})"
        if heard and isinstance(settings, ascii_family.Settings):
            ending = ascii(settings.terminator)
            said += f". What came: {heard[-MOST_SHOWN:].decode('latin-1')!a}"
            fix = f"compare it with pattern and terminator ({ending}) in the instrument file; where garbled, see baud"
        if self.scan_units and unit is not None:
            others = trials.other_units(self.bench, device, self.scan_units, self.ports, self.clock)
            said += f". Not unit {unit}, but unit {', '.join(map(str, others))} answers" if others else ""
            fix = f"write unit_id = {others[0]} into [devices.{device}]" if others else fix
        elif unit is not None:
            fix += "; a scan of a few addresses finds a wrong unit_id"
        return Finding(Level.FAULT, device, printable(said), fix)


_WRONG_PORT = "check host and tcp_port of the line; Modbus TCP is at 502 by custom"


def _heard(line: Line) -> bytes:
    """What came over a line since its events were taken last."""
    return b"".join(event.data for event in line.take_events() if event.kind == "rx")


def _service(heard: bytes, table: LineTable) -> str:
    """Which other service answers at a socket, in words; empty where none is known by its answer."""
    kind = next((kind for begin, kind in SERVICES.items() if heard.lower().startswith(begin.lower())), "")
    if not kind or table.kind != "tcp":
        return ""
    first = printable(heard.splitlines()[0].decode("ascii", "replace"))[:60]
    return f"{table.host}, port {table.tcp_port}, answers “{first}”: it serves {kind}, and no instrument"


def _identified(line: Line, driver: Instrument) -> str:
    """Who answers; a device that says it is busy is asked again, as at the start of a run."""
    for _ in range(BUSY_TRIES):
        try:
            driver.open(line)
            return driver.identify(line)
        except RefusedError as error:
            if not error.is_busy:
                raise
        line.clock.sleep(BUSY_S * line.clock.rate)
    return driver.identify(line)


def _refusal(device: str, error: Exception) -> Finding:
    if isinstance(error, RefusedError) and error.is_busy:
        what = f"it is busy, {BUSY_TRIES + 1} times: {printable(str(error))}"
        return Finding(Level.FAULT, device, what, error.while_busy)
    fix = "it is another model, or set up in another way, than the instrument file says"
    if isinstance(error, RefusedError):
        fix += WHERE_REFUSED.get(error.code, "")
    return Finding(Level.FAULT, device, f"answers, but refuses: {printable(str(error))}", fix)


def _difference(table: LineTable, right: LineTable) -> tuple[str, str, str]:
    """How a device answers, in words, and the key and value that say so."""
    if right.transaction_numbers != table.transaction_numbers:
        return "with other transaction numbers than the questions'", "transaction_numbers", '"any"'
    if right.timeout_s != table.timeout_s:
        how = f"when it is given {right.timeout_s:g} s"
        return how, "timeout_s", f"{right.timeout_s:g} and slowest_reply_s = {right.slowest_reply_s:g}"
    if right.paced != table.paced:
        return "sooner than its bytes can cross the wire at this baud rate, as over USB", "paced", "false"
    if table.kind == "tcp":
        return f"with framing {right.framing}", "framing", f'"{right.framing}"'
    how = f"at {right.baud} baud, parity {right.parity}, {right.data_bits} data bits"
    if right.data_bits != table.data_bits:
        return how, "data_bits", f'{right.data_bits} and parity = "{right.parity}"'
    return (how, "baud", str(right.baud)) if right.baud != table.baud else (how, "parity", f'"{right.parity}"')


def _tried(table: LineTable) -> str:
    if table.kind == "tcp":
        return "the other framing of Modbus"
    bauds = ", ".join(str(baud) for baud in sorted(trials.BAUDS) if baud != table.baud)
    return f"{bauds} baud; parity {' and '.join(p for p in trials.PARITIES if p != table.parity)} at {table.baud}"
