"""The instruments, a file a family: a pure codec from bytes to readings, and the driver on top of it.

`instrument` says what an instrument is; the families are the other modules.
"""
