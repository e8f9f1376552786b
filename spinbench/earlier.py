"""`diagnose --continue`: the recordings of an earlier diagnosis once more, and what its next tests promised."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spinbench import readings

if TYPE_CHECKING:
    from calibration.diagnosis.next_test.promised import Promise
    from calibration.diagnosis.result import Diagnosis
    from calibration.likelihood.expected import Capture
    from rig.recording import Recording
    from spinbench.documents.of_recordings import GoneOnWith

RECORDINGS, PER_RECORDING = "recordings", "per_recording"
FOLDER, SHA256, WITHOUT, ORIGIN = "folder", "sha256", "without", "origin"


@dataclass(frozen=True)
class Earlier:
    """A diagnosis that is gone on with.

    `recordings`: that it was made of, as they were read.
    `sources`: those, as its document names them.
    """

    recordings: list[Recording]
    sources: list[dict[str, Any]]
    document: GoneOnWith

    @property
    def parts(self) -> list[Recording]:
        """The recordings without what was left out of them."""
        from calibration.data.left_out import without

        pairs = zip(self.recordings, self.sources, strict=True)
        return [part for one, source in pairs for part in without([one], source[WITHOUT])]

    @property
    def promised(self) -> list[dict[str, Any]]:
        """What tests before it gave."""
        return [asdict(one) for one in self.document.promised]

    def promise(self, taken: Sequence[Recording]) -> Promise | None:
        """What it promised of new recordings; None where they hold no test that it asked for."""
        from calibration.diagnosis.next_test.promised import Rival, asked_for

        rivals = {tuple(one.effects): Rival(one.log_evidence, one.probability) for one in self.document.rivals}
        return asked_for(self._tests(), rivals, taken)

    def why_not(self, taken: Sequence[Recording]) -> list[str]:
        """Why new recordings hold no test that it asked for, a sentence each; none where it asked for no test."""
        from calibration.diagnosis.next_test.promised import why_not

        if not self.document.next_tests:
            return []
        return [why_not([capture for _, _, capture in self._tests()], one) for one in taken]

    def _tests(self) -> list[tuple[str, float, Capture]]:
        """Each test that a bench takes by itself: its words, the nats promised [-], and what is to be taken."""
        return [(one.test, one.information_nats, one.capture) for one in self.document.next_tests if one.capture]


def read_earlier(out: Path) -> Earlier:
    """A diagnosis from the folder that its report was written to, or from its file.

    Raises RecordingError when there is none, it does not say what it was made of, or that is not as it was.
    """
    from calibration.diagnosis.document import FORMAT
    from calibration.report.diagnosis.page import JSON
    from configs import ConfigError, validate
    from rig.recording import RecordingError
    from rig.recording.mistakes import shown
    from spinbench.documents.of_recordings import GoneOnWith

    file = out if out.is_file() else out / JSON
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no JSON, or was cut off"
        raise RecordingError(f"{file}: no diagnosis to go on with ({why}); name what `diagnose -o` wrote") from None
    of = found.get("format") if isinstance(found, dict) else None
    if isinstance(of, str) and of != FORMAT and of.startswith(f"{FORMAT.partition('/')[0]}/"):
        raise RecordingError(f"{file}: of format {shown(of)}, and this version goes on from {FORMAT}; diagnose anew")
    if of != FORMAT or not found.get(RECORDINGS):
        raise RecordingError(f"{file}: it does not say what was diagnosed; name what `spinbench diagnose -o` wrote")
    try:
        document = validate(GoneOnWith, found, str(file))
    except ConfigError as error:
        raise RecordingError(f"{str(error).splitlines()[0]}; it was damaged: diagnose anew") from None
    recordings, sources = [], []
    for one in found[RECORDINGS]:
        folder, here = (file.parent / one[FOLDER]).resolve(), Path.cwd()
        folder = folder.relative_to(here) if folder.is_relative_to(here) else folder
        if not folder.is_dir():
            raise RecordingError(
                f"{folder} is not there any more, and {file} was made of it; it is looked for from where that file "
                "lies: move either back, or name all the recordings"
            )
        read = readings.read(folder, among_many=True)
        if read.sha256 != one[SHA256]:
            raise RecordingError(f"{folder} is not what {file} was made of: it was changed; diagnose it anew")
        recordings.append(read)
        sources.append(one | {FOLDER: str(folder)})
    return Earlier(recordings, sources, document)


def document_of(
    found: Diagnosis,
    recordings: Sequence[Mapping[str, Any]],
    per_recording: Iterable[str],
    promised: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    """A diagnosis as diagnosis/1, with what `diagnose --continue` reads of it.

    `recordings`: as `made_of` tells them.
    `promised`: what tests before it gave.
    """
    from calibration.diagnosis.document import as_json

    document = as_json(found)
    document["promised"] = [*promised, *document["promised"]]
    further = {RECORDINGS: list(recordings), PER_RECORDING: sorted(per_recording)}
    return document | {key: told for key, told in further.items() if told}


def made_of(
    earlier: Earlier | None, new: Sequence[Recording], left_out: Sequence[str], place: Path | None
) -> list[dict[str, Any]]:
    """What a diagnosis was made of, for its document.

    `place`: the folder that the document is written to, from which folders are seen; None where that is not known:
        folders are then told in full.
    """
    from calibration.data.joined import names_of

    sources = list(earlier.sources) if earlier else []
    sources += [
        {
            FOLDER: str(one.folder),
            SHA256: one.read_sha256 or one.sha256,
            WITHOUT: list(one.left_out),
            ORIGIN: dict(one.origin),
        }
        for one in new
    ]
    names = names_of([*(earlier.recordings if earlier else []), *new])
    found = []
    for source, name in zip(sources, names, strict=True):
        ahead = f"{name}/" if len(names) > 1 else ""
        also = [asked.removeprefix(ahead) for asked in left_out if asked.startswith(ahead)]
        whole = Path(source[FOLDER]).resolve()
        folder = str(whole) if place is None else os.path.relpath(whole, place.resolve())
        found.append(source | {FOLDER: folder, WITHOUT: [*source[WITHOUT], *also]})
    return found
