"""Where recordings come from, in words for a page, which escapes them."""

from __future__ import annotations

from collections.abc import Sequence

from rig.recording import Recording

SIMULATED = "(simulated)"  # in what an export says of the calibration of a virtual bench's instruments
WORDS = {
    "date": "taken {}",
    "operator": "by {}",
    "motor_serial": "motor no. {}",
    "oil": "oil: {}",
    "note": "note: {}",
    "parent": "after {}",
}


def name_of(recordings: Sequence[Recording]) -> str:
    """What recordings are called together: their folders' names, each once."""
    folders = dict.fromkeys(folder for one in recordings for folder in one.folders)
    return " and ".join(folder.resolve().name for folder in folders)


def origins(recordings: Sequence[Recording]) -> list[str]:
    """A line for each recording that says where it comes from, with its name ahead where there are several."""
    lines = []
    for one in recordings:
        told = [words.format(one.origin[key]) for key, words in WORDS.items() if one.origin.get(key)]
        if any(SIMULATED in (channel.calibrated or "") for channel in one.channels.values()):
            told.insert(0, "readings of a simulated bench")
        if told:
            said = "; ".join(told)
            lines.append(f"{one.folder.resolve().name}: {said}" if len(recordings) > 1 else said)
    return list(dict.fromkeys(lines))
