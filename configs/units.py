"""Units at the rim, in SI: one table for all who convert."""

from __future__ import annotations

import math

BAR = 1e5  # Pa
ZERO_C = 273.15  # K
RPM = 30.0 / math.pi  # rpm in one rad/s
RAD_S = math.pi / 30.0  # rad/s in one rpm
L_MIN = 60_000.0  # L/min in one m3/s
M3_S = 1.0 / 60_000.0  # m3/s in one L/min
