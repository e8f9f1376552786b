"""Binary files taken elsewhere, each read by a process of its own.

apart                 that process: a damaged file can end it, but not this program; what has to be installed
columns, clocks       what it answers: columns of cells; channels of several clocks on one time line
missing               values of an HDF5 dataset that stand for none
marks                 quality and limits beside the values, as the export of a run writes them
tdms, mat, hdf5, mdf, parquet  the formats: `read` gives the columns that are taken, `listed` what there is
"""
