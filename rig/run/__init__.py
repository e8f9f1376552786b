"""One run on a bench, from its start record to its end record; and the person at the terminal."""
