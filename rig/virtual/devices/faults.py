"""The menu of faults: what can go wrong on the wire, on a line or a device, in a window of time or by chance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import pydantic

import configs
from configs import ConfigError, Strict

# kind: what it does. The first group acts on a reply on its way out, the second on what the reply says, the third on
# its number over TCP, the fourth on an instrument's value, the fifth on a cable or a device once, at `from_s`.
BYTES = {
    "late": "the reply comes by_s later",
    "split": "the reply comes in two parts, by_s apart",
    "dropped": "the reply does not come",
    "doubled": "the reply comes twice",
    "corrupt": "one bit of the reply is another",
    "noise": "count bytes of noise come before the reply",
    "echo": "the request comes back at once, before the reply and without one",
}
MODBUS = {
    "wrong_unit": "the next unit's number answers",
    "wrong_function": "the answer is to another function",
    "wrong_count": "one register too many is answered",
    "exception": "the answer is the Modbus exception code",
}
NUMBERS = {
    "number_zero": "the answer's transaction number is 0",
    "number_swapped": "the bytes of the answer's transaction number are swapped",
    "number_next": "the answer has the next transaction number",
}
VALUES = {"frozen": "the instrument repeats its last value", "nan": "the instrument gives no number"}
ONCE = {
    "unplug": "the cable is out for by_s",
    "power_cycle": "the device is without power for by_s, and starts as from the factory",
}
FAULT_KINDS = BYTES | MODBUS | NUMBERS | VALUES | ONCE
BY_S = {"late": 0.5, "split": 0.05, "unplug": 3.0, "power_cycle": 2.0}
LONGEST_FAULT_S = 1e6

NotNegative = Annotated[float, pydantic.Field(ge=0.0, le=LONGEST_FAULT_S)]


class Fault(Strict):
    """One fault.

    `line`, `device`: where: the one or the other; a line means every device on it.
    `from_s`, `to_s`: window on the bench's clock [s].
    `by_s`: how late, how far apart, or how long [s]; the kind's own when left out.
    """

    kind: str
    line: str = ""
    device: str = ""
    chance: Annotated[float, pydantic.Field(gt=0.0, le=1.0)] = 1.0
    from_s: NotNegative = 0.0
    to_s: NotNegative = LONGEST_FAULT_S
    by_s: NotNegative | None = None
    count: Annotated[int, pydantic.Field(ge=1, le=64)] = 3
    code: Annotated[int, pydantic.Field(ge=1, le=255)] = 4

    @property
    def span_s(self) -> float:
        """``by_s``, or the kind's own."""
        return BY_S.get(self.kind, 0.0) if self.by_s is None else self.by_s


@dataclass(frozen=True)
class Place:
    """What faults may be laid on: each line's devices, and the devices that speak Modbus."""

    devices_of: Mapping[str, Iterable[str]]
    modbus: frozenset[str]


def read_fault(table: Mapping[str, Any], place: Place, where: str) -> Fault:
    """A fault from its table.

    `table`: of the bench file, or of a request to the running bench.
    Raises ConfigError: one line a mistake.
    """
    whole_numbers = {"chance", "from_s", "to_s", "by_s"}
    table = {key: float(v) if key in whole_numbers and type(v) is int else v for key, v in table.items()}
    fault = configs.validate(Fault, table, where)
    mistakes = list(_mistakes(fault, table, place))
    if mistakes:
        raise ConfigError("\n".join(f"{where}: {mistake}" for mistake in mistakes))
    return fault


def _mistakes(fault: Fault, table: Mapping[str, Any], place: Place) -> Iterable[str]:
    if fault.kind not in FAULT_KINDS:
        yield f"there is no fault '{fault.kind[:40]}'; known: {', '.join(FAULT_KINDS)}"
        return
    devices = {device: line for line, found in place.devices_of.items() for device in found}
    if bool(fault.line) == bool(fault.device):
        yield "a fault is laid on a line or on a device: name one of the two"
    elif fault.line and fault.line not in place.devices_of:
        yield f"there is no virtual line '{fault.line[:40]}' ({', '.join(place.devices_of)})"
    elif fault.device and fault.device not in devices:
        yield f"there is no virtual device '{fault.device[:40]}' ({', '.join(devices)})"
    elif fault.kind == "unplug" and fault.device:
        yield f"a line is unplugged, not a device: name the line '{devices[fault.device]}'"
    elif fault.kind == "power_cycle" and fault.line:
        yield f"a device is power-cycled, not a line: name one of {', '.join(place.devices_of[fault.line])}"
    elif fault.kind in MODBUS | NUMBERS:
        on = [fault.device] if fault.device else place.devices_of[fault.line]
        if not place.modbus.intersection(on):
            yield f"'{fault.kind}' is a fault of Modbus, which {', '.join(on)} does not speak"
    if fault.to_s <= fault.from_s:
        yield f"to_s ({fault.to_s:g}) is not after from_s ({fault.from_s:g})"
    if fault.kind in ONCE and ("chance" in table or "to_s" in table):
        yield f"'{fault.kind}' happens once, at from_s, for by_s: it has no chance and no to_s"
    if "by_s" in table and fault.kind not in BY_S:
        yield f"by_s means nothing to '{fault.kind}' (only to {', '.join(BY_S)})"
    if "count" in table and fault.kind != "noise":
        yield f"count means nothing to '{fault.kind}' (only to noise)"
    if "code" in table and fault.kind != "exception":
        yield f"code means nothing to '{fault.kind}' (only to exception)"


@dataclass
class Faults:
    """The faults in force.

    `active`: those laid on replies and values; those that happen once are the bench's to carry out.
    """

    chance: np.random.Generator
    place: Place
    active: list[Fault] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def add(self, fault: Fault) -> None:
        """Lay one more fault."""
        self.active.append(fault)

    def clear(self) -> None:
        """Take all faults back."""
        self.active.clear()

    def happening(self, device: str, time_ns: int, kinds: Iterable[str]) -> list[Fault]:
        """Which faults befall a device now; chance is drawn anew at each call."""
        now_s = time_ns / 1e9
        found = []
        for fault in self.active:
            if fault.kind not in kinds or not fault.from_s <= now_s < fault.to_s:
                continue
            if fault.device != device and device not in self.place.devices_of.get(fault.line, ()):
                continue
            if fault.chance < 1.0 and self.chance.random() >= fault.chance:
                continue
            self.counts[fault.kind] = self.counts.get(fault.kind, 0) + 1
            found.append(fault)
        return found

    def happens(self, kind: str, device: str, time_ns: int) -> bool:
        """Whether a fault of one kind befalls a device now."""
        return bool(self.happening(device, time_ns, (kind,)))


def damage(
    frame: bytes, request: bytes, faults: Iterable[Fault], chance: np.random.Generator
) -> list[tuple[float, bytes]]:
    """What is sent in place of a reply.

    `request`: what it answers; empty for what comes unasked.
    Returns parts to be sent, each so long [s] after the reply was due.
    """
    kinds = {fault.kind: fault for fault in faults}
    echo = [(0.0, request)] if "echo" in kinds and request else []
    if "dropped" in kinds:
        return echo
    if "corrupt" in kinds and frame:
        place = int(chance.integers(len(frame)))
        frame = frame[:place] + bytes([frame[place] ^ 1 << int(chance.integers(8))]) + frame[place + 1 :]
    if "doubled" in kinds:
        frame += frame
    if "noise" in kinds:
        frame = chance.bytes(kinds["noise"].count) + frame
    late_s = kinds["late"].span_s if "late" in kinds else 0.0
    if "split" in kinds and len(frame) > 1:
        cut = math.ceil(len(frame) / 2)
        return [*echo, (late_s, frame[:cut]), (late_s + kinds["split"].span_s, frame[cut:])]
    return [*echo, (late_s, frame)]
