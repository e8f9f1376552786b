"""A mapping file proposed from a look at a source, for a person to read and to confirm. Nothing is imported by it.

look, layout, text    what a source holds: columns with their first cells; where a table begins; how text is parted
headings              what a heading says: column and unit
clock                 in which unit a column of times is written
columns, proposal     the columns that are proposed, and the whole file; what is not sure stands as a comment, with why
"""
