"""A line of the virtual bench: takes requests apart, finds who is meant, and sends the answer, or what a fault makes
of it. A unit that is not there is silent, as on a real bus.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from rig.readings import NS
from rig.virtual.cables.loop import Loop
from rig.virtual.cables.wires import Wire
from rig.virtual.devices import frames
from rig.virtual.devices.base import World
from rig.virtual.devices.faults import BYTES, MODBUS, NUMBERS, Fault, damage
from rig.virtual.devices.modbus_device import ModbusDevice

TURNAROUND_S = 0.003  # from the end of a request to the start of its answer
SILENCE_S = 0.02  # of the wall: half a frame that is not carried on for so long is none
MOST_LOG = 20_000
MOST_LINE = 4096
REFUSED = 0x80  # of a function code
OTHER_FUNCTION = {1: 2, 2: 1, 3: 4, 4: 3, 6: 16, 16: 6}


class Bus:
    """One line and the devices on it."""

    def __init__(
        self, name: str, framing: str, devices: Sequence[Any], loop: Loop, world: World, chance: np.random.Generator
    ) -> None:
        self.name, self.framing, self.devices = name, framing, devices
        self.loop, self.world, self.chance = loop, world, chance
        self.wire: Wire
        self.log: deque[tuple[float, str, str]] = deque(maxlen=MOST_LOG)  # time [s], device, request in hex
        self.without_power: dict[str, int] = {}  # device: until when [ns]
        self._buffers: dict[int, bytes] = {}
        self._whole_ns = 0
        self._is_modbus = any(device.speaks == "modbus" for device in devices)

    def receive(self, caller: int, data: bytes, whole_ns: int) -> None:
        """Take what has crossed the wire. `whole_ns`: when its last byte had crossed [ns]."""
        now_ns = self.loop.clock.now_ns()
        self.world.plant.advance(now_ns)
        self._whole_ns = whole_ns
        buffer = (self._buffers.pop(caller, b"") + data)[-MOST_LINE:]
        rest = self._modbus(caller, buffer, now_ns) if self._is_modbus else self._text(caller, buffer, now_ns)
        if rest:
            self._buffers[caller] = rest
            self.loop.after(SILENCE_S * self.loop.clock.rate, lambda: self._forget(caller, rest))

    def tick(self, time_ns: int) -> None:
        """Let watchdogs look at the time, and devices that send unasked send.

        `time_ns`: time of the bench, to which the plant has been carried on [ns].
        """
        for device in self.devices:
            until_ns = self.without_power.get(device.device)
            if until_ns is not None:
                if time_ns < until_ns:
                    continue
                del self.without_power[device.device]
                device.restart(time_ns)
            device.tick(time_ns)
            if device.speaks == "stream":
                self._stream(device, time_ns)
        self.wire.flush()

    def switch_off(self, device: str, until_ns: int) -> None:
        """Take a device's power for some time. `until_ns`: when it comes back [ns]."""
        self.without_power[device] = until_ns

    def _forget(self, caller: int, rest: bytes) -> None:
        if self._is_modbus and self._buffers.get(caller) == rest:
            del self._buffers[caller]

    def _modbus(self, caller: int, buffer: bytes, now_ns: int) -> bytes:
        """Answer every whole request, and return what is left."""
        length_of = frames.rtu_request_length if self.framing == "rtu" else frames.tcp_request_length
        while buffer:
            length = length_of(buffer)
            if length is None or 0 < length > len(buffer):
                return buffer
            if length == 0:
                return b""
            frame, buffer = buffer[:length], buffer[length:]
            if self.framing == "tcp":
                self._ask(caller, frame, frame[6], frame[frames.HEADER :], now_ns)
            elif frames.crc(frame[:-2]) == frame[-2:]:
                self._ask(caller, frame, frame[0], frame[1:-2], now_ns)
            else:
                return b""  # on a real line nobody answers to a damaged frame, nor to what follows it at once
        return b""

    def _ask(self, caller: int, frame: bytes, unit: int, body: bytes, now_ns: int) -> None:
        meant = [device for device in self.devices if unit in (0, device.unit)]
        for device in [device for device in meant if device.device not in self.without_power]:
            self.log.append((now_ns / NS, device.device, frame.hex()))
            answer = device.answer(body, now_ns)
            if unit == 0:
                continue  # to all, answered by none
            if answer[0] & REFUSED and device is not meant[-1]:
                continue  # one device of which two files tell: the other may have these registers
            here, answer = self._lie(device, body, answer, now_ns)
            if self.framing == "rtu":
                whole = frames.rtu(here, answer)
            else:
                whole = frames.tcp(self._number(device, frame[:2], now_ns), here, answer)
            self._reply(caller, device.device, whole, frame, now_ns)
            return
        if not meant:
            self.log.append((now_ns / NS, "", frame.hex()))
        if any(self.world.faults.happens("echo", device.device, now_ns) for device in meant or self.devices):
            self.wire.send(caller, frame, max(now_ns, self._whole_ns))

    def _lie(self, device: ModbusDevice, body: bytes, answer: bytes, now_ns: int) -> tuple[int, bytes]:
        """Unit and body of the answer, after the faults that act on what it says."""
        unit = device.unit
        for fault in self.world.faults.happening(device.device, now_ns, MODBUS):
            if fault.kind == "wrong_unit":
                unit = unit % 247 + 1
            elif fault.kind == "exception":
                answer = bytes([body[0] | 0x80, fault.code])
            elif fault.kind == "wrong_function":
                answer = bytes([OTHER_FUNCTION.get(answer[0], answer[0] ^ 1)]) + answer[1:]
            elif answer[0] in (frames.READ_HOLDING, frames.READ_INPUT_REGISTERS):
                answer = bytes([answer[0], answer[1] + 2]) + answer[2:] + b"\0\0"
        return unit, answer

    def _number(self, device: ModbusDevice, number: bytes, now_ns: int) -> bytes:
        """The transaction number of an answer, after the faults that act on it."""
        for fault in self.world.faults.happening(device.device, now_ns, NUMBERS):
            if fault.kind == "number_zero":
                number = b"\0\0"
            elif fault.kind == "number_swapped":
                number = number[::-1]
            else:
                number = ((int.from_bytes(number, "big") + 1) & 0xFFFF).to_bytes(2, "big")
        return number

    def _text(self, caller: int, buffer: bytes, now_ns: int) -> bytes:
        """Answer every whole line, and return what is left."""
        terminator = self.devices[0].terminator
        while terminator in buffer:
            line, _, buffer = buffer.partition(terminator)
            self.log.append((now_ns / NS, "", line.hex()))
            for device in self.devices:
                if device.device in self.without_power:
                    continue
                answer = device.answer(line, now_ns)
                if device.speaks == "stream" and answer is not None:
                    self.wire.forget_backlog()
                if answer:
                    self._reply(caller, device.device, answer, line + terminator, now_ns)
        return buffer

    def _reply(self, caller: int, device: str, frame: bytes, request: bytes, now_ns: int) -> None:
        found = self.world.faults.happening(device, now_ns, BYTES)
        for late_s, part in damage(frame, request, found, self.chance):
            from_ns = max(now_ns, self._whole_ns) + int((late_s + TURNAROUND_S) * NS)
            if late_s > 0.0:
                self._send_later(caller, part, from_ns)
            else:
                self.wire.send(caller, part, from_ns)

    def _send_later(self, caller: int, part: bytes, from_ns: int) -> None:
        """Send then; until then the wire is free for others."""

        def send() -> None:
            self.wire.send(caller, part)

        self.loop.at(from_ns, send)

    def _stream(self, device: Any, time_ns: int) -> None:
        if not self.wire.plugged:
            device.stream(time_ns)
            return
        for frame in device.stream(time_ns):
            found: list[Fault] = []
            if self.world.faults.active:
                found = self.world.faults.happening(device.device, time_ns, BYTES)
            for late_s, part in damage(frame, b"", found, self.chance):
                if late_s > 0.0:
                    self._send_later(0, part, time_ns + int(late_s * NS))
                elif not self.wire.send(0, part):
                    device.overrun()
