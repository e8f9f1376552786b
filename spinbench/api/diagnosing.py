"""A diagnosis, with a result that shows itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from calibration.diagnosis.result import Diagnosis, of_each_recording
from rig.recording import Recording, RecordingError
from spinbench.api.frames import as_html, of_next_tests
from spinbench.api.opened import Data, at_least, listed, opened_all, said_of
from spinbench.earlier import document_of, made_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult:
    """What `diagnose` found; a notebook shows the verdict, the effects and the next tests.

    Attributes
    ----------
    found : Diagnosis
        Everything, step by step.
    notes : tuple of str
        What was left out or assumed of the recordings, a sentence each.
    recordings : tuple of dict
        What was diagnosed, as diagnosis/1 tells it: ``folder``, ``sha256``, ``without``, ``origin``. Empty where
        something was read from no folder, or is several as one.
    per_recording : tuple of str
        Ids of the effects whose sizes are each recording's own.
    """

    found: Diagnosis
    notes: tuple[str, ...] = ()
    recordings: tuple[dict[str, Any], ...] = ()
    per_recording: tuple[str, ...] = ()

    @cached_property
    def document(self) -> dict[str, Any]:
        """As diagnosis/1: what `spinbench diagnose --json` writes, but with folders in full; for `--continue`."""
        return document_of(self.found, self.recordings, self.per_recording)

    @property
    def verdict(self) -> str:
        """``consistent``, ``named``, ``confounded`` or ``unresolved``."""
        return str(self.document["verdict"])

    @property
    def p_value(self) -> float:
        """How often chance alone leaves as large a mismatch where nothing is left out [-]."""
        return float(self.document["mismatch"]["p_value"])

    @property
    def effects(self) -> list[str]:
        """The ids of the effects that the verdict rests on."""
        return [one["id"] for one in self.document["effects"]]

    @property
    def sentence(self) -> str:
        """The verdict as a person would say it."""
        from calibration.report.diagnosis import words
        from calibration.report.machines import words as machine_words

        return (machine_words if self.document.get("rig") else words).sentence(self.document)

    @property
    def remarks(self) -> list[str]:
        """What else a person should know: files hardly used, and what would have been too small to be seen."""
        from calibration.data.rows_used import few_used
        from calibration.report.diagnosis import sets

        blind = "" if self.document.get("rig") else sets.blind_in_words(self.found)
        return [*few_used(self.document["files"]), *([blind] if blind else []), *self.notes]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each size of each effect that the verdict rests on; no rows where nothing is missing."""
        import pandas as pd

        from model.effects import effects

        columns = ["effect", "probability", "log10_bayes_factor", "recording", "parameter", "unit"]
        columns += ["mean", "sd", "q05", "q95"]
        rows = []
        for one in self.document["effects"]:
            known = effects().get(one["id"])
            units = {parameter.name: parameter.unit for parameter in known.parameters} if known else {}
            first = {"effect": one["id"], **{key: one[key] for key in columns[1:3]}}
            of_each = [("", one["parameters"])]
            of_each += [(each["recording"], each["parameters"]) for each in one.get("recordings", [])]
            sizes = [(whose, name, size) for whose, parameters in of_each for name, size in parameters.items()]
            rows += [
                first | {"recording": whose, "parameter": name, "unit": units.get(name, "-")} | size
                for whose, name, size in sizes
            ] or [first]
        return pd.DataFrame(rows, columns=columns)

    @cached_property
    def sets(self) -> pd.DataFrame:
        """The sets of effects that were weighed, the likeliest first; an empty set is the base model."""
        import pandas as pd

        rows = [
            {
                "effects": " + ".join(one.names),
                "probability": one.probability,
                "log_evidence": one.log_evidence,
                "left_p_value": self.found.residual_p.get(one.names),
                "refused": one.refused,
            }
            for one in self.found.candidates
        ]
        return pd.DataFrame(rows, columns=["effects", "probability", "log_evidence", "left_p_value", "refused"])

    @cached_property
    def next_tests(self) -> pd.DataFrame:
        """Tests that would tell apart what is left open, the one that tells most first."""
        return of_next_tests(self.document)

    def plot(self, recording: str | None = None) -> Figure:
        """Residuals before and after, and what else the report shows first.

        Parameters
        ----------
        recording : str, optional
            Which of several, by its name; the first if left out.

        Raises
        ------
        RecordingError
            When there is none of that name.
        """
        from calibration.report.diagnosis import page
        from calibration.report.machines.picture import picture

        if self.document.get("rig"):
            return picture(self.found)
        each = of_each_recording(self.found)
        name = next(iter(each)) if recording is None else recording
        if name not in each:
            raise RecordingError(f"no recording '{name}' was diagnosed; there are {', '.join(each)}")
        return page.picture(each[name], self.document)

    def __repr__(self) -> str:
        return f"<diagnosis, {self.verdict}: {self.sentence}>"

    def _repr_html_(self) -> str:
        tables = [one for one in (self.table, self.next_tests) if len(one)]
        return as_html(f"{self.verdict}. {self.sentence}", self.remarks, *tables)


def diagnose(
    data: Data | Recording | Sequence[Data | Recording],
    seed: int = 1,
    *,
    hold_out: Data | Recording | None = None,
    per_recording: str | Sequence[str] = (),
    workers: int = 1,
) -> DiagnosisResult:
    """Say whether the model explains a recording, or several of one motor, and which physics is missing if not.

    Parameters
    ----------
    data : Opened, Recording, str, Path, or a list of these
        A path is opened as `open` does.
    hold_out : Opened, Recording, str or Path, optional
        A recording that is kept back, and predicted at the end.
    per_recording : str or sequence of str
        Ids of effects whose sizes are each recording's own.
    workers : int
        Processes that work side by side [-]; the result is the same. A script that asks for more than one needs
        ``if __name__ == "__main__":``.

    Raises
    ------
    RecordingError
        When a recording cannot be used, stands twice, or is of another motor than the rest.
    EffectsError
        For an effect that there is not.
    TypeError
        For what is no recording, and for a number that is none.
    ValueError
        For fewer workers than one, and for a seed below 0.
    """
    from calibration.data.joined import as_given
    from calibration.diagnosis.diagnose import diagnose as look
    from calibration.systems.several.sharing import own_of_each
    from spinbench.next_steps import bench_of, tests_of_bench
    from spinbench.progress import diagnosing
    from spinbench.readings import refuse_twice

    at_least("workers", workers, 1)
    at_least("seed", seed, 0)
    parts, notes = opened_all(data)
    unseen, more = (None, []) if hold_out is None else _one(hold_out)
    refuse_twice(parts, unseen)
    sharing = own_of_each(listed("per_recording", per_recording), len(parts))
    given = as_given(parts, apart=bool(sharing.own))
    of_bench = bench_of(parts[-1].folder)
    can_be_read = all(one.sha256 and not one.joined for one in parts)
    recordings = made_of(None, parts, [], None) if can_be_read else []
    with diagnosing() as tell:
        read = given[0] if len(given) == 1 else given
        found = tests_of_bench(look(read, seed, tell, unseen, workers, [], sharing), *of_bench)
    notes = list(dict.fromkeys([*said_of(given, notes), *more, *not_predicted(unseen, found)]))
    return DiagnosisResult(found, tuple(notes), tuple(recordings), tuple(sorted(sharing.own)))


def not_predicted(unseen: Recording | None, found: Diagnosis) -> list[str]:
    """That a run was held out for nothing, in a sentence; none where it was predicted, or none was held out."""
    if unseen is None or found.unseen_run is not None:
        return []
    return [f"{unseen.folder} was not predicted: there is no set of effects to do it with"]


def _one(hold_out: Data | Recording) -> tuple[Recording, list[str]]:
    found, notes = opened_all(hold_out)
    if len(found) > 1:
        raise RecordingError(f"hold_out: {len(found)} recordings are given, and one is predicted; name one")
    return found[0], notes
