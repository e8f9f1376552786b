"""The packages that a format needs, and the extra of spinbench that installs each."""

from __future__ import annotations

import importlib.util

from rig.runlog.folder import RunError

# Package: its name where it is published, its extra, and what needs it.
PACKAGES = {
    "nptdms": ("npTDMS", "formats", "a TDMS file"),
    "h5py": ("h5py", "formats", "an HDF5 file"),
    "asammdf": ("asammdf", "mdf", "an MDF file"),
    "pyarrow": ("pyarrow", "formats", "a Parquet file"),
}


def need(name: str) -> None:
    """See that a package is there. Raises RunError that says how to install it, where it is not."""
    try:
        found = importlib.util.find_spec(name)
    except ImportError:
        found = None
    if found is None:
        published, extra, purpose = PACKAGES[name]
        raise RunError(f'{purpose} needs the package {published}; install it with `pip install "spinbench[{extra}]"`')
