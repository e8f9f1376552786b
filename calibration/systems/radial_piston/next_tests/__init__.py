"""Tests that the motor's bench could make.

planned      as recordings that nobody has taken yet
readings     what each of these would read
quantities   single quantities, and the instrument that reads each
"""
