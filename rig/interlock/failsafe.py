"""What a regulator does by itself when it hears nothing: set and read back at the start, or waived by name."""

from __future__ import annotations

from typing import Protocol

from rig.bench.bench import Bench
from rig.bench.instrument import InstrumentError, Regulator
from rig.interlock import SafetyError
from rig.lines import LineError
from rig.readings import Exchange


class Commands(Protocol):
    """Who can have a device do something: the acquisition."""

    def command(self, device: str, action: str, argument: float | None = None, wait_s: float = 5.0) -> Exchange:
        """Have a device do something, and wait until it is done."""


def regulators(bench: Bench) -> list[str]:
    """The devices of a bench that can raise the pressure."""
    return [device for device in bench.file.devices if isinstance(bench.build(device), Regulator)]


def set_and_check(acquisition: Commands, bench: Bench) -> list[str]:
    """Set the failsafe of every regulator; the driver reads it back.

    Returns a line a regulator, for the record: what was set, or why not and that it is waived. Raises SafetyError when
    a regulator has none, or did not take it, and the bench file does not waive it by name.
    """
    waived = bench.file.safety.waive_failsafe
    said, refused = [], []
    for device in regulators(bench):
        try:
            said.append(f"{device}: {acquisition.command(device, 'failsafe').outcome}")
        except (InstrumentError, LineError) as error:
            if device in waived:
                said.append(f"{device}: no communications failsafe, waived by the bench file ({error})")
            else:
                refused.append(
                    f"{device}: would hold its pressure if this computer fell silent ({error}). Use a regulator with a "
                    "communications failsafe, or accept that hardware alone vents then and write in the bench file: "
                    f'[safety] waive_failsafe = ["{device}"]'
                )
    if refused:
        raise SafetyError("\n".join(refused))
    return said
