"""What `import spinbench` offers beside the rooms' own functions: results that show themselves in a notebook.

opened      a run or a recording from its folder, as tables
frames      tables with units
simulating  the model, as tables
fitting     a fit: how it is made, and its result
arviz_data  draws as xarray and ArviZ take them
diagnosing  a diagnosis
comparing   what changed between two recordings
"""
