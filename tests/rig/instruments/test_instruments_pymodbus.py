"""The generic Modbus driver against pymodbus' own server, which shares no code of ours: RTU on a pty, and TCP."""

import asyncio
import os
import pty
import select
import threading
import tty
import warnings

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from rig.bench.bench import DeviceTable, LineTable, Place
from rig.bench.instrument import InstrumentError
from rig.clock import Clock
from rig.instruments import modbus
from rig.lines import Line, Timing
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort
from rig.readings import Quality

TIMING = Timing(timeout_s=0.5, slowest_reply_s=0.5, quiet_s=0.005)
UNIT = 3


def device():
    """Ten floats, whole numbers and their negatives, as pymodbus packs them; and a place for a set-point."""
    return SimDevice(
        UNIT,
        simdata=[
            SimData(0, values=6.125, datatype=DataType.FLOAT32),
            SimData(2, values=20340, datatype=DataType.UINT32),
            SimData(4, values=-7, datatype=DataType.INT16),
            SimData(5, values=65535, datatype=DataType.UINT16),
            SimData(6, values=-70000, datatype=DataType.INT32),
            SimData(8, values=-2.5e-7, datatype=DataType.FLOAT64),
            SimData(12, values=2**63 + 2**20, datatype=DataType.UINT64),
            SimData(16, values=-(2**40), datatype=DataType.INT64),
            SimData(20, values=[0, 0], datatype=DataType.REGISTERS),
        ],
    )


SETTINGS = modbus.Settings.model_validate(
    {
        "format": "instrument/1",
        "family": "modbus",
        "title": "server",
        "source": "pymodbus",
        "trust": "simulated",
        "channels": {
            "a": {"unit": "-", "address": 0, "type": "f32"},
            "b": {"unit": "-", "address": 2, "type": "u32", "scale": 0.001},
            "c": {"unit": "-", "address": 4, "type": "i16"},
            "d": {"unit": "-", "address": 5, "type": "u16"},
            "e": {"unit": "-", "address": 6, "type": "i32"},
            "f": {"unit": "-", "address": 8, "type": "f64"},
            "g": {"unit": "-", "address": 12, "type": "u64"},
            "h": {"unit": "-", "address": 16, "type": "i64"},
        },
        "setpoint": {"address": 20, "type": "f32", "unit": "bar abs", "lowest": 0.0, "highest": 5.0},
    }
)


class Server(threading.Thread):
    """A server with an event loop in a thread of its own."""

    def __init__(self, make):
        super().__init__(daemon=True)
        self.make, self.loop, self.ready = make, asyncio.new_event_loop(), threading.Event()
        self.server = None
        self.start()
        assert self.ready.wait(10.0)

    def run(self):
        asyncio.set_event_loop(self.loop)
        self.loop.run_until_complete(self.serve())
        self.loop.run_forever()
        self.loop.close()

    async def serve(self):
        self.server = self.make()
        await self.server.serve_forever(background=True)
        self.ready.set()

    def end(self):
        asyncio.run_coroutine_threadsafe(self.server.shutdown(), self.loop).result(10.0)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.join()


@pytest.fixture(params=["rtu", "tcp"])
def server(request):
    """A driver on an open line to a server, over RTU and over TCP."""
    clock = Clock()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        if request.param == "rtu":
            ours, theirs, cable = rtu_cable()
            made = Server(
                lambda: ModbusSerialServer(device(), port=theirs, framer=FramerType.RTU, baudrate=19200, timeout=1)
            )
            port, table = SerialPort(ours, clock, baud=19200), LineTable(kind="serial", port=ours)
        else:
            made = Server(lambda: ModbusTcpServer(device(), address=("127.0.0.1", 0)))
            number = made.server.transport.sockets[0].getsockname()[1]
            port, cable = TcpPort("127.0.0.1", number, clock), None
            table = LineTable(kind="tcp", host="127.0.0.1", tcp_port=number)
    line = Line("l", port, clock, TIMING)
    line.open()
    driver = modbus.build("box", SETTINGS, Place(DeviceTable(instrument="i", line="l", unit_id=UNIT), table))
    driver.open(line)
    yield driver, line
    line.close()
    made.end()
    if cable is not None:
        cable()


def rtu_cable():
    """Two ptys and a thread that carries bytes between them; the paths, and what takes it all away."""
    (master_a, slave_a), (master_b, slave_b) = pty.openpty(), pty.openpty()
    for slave in (slave_a, slave_b):
        tty.setraw(slave)
    ended = threading.Event()

    def carry():
        while not ended.is_set():
            for end in select.select([master_a, master_b], [], [], 0.02)[0]:
                os.write(master_b if end == master_a else master_a, os.read(end, 1024))

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()

    def away():
        ended.set()
        thread.join()
        for end in (master_a, slave_a, master_b, slave_b):
            os.close(end)

    return os.ttyname(slave_a), os.ttyname(slave_b), away


def test_every_type_reads_as_pymodbus_wrote_it(server):
    driver, line = server
    for _ in range(20):
        readings = driver.poll(line)
        values = [6.125, 20.34, -7.0, 65535.0, -70000.0, -2.5e-7, 2.0**63 + 2**20, -(2.0**40)]
        assert [r.value for r in readings] == pytest.approx(values, rel=1e-12)
        assert {r.quality for r in readings} == {Quality.OK}


def test_a_set_point_is_taken_by_pymodbus_and_read_back(server):
    driver, line = server
    assert driver.write(line, 2.5) == 2.5
    assert driver.write(line, 0.0) == 0.0


def test_pymodbus_refuses_a_register_that_it_has_not(server):
    driver, line = server
    driver.setpoint = driver.setpoint.model_copy(update={"address": 400})
    with pytest.raises(InstrumentError, match=r"box refuses 1 bar abs: .*exception 2"):
        driver.write(line, 1.0)
