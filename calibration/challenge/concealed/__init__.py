"""A virtual bench with the second rig behind its instruments, sealed (`bench`), and its seal opened (`revealing`)."""
