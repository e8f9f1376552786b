"""What a motor does: operating points, runs in time, a recorded pressure, and which parameter matters."""
