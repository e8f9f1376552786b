"""Waiting for what another thread or process does."""

import time

ENOUGH_S = 180.0  # however busy the machine is


def wait_for(found, what="what was waited for did not come"):
    """Wait until there is an answer, and return it."""
    end_s = time.monotonic() + ENOUGH_S
    while time.monotonic() < end_s:
        if answer := found():
            return answer
        time.sleep(0.02)
    raise AssertionError(f"{what}: not within {ENOUGH_S:g} s")
