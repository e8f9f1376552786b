"""The motor and the line before it, carried on in the bench's time."""
