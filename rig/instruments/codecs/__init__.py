"""Bytes to numbers and back, as several families need it.

registers   Modbus registers
blocks      which registers are read together
values      what a codec makes of a channel
streaming   frames of a device that sends unasked
edge_frames frames of the edge counter
"""
