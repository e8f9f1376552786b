"""The kinds of readings in the vector that a recording is compared as; run i is ``RUN + i``."""

LINE, STANDING, VENTED, FLOW, SPEED, RUN = -3, -2, -1, 0, 1, 2
