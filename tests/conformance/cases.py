"""What is asked of our devices by other people's clients, and of other people's devices by our drivers."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rig.acquisition.opening import line_of
from rig.bench.bench import DeviceTable, LineTable, Place, bench_of
from rig.clock import Clock
from rig.instruments import modbus
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort
from rig.readings import Quality
from tests.conformance import clients, libmodbus, opcua
from tests.conformance.clients import Missing, Refused, Silent
from tests.virtual_benches import ADAM, FLOW, KELLER, serving

CLIENTS = {
    "libmodbus": libmodbus.Libmodbus,
    "mbpoll": clients.Mbpoll,
    "pymodbus": clients.Pymodbus,
    "minimalmodbus": clients.MinimalModbus,
    "modbus-tk": clients.ModbusTk,
    "umodbus": clients.UModbus,
    "simonvetter/modbus": clients.GoModbus,
}
METER, FLOAT, OUTPUTS, NOBODY = 17, 18, 2, 40
COMMON = 'format = "instrument/1"\nsource = "test"\ntrust = "simulated"\n'
METER_FILE = f"""{COMMON}
title = "meter"
family = "modbus"
[channels.speed_rpm]
unit = "rpm"
address = 0
type = "u16"
[channels.temperature_c]
unit = "degC"
address = 124
type = "u16"
[[expect]]
address = 10
values = [1234]
meaning = "a constant"
[[expect]]
address = 11
values = [65535]
meaning = "another"
[[expect]]
address = 10
registers = "input"
values = [4321]
meaning = "an input"
[setpoint]
address = 300
type = "u16"
unit = "bar gauge"
scale = 0.001
lowest = 0.0
highest = 3.0
"""
FLOAT_FILE = f"""{COMMON}
title = "regulator"
family = "modbus"
[channels.speed_rpm]
unit = "rpm"
address = 0
type = "u16"
[setpoint]
address = 300
type = "f32"
unit = "bar gauge"
lowest = 0.0
highest = 3.0
"""
BENCH = """
format = "bench/1"
title = "conformance"
[ambient]
pressure_bar_abs = 1.01325
temperature_c = 20.0
relative_humidity = 0.5
[roles]
pressure = "gauge.pressure_bar_abs"
flow = "flowmeter.flow_sl_min"
speed = "{line}_meter.speed_rpm"
[sweep]
levels_bar_abs = [2.0]
[lines.{line}]
{table}
[lines.other]
kind = "tcp"
host = "virtual"
[devices.gauge]
instrument = "gauge"
line = "other"
unit_id = 1
[devices.flowmeter]
instrument = "flow"
line = "other"
unit_id = 2
[devices.{line}_meter]
instrument = "meter"
line = "{line}"
unit_id = 17
[devices.{line}_regulator]
instrument = "float"
line = "{line}"
unit_id = 18
[devices.{line}_outputs]
instrument = "outputs"
line = "{line}"
unit_id = 2
channel = 0
span = [0.0, 5.0]
[virtual]
"""
TABLES = {
    "rtu": 'kind = "serial"\nport = "virtual"\nbaud = 19200',
    "tcp": 'kind = "tcp"\nhost = "virtual"',
}
TWO_BAR = [0x4000, 0x0000]  # 2.0 as a float of two registers
# case: question to a client, and what it must give: values, or why none
CLIENT_CASES = {
    "two holding registers": (lambda c: c.read(METER, "holding", 10, 2), [1234, 65535]),
    "an input register": (lambda c: c.read(METER, "input", 10, 1), [4321]),
    "125 registers": (lambda c: c.read(METER, "holding", 0, 125)[10:12], [1234, 65535]),
    "four coils": (lambda c: c.read(OUTPUTS, "coils", 0, 4), [0, 0, 0, 0]),
    "one register written": (
        lambda c: (c.write(METER, 300, [1500], False), c.read(METER, "holding", 300, 1))[1],
        [1500],
    ),
    "two registers written": (
        lambda c: (c.write(FLOAT, 300, TWO_BAR, True), c.read(FLOAT, "holding", 300, 2))[1],
        TWO_BAR,
    ),
    "no such function": (lambda c: c.read(METER, "discrete", 0, 1), "exception 1"),
    "no such register": (lambda c: c.read(METER, "holding", 500, 1), "exception 2"),
    "a value out of bounds": (lambda c: c.write(METER, 300, [3001], False), "exception 3"),
    "no such unit": (lambda c: c.read(NOBODY, "holding", 10, 1), "silence"),
    "the next question after silence": (lambda c: c.read(METER, "holding", 10, 2), [1234, 65535]),
}


@dataclass(frozen=True)
class Result:
    """What came of a case. `got`: as it should be, where it is what is `wanted`."""

    who: str
    line: str
    case: str
    wanted: str
    got: str

    @property
    def is_as_it_should_be(self):
        return self.got == self.wanted


def of_client(name, line, cases=tuple(CLIENT_CASES)):
    """The results of a client's questions to our virtual devices; raises `Missing`."""
    files = {"gauge": KELLER, "outputs": ADAM, "flow": FLOW, "meter": METER_FILE, "float": FLOAT_FILE}
    sources = {f"instruments/{file}.toml": text.encode() for file, text in files.items()}
    text = BENCH.format(line=line, table=TABLES[line])
    bench = bench_of("conformance", {"bench.toml": text.encode(), **sources}, "conformance.toml")
    with tempfile.TemporaryDirectory(prefix="conformance-") as folder, serving(bench, Path(folder), 1.0) as served:
        address = served.ports["lines"][line]
        place = clients.Place(address["port"]) if line == "rtu" else clients.Place(tcp_port=address["tcp_port"])
        client = CLIENTS[name](place)
        try:
            asked = {case: CLIENT_CASES[case] for case in cases}
            return [Result(name, line, case, str(wanted), _got(ask, client)) for case, (ask, wanted) in asked.items()]
        finally:
            client.close()


def _got(ask, client):
    try:
        return str(ask(client))
    except Refused as error:
        return str(error)
    except Silent:
        return "silence"


PLAIN, HELD = 20, str(libmodbus.held(20))
# case: register that the driver reads first, the line's timeout [s], and what it must find in it
DEVICE_CASES = {
    "an ordinary register": (PLAIN, 0.3, HELD),
    "busy": (libmodbus.BUSY_AT, 0.3, "exception"),
    "no such register": (libmodbus.MISSING_AT, 0.3, "exception"),
    "another's transaction number, or unit": (libmodbus.OTHER_AT, 0.3, "none"),
    "an answer after 0.5 s, waited for 0.3 s": (libmodbus.SLOW_AT, 0.3, "none"),
    "an answer after 0.5 s, waited for 1 s": (libmodbus.SLOW_AT, 1.0, str(libmodbus.held(libmodbus.SLOW_AT))),
    "a byte every 5 ms": (libmodbus.BYTES_AT, 0.3, str(libmodbus.held(libmodbus.BYTES_AT))),
    "a register too many": (libmodbus.LONGER_AT, 0.3, "none"),
    "a register too few": (libmodbus.SHORTER_AT, 0.3, "none"),
}


def of_libmodbus(line):
    """The results of our driver with a device of libmodbus; each case is followed by an ordinary question."""
    found = []
    for case, (address, timeout_s, wanted) in DEVICE_CASES.items():
        with _driven(line, timeout_s) as (to_device, driver_of):
            got = _value(driver_of(address), to_device)
            after = _value(driver_of(PLAIN), to_device)
        found.append(Result("libmodbus", line, case, f"{wanted}, then {HELD}", f"{got}, then {after}"))
    with _driven(line, 0.3) as (to_device, driver_of):
        read_back = driver_of(PLAIN, setpoint=30).write(to_device, 321.0)
    return [*found, Result("libmodbus", line, "a set-point, read back", "321.0", str(read_back))]


def _value(driver, line):
    (reading,) = driver.poll(line)
    if reading.quality is Quality.EXCEPTION:
        return "exception"
    if reading.value is None:
        return "none"
    return f"{reading.value:g}" + ("" if reading.quality is Quality.OK else f" {reading.quality.value}")


@contextlib.contextmanager
def _driven(framing, timeout_s):
    """An open line to a device of libmodbus, and what makes a driver for a register of it."""
    device, clock = libmodbus.Device(framing), Clock()
    if framing == "rtu":
        table = LineTable(kind="serial", port=device.path, baud=19200, timeout_s=timeout_s, slowest_reply_s=1.0)
        port = SerialPort(device.path, clock, baud=19200)
    else:
        table = LineTable(kind="tcp", host="127.0.0.1", timeout_s=timeout_s, slowest_reply_s=1.0)
        port = TcpPort("127.0.0.1", device.tcp_port, clock)
    line = line_of("l", table, port, clock)

    def driver_of(address, setpoint=None):
        channel = {"a": {"unit": "-", "address": address, "type": "u16"}}
        settings = {"format": "instrument/1", "family": "modbus", "title": "t", "source": "t", "trust": "simulated"}
        more = {"unit": "-", "address": setpoint, "type": "u16", "lowest": 0.0, "highest": 1000.0} if setpoint else None
        file = modbus.Settings.model_validate(settings | {"channels": channel, "setpoint": more})
        return modbus.build("box", file, Place(DeviceTable(instrument="i", line="l", unit_id=device.unit), table))

    try:
        line.open()
        yield line, driver_of
    finally:
        line.close()
        device.end()


def all_of():
    """Every result, and what is missing on this machine or not made for a line."""
    results, missing = [], []
    for line in TABLES:
        for name in CLIENTS:
            try:
                results += of_client(name, line)
            except Missing:
                missing.append(f"client {name} over {line}")
        try:
            results += of_libmodbus(line)
        except Missing:
            missing.append(f"device libmodbus over {line}")
    try:
        said = opcua.answers()
        results += [Result("gopcua", "OPC UA", case, wanted, said[case]) for case, (_, wanted) in opcua.CASES.items()]
    except Missing:
        missing.append("client gopcua over OPC UA")
    return results, missing
