"""The page of a run that has ended, written beside its files without being asked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from spinbench.next_steps import after, show_command

if TYPE_CHECKING:
    from calibration.report.run.page import Told
    from rig.recording import Recording
    from rig.runlog import Run

FEWEST = 3  # plateaus: the model follows almost any fewer
MOST_WRONG = 20
SEED = 1


def write(folder: Path) -> Path:
    """Hold the readings of a run against the model, and write its page into its folder; the page.

    Raises RunError when the folder holds no run that has ended; OSError when the page cannot be written.
    """
    from calibration.report.run.page import page
    from rig.recording.files import write_file
    from rig.runlog import read_run
    from rig.runlog.folder import PAGE

    run = read_run(folder)
    recording, notes, why_not = _recording(run)
    compared: tuple[Any, ...] = ()
    if recording is not None and not why_not:
        compared, why_not = _compared(recording)
    write_file(folder / PAGE, page(_told(run, notes, why_not), *compared))
    return folder / PAGE


def _recording(run: Run) -> tuple[Recording | None, list[str], str]:
    """What a run amounts to, what was left out of it, and why it cannot be held against the model."""
    from rig.exchange.export import recording_of
    from rig.runlog.folder import EmptyRunError

    try:
        exported = recording_of(run)
    except EmptyRunError as error:
        return None, [], str(error)
    count = sum(file.rows for file in exported.recording.files if file.kind == "steady")
    few = f"{count} plateau{'s' * (count != 1)} can be used, and {FEWEST} are needed." if count < FEWEST else ""
    return exported.recording, exported.notes, few


def _compared(recording: Recording) -> tuple[tuple[Any, ...], str]:
    """The model at its most probable point and whether it explains the readings; or why that cannot be told."""
    from calibration.fit_quality import judge_whole
    from rig.recording import RecordingError

    try:
        _, detected, quality = judge_whole([recording], SEED)
    except RecordingError as error:
        return (), str(error)
    return (detected, quality), ""


def _told(run: Run, notes: list[str], why_not: str) -> Told:
    from calibration.report.run.page import Told
    from rig.runlog.schema import ended
    from rig.runlog.tail import ALARMS

    how = ended(run.end.outcome, run.end.stopped_by, run.end.reason) if run.end is not None else run.state
    wrong = ["the line is not known to be vented: close the supply"] * (run.end is not None and run.end.vented is False)
    for event in run.events:
        if event.event in ALARMS:
            said = str(event.details.get("text") or event.details.get("error") or "")
            wrong.append(said if event.event == "warning" else f"{event.event}: {said}")
    wrong += [note for note in notes if not note.startswith(("simulated: ", "the run is "))]
    wrong = list(dict.fromkeys(wrong))
    more = [f"and {len(wrong) - MOST_WRONG} more; `{show_command(run.folder)}` lists events"]
    return Told(
        run.name,
        f"{run.start.kind} on {run.start.bench}{', simulated' if run.start.simulated else ''}",
        how,
        run.state == "finished",
        [*wrong[:MOST_WRONG], *(more if len(wrong) > MOST_WRONG else [])],
        after(run.folder, run.start, run.state, str(run.folder)),
        why_not,
    )
