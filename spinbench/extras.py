"""Packages that only some commands and results need, and the extra of spinbench that installs each."""

from __future__ import annotations

import importlib.util

# Package: its extra, and what it is for.
EXTRAS = {
    "asyncua": ("opcua", "live data over OPC UA"),
    "arviz": ("notebook", "an InferenceData"),
    "cryptography": ("seal", "a seal"),
    "distributed": ("cluster", "a Dask scheduler"),
    "paho": ("mqtt", "live data over MQTT"),
    "pyarrow": ("formats", "a table as Parquet"),
    "xarray": ("notebook", "an xarray Dataset"),
}


class MissingPackageError(ImportError):
    """What is asked for needs a package that is not installed."""


def has(package: str) -> bool:
    """Whether a package is there."""
    try:
        return importlib.util.find_spec(package) is not None
    except ImportError:
        return False


def need(package: str) -> None:
    """See that a package is there, before the work that needs it begins."""
    if not has(package):
        extra, purpose = EXTRAS[package]
        raise MissingPackageError(
            f"{purpose} needs the package {package}, which is not installed; "
            f'install it with `pip install "spinbench[{extra}]"`'
        )
