"""Reading a file in a process of its own: a damaged one may take a library's compiled code down, or ask for all memory.

python -m rig.exchange.apart tdms data.tdms GROUP '["P", "n"]'     # JSON on standard output
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rig.runlog.folder import RunError

MOST_BYTES = 8_000_000_000  # of memory
MOST_S = 600.0


def read_apart(reader: str, path: Path, group: str, wanted: Sequence[str | int]) -> dict[str, Any]:
    """``place``, ``headings`` and ``columns`` of a file, read by a process of its own.

    Parameters
    ----------
    reader : str
        ``tdms`` or ``mat``.

    Raises
    ------
    RunError
        When the file cannot be read, or the process that reads it ends without an answer.
    """
    command = [sys.executable, "-P", "-m", "rig.exchange.apart", reader, str(path), group, json.dumps(list(wanted))]
    try:
        done = subprocess.run(command, capture_output=True, timeout=MOST_S, check=False)
        answer: dict[str, Any] = json.loads(done.stdout) if done.returncode == 0 else {}
    except subprocess.TimeoutExpired:
        answer = {}
    if "refused" in answer:
        raise RunError(answer["refused"])
    if not answer:
        raise RunError(f"{path}: not a {reader} file that can be read: its reader broke down over it; is it damaged?")
    return answer


def main() -> int:
    """Answer a command line with what a file holds, or with why it is refused."""
    from rig.exchange.tables import read_here

    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    except ImportError:  # Windows
        pass
    reader, path, group, wanted = sys.argv[1:]
    try:
        table = read_here(reader, Path(path), group, json.loads(wanted))
        answer = {"place": table.place, "headings": table.headings, "columns": table.columns}
    except RunError as error:
        answer = {"refused": str(error)}
    json.dump(answer, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
