"""The line between regulator and motor."""
