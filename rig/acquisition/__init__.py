"""Acquisition: every line in a thread of its own, every exchange through one queue to the run log, in one order.

actions      what can be asked of a device, and the exchange that comes of it: live and in a replay
opening      from a line's table in the bench file to a line
worker       the thread of a line: schedule, commands, and the repair of a lost line
stage        what is added to an exchange on its way to the log: marks of a virtual bench, derived channels
derived      inlet flow from a flow meter that reads another state
channels     the recent readings of each channel
recorder     the bounded queue and the thread that empties it
acquisition  all of it put together
"""

from rig.acquisition.acquisition import Acquisition
from rig.acquisition.channels import Window
from rig.acquisition.recorder import RecorderError, Sink

__all__ = ["Acquisition", "RecorderError", "Sink", "Window"]
