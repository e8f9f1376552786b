"""The effects, a file each: its law, parameters, bounds and source."""
