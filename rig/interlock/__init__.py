"""What stands between a bench and damage, as far as software can: it is not the safety function (docs/safety.md).

guard     before a step: the speed it would give, and whether that may be
belief    the arithmetic behind it; step: what the guard takes and gives
limits    during the run: the last readings against the limits
stop      the operator's Ctrl-C, and the system's signals
watchdog  a process of its own (watching) that vents when the controller dies
failsafe  what the regulator does by itself when it hears nothing
"""


class SafetyError(Exception):
    """A run is refused, or cannot go on, because it would not be safe. The text says why and what to do."""
