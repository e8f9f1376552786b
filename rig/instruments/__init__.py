"""The instruments, a file a family: a pure codec from bytes to readings, and the driver on top of it.

`placing`, `polling`, `register_numbers` and `setting` are what the families share; the others are the families.
"""
