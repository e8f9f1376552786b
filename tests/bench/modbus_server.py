"""pymodbus' own server behind a cable of a given baud rate, and on a TCP port: what the polling rates are taken on.

Run as a process of its own, so that it shares no interpreter with what is measured. It prints one line of JSON with its
addresses and ends when its standard input closes.
"""

from __future__ import annotations

import asyncio
import json
import os
import pty
import sys
import threading
import time
import tty

from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

BITS_A_BYTE = 10
DEVICE_ID = 1


def cable(source: int, sink: int, baud: int) -> None:
    """Carry bytes at a baud rate, in a thread.

    Parameters
    ----------
    source, sink : int
        File descriptors of two pty masters.
    baud : int
        Bits a second [1/s].
    """

    def carry() -> None:
        free_at = 0.0
        while data := os.read(source, 1024):
            free_at = max(free_at, time.perf_counter()) + len(data) * BITS_A_BYTE / baud
            while (left := free_at - time.perf_counter()) > 0.0:
                time.sleep(left)
            os.write(sink, data)

    threading.Thread(target=carry, daemon=True).start()


async def serve(bauds: list[int]) -> None:
    """Serve one device on a cable a baud rate, and on TCP.

    Parameters
    ----------
    bauds : list of int
        Bits a second [1/s].
    """
    device = SimDevice(DEVICE_ID, simdata=[SimData(0, values=6.0, datatype=DataType.FLOAT32)])
    ports, kept = {}, []
    for baud in bauds:
        (master_ours, slave_ours), (master_theirs, slave_theirs) = pty.openpty(), pty.openpty()
        for slave in (slave_ours, slave_theirs):
            tty.setraw(slave)
        kept += [slave_ours, slave_theirs]
        cable(master_ours, master_theirs, baud)
        cable(master_theirs, master_ours, baud)
        server = ModbusSerialServer(device, port=os.ttyname(slave_theirs), framer=FramerType.RTU, baudrate=baud)
        await server.serve_forever(background=True)
        ports[str(baud)] = os.ttyname(slave_ours)
    tcp = ModbusTcpServer(device, address=("127.0.0.1", 0))
    await tcp.serve_forever(background=True)
    number = tcp.transport.sockets[0].getsockname()[1]
    print(json.dumps({"serial": ports, "tcp_port": number}), flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    os._exit(0)  # the cables' threads wait in a read


if __name__ == "__main__":
    asyncio.run(serve([int(argument) for argument in sys.argv[1:]]))
