"""The motor of the second rig: figures, geometry, gas, torques, a step, and marching it."""
