"""Runs and recordings to and from other formats.

export, captures, figures       a run as recording/1, its captures, and its instruments' figures
samples                         a run's samples as one file: Parquet, HDF5, TDMS, MDF
importing, mapping, converted   data taken elsewhere, with units that have to be said
source_columns                  one column of a source: its cells as numbers
doubts, placing                 what a person should look at in a table that can be read; where files stand on one clock
tables, workbook, cells, units  what they are read with
binary                          files that their libraries read, in a process of its own
guess                           a mapping proposed from a look at a file, for a person to confirm
"""
