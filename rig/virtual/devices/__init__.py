"""The simulated instruments, a file a family.

base            what one is, and how it is made for each device of a bench
sensors         what an instrument makes of the truth
faults          the menu of what can go wrong
modbus_device, frames   what the Modbus families share
"""
