"""The page of a run that has just ended: its readings against the model, a first f_overall, and what to do next."""
