"""`init`: a project folder, with files to begin from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spinbench.cli.show import remark

FOLDERS = ("motors", "benches", "instruments", "imports", "logs")


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Where; made if it is missing. Nothing in it is overwritten.")
    ] = Path(),
) -> None:
    """Make a project folder: your motor, bench, instruments, imports, notes and logs."""
    from rig.recording.files import write_files
    from rig.runlog.folder import RunError
    from spinbench.project import files_of

    inside = [folder / name for name in FOLDERS]
    taken = next((one for one in (folder, *folder.absolute().parents, *inside) if one.is_file()), None)
    if taken is not None:
        raise RunError(f"{taken}: a file, where a folder is to be made; name another folder")
    files = files_of(folder.absolute().name)
    there = [name for name in files if (folder / name).exists()]
    if there:
        raise RunError(f"{folder}: already there: {', '.join(there)}. Nothing is overwritten; name another folder")
    for one in inside:
        one.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_files((folder / name).parent, {Path(name).name: content})
    print(folder / "spinbench.toml")
    remark(
        f"edit {folder / 'motors' / 'motor.toml'} and {folder / 'benches' / 'bench.toml'}; then, in {folder}: "
        "spinbench doctor bench"
    )
