"""A set-point: ordered once, never repeated blindly, read back and compared."""

from __future__ import annotations

from collections.abc import Callable

from rig.bench.instrument import InstrumentError, Regulator
from rig.instruments.polling import repeated
from rig.lines import LineError, LostError
from rig.readings import Quality


def set_and_read_back(
    driver: Regulator, value: float, order: Callable[[], None], read_back: Callable[[], float], tolerance: float
) -> float:
    """Order a set-point and return what the device reads back.

    `value`: what to order [own unit].
    `read_back`: asks what the device holds now; asked again once when the answer fails.
    `tolerance`: how far the two may differ, by the device's resolution [own unit].
    Returns what is read back [own unit]. Raises InstrumentError when the value is outside the limits, the device
    refuses it, or holds another one; LineError when nobody answers.
    """
    device, unit, lowest, highest = driver.device, driver.unit, driver.lowest, driver.highest
    if not lowest <= value <= highest:
        raise InstrumentError(
            f"{device}: {value:g} {unit} is not a set-point; it takes {lowest:g} to {highest:g} {unit}"
        )
    unconfirmed = ""
    try:
        order()
    except LostError:
        raise
    except LineError as error:
        if error.quality is Quality.EXCEPTION:
            raise InstrumentError(f"{device} refuses {value:g} {unit}: {error}") from None
        unconfirmed = f"; the order was not confirmed: {error}"
    held = repeated(read_back, 1)
    if not abs(held - value) <= tolerance:
        raise InstrumentError(f"{device} was ordered {value:g} {unit} and reads back {held:g} {unit}{unconfirmed}")
    return held
