"""Binary files taken elsewhere, each read by a process of its own.

apart                 that process: a damaged file can end it, but not this program; what has to be installed
columns, clocks       what it answers: columns of cells; channels of several clocks on one time line
tdms, mat, hdf5, mdf  the formats: `read` gives the columns that are taken, `listed` what there is
"""
