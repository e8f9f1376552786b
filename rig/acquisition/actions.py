"""What can be asked of a device, and the exchange that comes of it. Live running and replay both go through here."""

from __future__ import annotations

from rig.bench.instrument import EdgeReader, IdentityError, Instrument, InstrumentError, Regulator
from rig.lines import Line, LineError, LostError
from rig.readings import Exchange, Reading

OPEN, IDENTIFY, POLL, WRITE, FAILSAFE, CAPTURE = "open", "identify", "poll", "write", "failsafe", "capture"
FAULTS = (LineError, IdentityError, InstrumentError)


def open_line(line: Line) -> tuple[Exchange, LostError | None]:
    """Open a line. Returns `exchange`: what is logged, with an outcome when it failed; `fault`: why it failed."""
    try:
        line.open()
    except LostError as error:
        return Exchange(line.name, "", OPEN, None, line.take_events(), (), str(error)), error
    return Exchange(line.name, "", OPEN, None, line.take_events()), None


def perform(
    line: Line, device: str, driver: Instrument, action: str, argument: float | None = None
) -> tuple[Exchange, Exception | None]:
    """Ask one thing of a device.

    `argument`: the set-point of a write, in the actuator's unit [own unit].
    Returns `exchange`: what crossed the wire and what it gave; `fault`: a `LineError`, `IdentityError` or
    `InstrumentError`, whose text is the exchange's outcome.
    """
    line.take_events()
    readings: list[Reading] = []
    outcome = ""
    fault: Exception | None = None
    try:
        if action == OPEN:
            driver.open(line)
        elif action == IDENTIFY:
            outcome = driver.identify(line)
        elif action == POLL:
            readings = driver.poll(line)
        elif action == CAPTURE and isinstance(driver, EdgeReader):
            readings = driver.poll_edges(line)
        elif action == WRITE and isinstance(driver, Regulator) and argument is not None:
            outcome = f"reads back {driver.write(line, argument)!r} {driver.unit}"
        elif action == FAILSAFE and isinstance(driver, Regulator):
            outcome = driver.set_failsafe(line)
        else:
            raise ValueError(f"'{device}' cannot be asked to {action}")
    except FAULTS as error:
        fault, outcome = error, str(error)
    return Exchange(line.name, device, action, argument, line.take_events(), tuple(readings), outcome), fault
