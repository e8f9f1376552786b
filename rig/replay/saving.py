"""A replay kept as a run of its own, which names the run that it is of."""

from __future__ import annotations

from pathlib import Path

from rig.bench import Bench
from rig.runlog import Run, RunWriter
from rig.runlog.start import source


def writer_for(run: Run, bench: Bench, logs: Path) -> RunWriter:
    """The run that a replay is written to: the old one's start record, with what it was decoded with now.

    Parameters
    ----------
    run : Run
        What is replayed.
    bench : Bench
        What it is decoded with.
    logs : Path
        Where runs are kept.
    """
    sources = {name: source(text) for name, text in bench.sources.items()}
    start = run.start.model_copy(update={"kind": "replay", "parent": run.name, "sources": sources})
    return RunWriter.create(logs, start)
