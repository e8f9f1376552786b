"""The bench file, and what an instrument's file says.

bench       the bench file: lines, devices, roles, and the drivers that are built of it
checks      what is wrong with one beyond single keys
instrument  what an instrument is to the rest of the rig, and what its file says
"""
