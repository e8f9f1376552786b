"""`diagnose`: which physics a recording shows that the model leaves out; `compare`: what changed between two."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spinbench import readings
from spinbench.cli import options
from spinbench.cli.errors import kept_when_interrupted
from spinbench.cli.show import check_places, deliver, folder_of, own_stem, remark, write_report
from spinbench.earlier import RECORDINGS, Earlier, document_of, made_of, read_earlier
from spinbench.next_steps import bench_of, tests_of_bench
from spinbench.progress import diagnosing

if TYPE_CHECKING:
    from calibration.diagnosis.next_test.promised import Promise
    from calibration.diagnosis.result import Diagnosis
    from rig.recording import Recording

OutOption = Annotated[Path | None, options.out_folder("Write report.html, .png and diagnosis.json there.")]
HoldOutOption = Annotated[
    Path | None,
    typer.Option(
        "--hold-out", metavar="DIR", help="A recording that is kept back; what is named then has to predict it."
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=64,
        help="How many processes; the result is the same with any. Two if left out and there are two cores.",
    ),
]
ResumeOption = Annotated[
    Path | None,
    typer.Option(
        "--continue",
        metavar="OUT",
        help="Go on with the diagnosis in this folder, or file: its recordings, and those given now.",
    ),
]


@kept_when_interrupted(lambda out: "nothing is kept of an unfinished diagnosis; the same command begins again")
def diagnose(
    recording: options.RecordingsArgument,
    out: OutOption = None,
    json_file: options.JsonOption = None,
    seed: options.SeedOption = 1,
    hold_out: HoldOutOption = None,
    workers: WorkersOption = None,
    left_out: options.WithoutOption = None,
    resume: ResumeOption = None,
    parents: options.WithParentsOption = False,
    per_recording: options.PerRecordingOption = None,
    logs: options.LogsOption = options.LOGS,
) -> None:
    """Say whether the model explains a recording and, if not, which physics is missing; exit 0 with any verdict."""
    from calibration.data.joined import as_given
    from calibration.data.left_out import without
    from calibration.diagnosis.diagnose import diagnose as look
    from calibration.report.diagnosis.page import JSON
    from calibration.systems.several.sharing import own_of_each
    from rig.recording import files

    check_places(out, json_file)
    earlier = None if resume is None else read_earlier(resume)
    before = earlier.recordings if earlier else []
    among_many = earlier is not None or hold_out is not None
    named = [readings.folder_named(one, logs) for one in recording]  # once: another run may begin meanwhile
    new = readings.all_named(named, logs, parents, among_many, before)
    of_bench = bench_of(named[-1])
    unseen = None if hold_out is None else readings.read(readings.folder_named(hold_out, logs), among_many=True)
    readings.refuse_twice([*before, *new], unseen)
    parts = without([*(earlier.parts if earlier else []), *new], left_out or [])
    asked = [*(earlier.document.per_recording if earlier else []), *options.ids_in(per_recording)]
    sharing = own_of_each(asked, len(parts))
    given = as_given(parts, apart=bool(sharing.own))
    promise = _promised(earlier, new, resume)
    remark(*readings.warnings_in([one for one in (*given, unseen) if one is not None]))
    read = given[0] if len(given) == 1 else given
    with diagnosing() as tell:
        processes = workers or min(2, os.cpu_count() or 1)
        diagnosis = look(read, seed, tell, unseen, processes, [promise] if promise else [], sharing)
        diagnosis = tests_of_bench(diagnosis, *of_bench)
        recordings = made_of(earlier, new, left_out or [], out or Path())
        found = document_of(diagnosis, recordings, sharing.own, earlier.promised if earlier else [])
        page, table, words = _told_by(found)
        if out is not None:
            tell("report")
            write_report(out, {JSON: files.json_bytes(found)} | _pages(page, diagnosis, found), JSON)
    there = made_of(earlier, new, left_out or [], folder_of(json_file))
    deliver(files.json_bytes(found | {RECORDINGS: there}), [table(found)], json_file)
    print(words.sentence(found), file=sys.stderr)
    _warn(found, diagnosis)
    _tell_how_it_went(unseen, diagnosis, out, len(given))


def _promised(earlier: Earlier | None, new: Sequence[Recording], resume: Path | None) -> Promise | None:
    """What an earlier diagnosis promised of the new recordings; it is told where that is nothing."""
    if earlier is None:
        return None
    promise = earlier.promise(new)
    if promise is None:
        why = earlier.why_not(new)
        said = "nothing given now is a test that {} asks for" if why else "{} asked for no test"
        remark(f"{said.format(resume)}, so nothing was promised of what is given now", *why)
    return promise


@kept_when_interrupted(lambda out: "nothing is kept of an unfinished comparison; the same command begins again")
def compare(
    before: Annotated[
        Path, typer.Argument(metavar="A", help="The earlier one: the folder of a recording, or the name of a run.")
    ],
    after: Annotated[Path, typer.Argument(metavar="B", help="The later one, of the same motor.")],
    out: Annotated[Path | None, options.out_folder("Write report.html, .png and comparison.json there.")] = None,
    json_file: options.JsonOption = None,
    seed: options.SeedOption = 1,
    left_out: options.WithoutOption = None,
    logs: options.LogsOption = options.LOGS,
) -> None:
    """Say what changed from one recording of a motor to another, or that nothing did; exit 0 with any answer."""
    from calibration.data.rows_used import few_used
    from calibration.report.comparison import page, words
    from calibration.report.diagnosis.words import steps_in_words
    from rig.recording import files
    from spinbench.api import comparing

    check_places(out, json_file)
    given = [readings.read(readings.folder_named(named, logs), among_many=True) for named in (before, after)]
    parts, notes = comparing.both(given[0], given[1], left_out or [])
    remark(*notes)
    with diagnosing("comparison") as tell:
        found = comparing.compared(parts, notes, seed, tell, min(2, os.cpu_count() or 1))
        data = files.json_bytes(found.document)
        if out is not None:
            tell("report")
            write_report(out, {page.JSON: data} | page.report(found.found, found.document, found.notes), page.JSON)
    deliver(data, [words.table(found.document)], json_file)
    print(found.sentence, file=sys.stderr)
    remark(*few_used(found.document["files"]), steps_in_words(found.found.seconds))
    if out is not None:
        remark(f"the report is {out / 'report.html'}")


def _pages(page: Any, diagnosis: Any, found: Mapping[str, Any]) -> dict[str, bytes]:
    """The report; of several recordings a page each, the one with the most plateaus as the report too."""
    from calibration.diagnosis.result import of_each_recording

    parts = of_each_recording(diagnosis)
    if len(parts) == 1:
        return dict(page.report(*parts.values(), found))
    recordings = {name: part.comparison.problem.recording for name, part in parts.items()}
    stems = {name: own_stem(name) for name in parts}
    made = {}
    for name, part in parts.items():
        links = [
            page.OwnPage(other, f"{stems[other]}.html", page.holds(recordings[other]), other == name) for other in parts
        ]
        made[name] = page.report(part, found, links)

    def plateaus(name: str) -> int:
        return sum(file.rows for file in recordings[name].files if file.kind == "steady")

    further = {
        file.replace("report", stems[name]): content
        for name, written in made.items()
        for file, content in written.items()
    }
    return dict(made[max(parts, key=plateaus)]) | further


def _told_by(found: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """The page, the table and the words that tell of a diagnosis: of the article's motor, or of another machine."""
    if found.get("rig"):
        from calibration.report.machines import page as of_machine
        from calibration.report.machines import words as machine_words

        return of_machine, machine_words.table, machine_words
    from calibration.report.diagnosis import page, table, words

    return page, table.table, words


def _warn(found: Mapping[str, Any], diagnosis: Any) -> None:
    """Say of which files less than nine tenths of the rows were used, and what was too small to be seen."""
    from calibration.data.rows_used import few_used
    from calibration.report.diagnosis import sets

    remark(*few_used(found.get("files", [])))
    if not found.get("rig") and (blind := sets.blind_in_words(diagnosis)):
        print(blind, file=sys.stderr)


def _tell_how_it_went(unseen: Recording | None, found: Diagnosis, out: Path | None, count: int) -> None:
    """Say that a run was held out for nothing, how long each step took, and where the reports are.

    `count`: of recordings that have a page each.
    """
    from calibration.report.diagnosis.words import steps_in_words
    from spinbench.api.diagnosing import not_predicted

    if count > 1 and out is not None:
        remark(f"each of the {count} recordings has a page of its own there, report_NAME.html")
    remark(*not_predicted(unseen, found), steps_in_words(found.seconds))
    if out is not None:
        remark(f"the report is {out / 'report.html'}")
