"""A recording as arrays, and which of its rows count: in SI for the diagnosis, in instruments' units for the fit.

measurement   plateaus and zero rows, as the fit takes them
blocks        plateaus, runs in time, standing and vented readings, as the diagnosis takes them
runs          runs in time as the diagnosis takes them
runs_in_time  where a run begins, and which of its readings are bad
rows_used     how many rows were used, and why not the rest
clock, dates  when each row was read, and the recording taken
left_out      what the user leaves out
refusals      recordings of which nothing can be said
together      recordings that cannot be taken together
joined        several recordings of one motor as one
"""
