"""A mapping file proposed from a look at a source, for a person to read and to confirm. Nothing is imported by it.

look, layout          what a source holds: columns with their first cells, how text is parted; where a table begins
columns, proposal     the columns that are proposed, and the whole file; what is not sure stands as a comment, with why
"""
