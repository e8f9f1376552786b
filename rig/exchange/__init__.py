"""Runs and recordings to and from other formats.

export, figures, parquet                      a run as recording/1, with its instruments' figures; as one Parquet file
importing, mapping, tables, units, converted  data taken elsewhere, with units that have to be said
apart                                         what reads a file whose reader it may take down
"""
