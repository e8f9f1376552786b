"""Packages that only some commands need, and the extra of spinbench that installs each."""

from __future__ import annotations

import importlib.util

# Package: its extra, and what it is for.
EXTRAS = {
    "cryptography": ("seal", "a seal"),
    "distributed": ("cluster", "a Dask scheduler"),
    "paho": ("mqtt", "live data over MQTT"),
    "pyarrow": ("formats", "a table as Parquet"),
}


class MissingPackageError(ImportError):
    """A command needs a package that is not installed."""


def need(package: str) -> None:
    """See that a package is there, before the work that needs it begins."""
    try:
        found = importlib.util.find_spec(package)
    except ImportError:
        found = None
    if found is None:
        extra, purpose = EXTRAS[package]
        raise MissingPackageError(
            f"{purpose} needs the package {package}, which is not installed; "
            f'install it with `pip install "spinbench[{extra}]"`'
        )
