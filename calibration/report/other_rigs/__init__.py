"""The report of a diagnosis of another rig."""
