"""A sealed run's samples as one file, whose ending says the format."""

from __future__ import annotations

import os
from pathlib import Path

from configs import close_to
from rig.exchange.binary.apart import need
from rig.exchange.samples import formats
from rig.recording.files import OF_FILES, beside
from rig.recording.mistakes import shown
from rig.runlog.folder import END, MAX_RECORD_BYTES, START, RunError, read_bytes
from rig.runlog.reader import BEING_WRITTEN, Run

# Ending: what writes the format, and the package that it needs.
FORMATS = {
    ".parquet": (formats.write_parquet, "pyarrow"),
    **dict.fromkeys((".h5", ".hdf5", ".nxs"), (formats.write_hdf5, "h5py")),
    ".tdms": (formats.write_tdms, "nptdms"),
    ".mf4": (formats.write_mdf, "asammdf"),
}


def is_file_of_samples(out: Path) -> bool:
    """Whether a name is that of a file of samples, and not of a folder.

    Raises RunError for the ending of a file of another kind, and for one that is misspelt.
    """
    ending = out.suffix.lower()
    if ending in FORMATS or not ending:
        return bool(ending)
    close = close_to(ending, FORMATS)
    if close or ending in OF_FILES:
        meant = f"did you mean '{close}'? " if close else ""
        known = f"known: {', '.join(FORMATS)}; the name of a folder has no such ending"
        raise RunError(f"{out}: unknown ending '{ending}'; {meant}{known}")
    return False


def export_samples(run: Run, file: Path) -> None:
    """Write the samples of a run as one file, with its start and end records in it.

    Raises RunError when the run has no end record, the file exists, or the package that its format needs is not
    installed.
    """
    file = Path(file)
    if run.end is None:
        what = "is being written" if run.state == BEING_WRITTEN else "was killed: `spinbench runs repair` seals it"
        raise RunError(f"{run.folder}: only a sealed run becomes a {file.suffix} file, and this one {what}")
    if os.path.lexists(file):
        raise RunError(f"{file}: exists already; nothing is overwritten, give a name that is free")
    write, package = FORMATS[file.suffix.lower()]
    need(package)
    records = {name: read_bytes(run.folder / name, MAX_RECORD_BYTES) for name in (START, END)}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with beside(file.parent) as hidden:
            whole = hidden / file.name
            write(run, records, whole)
            with whole.open("rb") as written:
                os.fsync(written.fileno())
            whole.rename(file)
    except RunError:
        raise
    except UnicodeError:
        raise RunError(f"{file}: this format takes no name that is not UTF-8; give another") from None
    except Exception as error:  # packages raise many things where a disk is full
        why = getattr(error, "strerror", None) or shown(str(error), 100) or type(error).__name__
        raise RunError(f"{file}: cannot be written ({why}); check the place and the space") from None
