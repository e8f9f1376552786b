"""Torques on the rotor, and its inertia."""
