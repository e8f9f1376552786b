"""The simulated instruments, a file a family.

The families: adam_4024, alicat, alicat_modbus, ascii, edge_counter, keller_30x, lutron, modbus.

base            what one is, and how it is made for each device of a bench
sensors         what an instrument makes of the truth
faults          the menu of what can go wrong
modbus_device, frames   what the Modbus families share
"""
