"""What predicts the readings of a recording, a kind of machine each.

look_up        the system that a recording is of
radial_piston  the article's motor
several        several recordings of it, of different days
machines       machines that are written out in their recordings
"""
