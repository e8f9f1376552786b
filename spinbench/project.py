"""What a new project folder holds: files to begin from, which are the shipped ones with names of their own."""

from __future__ import annotations

import re

TITLE = 'format = "project/1"\ntitle = "{name}"\n'
NOTES = """# {name}

What no instrument tells: what was changed on the bench and when, oil, seals, calibrations, oddities.

- `motors/motor.toml`: the motor, each figure with its source
- `benches/bench.toml`: cables, instruments, levels; `spinbench doctor bench` looks at them
- `instruments/`, `imports/`: files of your own; one that is called as a shipped one is taken in its place
- `logs/`: the runs, which the program only adds to
"""


def files_of(name: str) -> dict[str, bytes]:
    """The files of a project that is called so, by their place in it."""
    from configs import FOLDER, PROJECT

    plain = re.sub(r"[^\w .-]", "", name) or "a bench"
    motor = (FOLDER / "motors" / "ptm3600.toml").read_text(encoding="utf-8")
    bench = (FOLDER / "benches" / "lab.toml").read_text(encoding="utf-8")
    texts = {
        PROJECT: TITLE.format(name=plain),
        "notes.md": NOTES.format(name=plain),
        "motors/motor.toml": _with(motor, "name", "motor"),
        "benches/bench.toml": _with(bench, "motor", "motor"),
    }
    return {place: text.encode() for place, text in texts.items()}


def _with(text: str, key: str, value: str) -> str:
    """A TOML text in which a key at its top has another value."""
    found = re.sub(rf'(?m)^{key} = ".*?"', f'{key} = "{value}"', text, count=1)
    if f'{key} = "{value}"' not in found:
        raise ValueError(f"the shipped file has no key {key}")
    return found
