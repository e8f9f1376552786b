"""What can be done next, given what lies in the logs folder: for whoever types `spinbench` alone."""

from __future__ import annotations

from pathlib import Path

Step = tuple[str, str]  # what for, and the command


def next_steps(logs: Path) -> tuple[str, list[Step]]:
    """What there is, in a sentence, and what can be done next, the likeliest first."""
    from rig.runlog.listing import find_run
    from rig.runlog.reader import BEING_WRITTEN, KILLED, read_end, read_start, state_of

    watch = ("watch the bench in a browser", "spinbench console virtual")
    try:
        newest = find_run("last", logs)
        start, end = read_start(newest), read_end(newest)
    except ValueError as error:
        there = "There are no runs here yet." if _is_empty(logs) else f"The newest run cannot be read: {error}"
        return there, [
            ("try a bench that is not there", "spinbench sweep virtual --minutes-running 0"),
            watch,
            ("examine your own bench's file and cables", "spinbench doctor lab"),
            ("fit the sweep that comes with the program", "spinbench fit published_sweep -o out/fit"),
        ]
    from rig.runlog.folder import is_locked

    state = state_of(end, end is None and is_locked(newest))
    said = f"The newest run is {newest.name}: {state}."
    show = ("read what happened in it", "spinbench runs show last")
    if state == BEING_WRITTEN:
        return said, [watch, show]
    if state == KILLED:
        return said, [("seal it", "spinbench runs repair last"), show]
    if state != "finished":
        again = ("take the levels that are left", f"spinbench sweep {start.bench} --continue last")
        return said, [show, *([again] if start.kind == "sweep" else []), watch]
    diagnose = ("ask whether the model explains it", "spinbench diagnose last -o out/diagnosis")
    if start.kind not in ("sweep", "manual"):
        diagnose = ("ask whether the model explains it", "spinbench diagnose last --with-parents -o out/diagnosis")
    fit = ("find f_overall and how sure it is", "spinbench fit last -o out/fit")
    return said, [diagnose, fit, ("see that its bytes give the same readings", "spinbench replay last"), show, watch]


def _is_empty(logs: Path) -> bool:
    from rig.runlog.listing import list_runs

    return not list_runs(logs)


def shown(logs: Path) -> str:
    """The same as lines for the terminal."""
    said, steps = next_steps(logs)
    width = max(len(command) for _, command in steps)
    lines = [f"  {command:<{width}}   {what}" for what, command in steps]
    return "\n".join([said, "What can be done next:", *lines, "All commands: spinbench --help"])
