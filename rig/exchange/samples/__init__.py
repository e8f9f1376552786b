"""The samples of a sealed run as one file, for those who analyse it elsewhere; written whole or not at all.

export    what is asked of the run and the place; the format by the file's ending
channels  the samples by channel
formats   Parquet, HDF5, TDMS and MDF
"""
