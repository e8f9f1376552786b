"""What the air loses, or does not do, on its way through the motor."""
