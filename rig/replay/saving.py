"""A replay kept as a run of its own, which names the run that it is of."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from rig.bench.bench import Bench
from rig.plateaus.plateau import mean_of
from rig.readings import NS
from rig.runlog import Run, RunWriter, read_run
from rig.runlog.phases import quantity_channels, series
from rig.runlog.start import source


def writer_for(run: Run, bench: Bench, logs: Path) -> RunWriter:
    """The run that a replay is written to: the old one's start record, with what it was decoded with now."""
    sources = {name: source(text) for name, text in bench.sources.items()}
    start = run.start.model_copy(update={"kind": "replay", "parent": run.name, "sources": sources})
    return RunWriter.create(logs, start)


def retake_plateaus(run: Run, writer: RunWriter) -> int:
    """Take the plateaus of a run anew, over the same times, from the samples of its replay.

    `writer`: where its replay is being written; every exchange is in it.
    Returns plateaus written [-].
    """
    new = read_run(writer.folder)
    channels = quantity_channels(new)
    for old in run.plateau_rows:
        row = {field.name: getattr(old, field.name) for field in fields(old) if field.name != "means"}
        for column, channel in channels.items():
            read = series(new, channel, old.start_s, old.end_s)
            mean = mean_of(read.time_ns / NS, read.value, read.censored)
            if mean.mean is not None:
                row |= mean.cells(column)
        writer.plateau(row)
    return len(run.plateau_rows)
