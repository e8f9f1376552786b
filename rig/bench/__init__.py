"""The bench file, and what an instrument's file says."""
