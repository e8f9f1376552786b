"""What a cable of the virtual bench is: bytes both ways, and it can be pulled out and put back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

READ_BYTES = 4096

# Called with who sent (0 on a serial line), what, and when the last byte has crossed the wire [ns]: now, or so soon
# that waiting for it would only cost time.
Receive = Callable[[int, bytes, int], None]


class Wire(Protocol):
    """A cable: what the bus sends goes to a caller, or to all of them, and what callers send goes to the bus."""

    plugged: bool

    def plug(self) -> None:
        """Put the cable in."""

    def unplug(self) -> None:
        """Pull the cable; what is on its way is lost."""

    def send(self, caller: int, data: bytes, from_ns: int = 0) -> bool:
        """Send, and return whether there was room. `from_ns`: when to begin; now, when that is past [ns]."""

    def forget_backlog(self) -> None:
        """Throw away what nobody has read yet."""

    def flush(self) -> None:
        """Write what waits, as far as there is room."""

    def address(self) -> dict[str, str | int]:
        """How a caller reaches the wire."""
