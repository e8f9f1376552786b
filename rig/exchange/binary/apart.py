"""Reading a file in a process of its own: a damaged one may take a library's compiled code down, or ask for all memory.

python -m rig.exchange.binary.apart 30 read tdms data.tdms GROUP '["P", "n"]'     # JSON on standard output
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from rig.exchange.binary.columns import MAX_BYTES, Columns, Listed, Wanted
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain

MOST_MEMORY = 8_000_000_000  # bytes
GIVEN_UP_S = 1800.0
MOST_CPU_S = 30  # of a small file: a damaged one can send its reader round in circles
MOST_CPU_S_PER_MB = 2
# Reader: the package that it needs.
NEEDS = {"tdms": "nptdms", "mat": "scipy", "hdf5": "h5py", "mdf": "asammdf", "parquet": "pyarrow"}
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


def read_apart(reader: str, path: Path, group: str, wanted: Wanted) -> Columns:
    """The columns of a file, read by a process of its own.

    Raises RunError when the file cannot be read, the process that reads it ends without an answer, or a package is
    missing.
    """
    return Columns(**_asked("read", reader, path, group, wanted))


def listed_apart(reader: str, path: Path) -> list[Listed]:
    """Every channel of a file, as `read_apart` reads it."""
    return [Listed(**one) for one in _asked("listed", reader, path, "", [])]


def _asked(what: str, reader: str, path: Path, group: str, wanted: Wanted) -> Any:
    need(NEEDS[reader])
    with open_plain(path, MAX_BYTES) as stream:  # refuses what is no file, or too large
        megabytes = os.fstat(stream.fileno()).st_size // 1_000_000
    words = [str(MOST_CPU_S + MOST_CPU_S_PER_MB * megabytes), what, reader, str(path), group, json.dumps(list(wanted))]
    command = [sys.executable, "-P", "-W", "ignore", "-m", "rig.exchange.binary.apart", *words]
    try:
        done = subprocess.run(command, capture_output=True, timeout=GIVEN_UP_S, check=False)
        answer = json.loads(done.stdout) if done.returncode == 0 else {}
    except (subprocess.TimeoutExpired, ValueError):
        answer = {}
    if "refused" in answer:
        raise RunError(answer["refused"])
    if "found" not in answer:
        raise RunError(f"{path}: not a {reader} file that can be read: its reader broke down over it; is it damaged?")
    return answer["found"]


def answer(what: str, reader: str, path: Path, group: str, wanted: Wanted) -> dict[str, Any]:
    """What a file holds, or why it is refused, as JSON."""
    module = importlib.import_module(f"rig.exchange.binary.{reader}")
    try:
        if what == "listed":
            return {"found": [dataclasses.asdict(one) for one in module.listed(path)]}
        return {"found": dataclasses.asdict(module.read(path, group, wanted))}
    except RunError as error:
        return {"refused": str(error)}
    except Exception as error:  # whatever a damaged file makes a package stumble over
        return {"refused": f"{path}: not a {reader} file that can be read ({shown(str(error), 100)})"}


def main() -> int:
    """Answer a command line."""
    seconds, what, reader, path, group, wanted = sys.argv[1:]
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    except ImportError:  # Windows
        pass
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a package prints is no answer
    with out:
        json.dump(answer(what, reader, Path(path), group, json.loads(wanted)), out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
