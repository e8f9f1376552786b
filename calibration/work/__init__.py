"""How work is shared out and kept: nothing here knows what it is about.

many, many_table       one task over many items, resumable; their results as a table
trend                  a line through figures of many
processes, threads     what works beside this process, or within it
side_by_side           searches one after another or at once, with the same result
step_clock             how long each step takes
sources                which code a result came from
"""
