"""Repeat a demonstration of docs/real-recordings.md on its public data: import by the mappings, diagnose, report.

    python scripts/demonstrate.py emps FOLDER            a demonstration, with the folder that holds its files
    python scripts/demonstrate.py all FOLDER             every one whose files are in the folder or below it

Results go to out/demonstrations/NAME, or where --out says. Exit code 2 where a file is missing.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

# name: what is imported as (files, mapping, recording), then the recording to diagnose and one to hold out.
DEMONSTRATIONS: dict[str, tuple[list[tuple[str, str, str]], str, str]] = {
    "emps": (
        [("DATA_EMPS.mat", "emps", "emps"), ("DATA_EMPS_PULSES.mat", "emps_pulses", "emps_pulses")],
        "emps",
        "emps_pulses",
    ),
    "dexpand": (
        [("RVE_air_PDLT_steady_states_designconditions.csv", "dexpand", "dexpand")],
        "dexpand",
        "",
    ),
    "cylinder": ([("Circle_?bar.csv", "pneumatic_cylinder_pressures", "cylinder")], "cylinder", ""),
    "baseball": ([("Ball_drops_data.xls", "ball_drops_baseball", "baseball")], "baseball", ""),
    "whiffle_ball": ([("Ball_drops_data.xls", "ball_drops_whiffle", "whiffle_ball")], "whiffle_ball", ""),
}


def main() -> int:
    """Import and diagnose; the exit code."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("name", choices=[*DEMONSTRATIONS, "all"])
    asked.add_argument("folder", type=Path)
    asked.add_argument("--out", type=Path, default=Path("out") / "demonstrations")
    given = asked.parse_args()
    names = list(DEMONSTRATIONS) if given.name == "all" else [given.name]
    done = [demonstrate(name, given.folder, given.out / name, given.name == "all") for name in names]
    if not any(done):
        print(
            f"demonstrate: {given.folder}: none of the files is there; docs/real-recordings.md says where they are from"
        )
        return 2
    return 0


def demonstrate(name: str, folder: Path, out: Path, may_lack: bool) -> bool:
    """Repeat one demonstration; whether its files were there.

    Parameters
    ----------
    name : str
        Of DEMONSTRATIONS.
    folder : Path
        Holds its files, or a folder in it does.
    out : Path
        Where recordings and results go.
    may_lack : bool
        Whether it is passed over where a file is missing.
    """
    imports, recording, held_out = DEMONSTRATIONS[name]
    found = [sorted(folder.rglob(pattern)) for pattern, _, _ in imports]
    for (pattern, _, _), files in zip(imports, found, strict=True):
        if not files:
            if not may_lack:
                print(f"demonstrate: {folder}: there is no {pattern} in it or below it", file=sys.stderr)
            return False
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    for (_, mapping, where), files in zip(imports, found, strict=True):
        spinbench("runs", "import", *files, "--mapping", mapping, "-o", out / where)
    unseen = ["--hold-out", out / held_out] if held_out else []
    spinbench("diagnose", out / recording, *unseen, "-o", out / "result")
    print(f"demonstrate: {name}: {out / 'result'}")
    return True


def spinbench(*words: object) -> None:
    """Run a command of spinbench; the program ends where it fails."""
    done = subprocess.run([sys.executable, "-m", "spinbench", *map(str, words)], check=False)
    if done.returncode:
        sys.exit(done.returncode)


if __name__ == "__main__":
    sys.exit(main())
