"""A recording as arrays, and which of its rows count.

measurement   plateaus and zero rows in the instruments' units, as the fit to plateaus takes them
blocks        plateaus, runs in time, standing and vented readings in SI, as everything else takes them
runs          runs in time as the diagnosis takes them
runs_in_time  where a run begins, and which of its readings are bad
rows_used     how many rows were used, and why not the rest
clock, dates  when each row was read, and the recording taken
left_out      what the user leaves out
refusals      recordings of which nothing can be said
together      recordings that cannot be taken together
joined        several recordings of one motor as one
"""
