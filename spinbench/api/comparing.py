"""What changed between two recordings of one motor: how it is looked for, for the command line too, and a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from calibration.diagnosis.changes import compare as look
from calibration.diagnosis.changes_document import as_json
from calibration.diagnosis.result import Diagnosis
from calibration.work.step_clock import Tell
from rig.recording import Recording
from spinbench.api.frames import as_html, of_next_tests
from spinbench.api.opened import Data, at_least, opened_all

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

FIGURES = [f"{when}_{figure}" for when in ("before", "after", "change") for figure in ("mean", "sd", "q05", "q95")]


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult:
    """What `compare` found; a notebook shows the answer, the changes and the next tests.

    Attributes
    ----------
    found : Diagnosis
        Everything, step by step.
    notes : tuple of str
        What was left out or assumed of the recordings, a sentence each.
    """

    found: Diagnosis
    notes: tuple[str, ...] = ()

    @cached_property
    def document(self) -> dict[str, Any]:
        """As comparison/1: what `spinbench compare --json` writes."""
        return as_json(self.found)

    @property
    def verdict(self) -> str:
        """``unchanged``, ``changed``, ``confounded``, ``open`` or ``unresolved``."""
        return str(self.document["verdict"])

    @property
    def p_value(self) -> float:
        """How often chance alone leaves as large a mismatch of one motor that did not change [-]."""
        return float(self.document["mismatch"]["p_value"])

    @property
    def unchanged_probability(self) -> float | None:
        """Probability that nothing changed, among what was weighed [-]; None where unresolved."""
        given = self.document["unchanged_probability"]
        return None if given is None else float(given)

    @property
    def changed(self) -> list[str]:
        """What the explanation changes that the verdict rests on: parameters of the motor, and ids of effects."""
        return [name for one in self.document["explanations"][:1] for name in one["changed"]]

    @property
    def sentence(self) -> str:
        """The answer as a person would say it."""
        from calibration.report.comparison import words

        return words.sentence(self.document)

    @property
    def remarks(self) -> list[str]:
        """What else a person should know: files hardly used, and the notes."""
        from calibration.data.rows_used import few_used

        return [*few_used(self.document["files"]), *self.notes]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each quantity that may have changed: before, after and the change, in its unit.

        The likeliest of those that the verdict lists come first. Each row supposes that it is this that changed.
        """
        import pandas as pd

        columns = ["changed", "listed", "probability", "log10_bayes_factor", "refused", "parameter", "unit"]
        rows = [
            {"changed": one["id"], **{key: one[key] for key in columns[1:5]}, "parameter": name, "unit": size["unit"]}
            | {f"{when}_{key}": value for when in ("before", "after", "change") for key, value in size[when].items()}
            for one in self.document["changes"]
            for name, size in one["parameters"].items()
        ]
        return pd.DataFrame(rows, columns=[*columns, *FIGURES])

    @cached_property
    def sets(self) -> pd.DataFrame:
        """The explanations that were weighed, the likeliest first: what changed, and the effects that both have."""
        import pandas as pd

        rows = [one | {key: " + ".join(one[key]) for key in ("changed", "shared")} for one in self.document["sets"]]
        return pd.DataFrame(rows, columns=["changed", "shared", "probability", "log_evidence", "refused"])

    @cached_property
    def next_tests(self) -> pd.DataFrame:
        """Tests that would tell apart what is left open, the one that tells most first."""
        return of_next_tests(self.document)

    def plot(self) -> Figure:
        """The quantities that may have changed, before and after, with their 90 % intervals."""
        from calibration.report.comparison import page

        return page.picture(self.document)

    def __repr__(self) -> str:
        return f"<comparison, {self.verdict}: {self.sentence}>"

    def _repr_html_(self) -> str:
        tables = [one for one in (self.table, self.next_tests) if len(one)]
        return as_html(f"{self.verdict}. {self.sentence}", self.remarks, *tables)


def compare(before: Data | Recording, after: Data | Recording, seed: int = 1, *, workers: int = 1) -> ComparisonResult:
    """Say what changed from one recording of a motor to another, or that nothing did, as `spinbench compare` does.

    Parameters
    ----------
    before, after : Opened, Recording, str or Path
        The earlier one and the later one. A path is opened as `open` does.
    workers : int
        Processes that work side by side, where there are runs in time [-]; the result is the same. A script that asks
        for more than one needs ``if __name__ == "__main__":``.

    Raises
    ------
    RecordingError
        When a recording cannot be used, stands twice, or is of another motor than the other.
    TypeError
        For what is no recording, and for a number that is none.
    ValueError
        For fewer workers than one, and for a seed below 0.
    """
    from spinbench.progress import diagnosing

    at_least("workers", workers, 1)
    at_least("seed", seed, 0)
    parts, notes = both(before, after)
    with diagnosing("comparison") as tell:
        return compared(parts, notes, seed, tell, workers)


def both(
    before: Data | Recording, after: Data | Recording, left_out: Sequence[str] = ()
) -> tuple[list[Recording], list[str]]:
    """The two recordings as they are compared, and what is to be said of them.

    `left_out`: readings, as `without` takes them.
    """
    from calibration.data.dates import date_of
    from calibration.data.left_out import without

    given, notes = opened_all([before, after])
    parts = without(given, left_out)
    notes += [warning for part in parts for warning in part.warnings]
    dates = [date_of(part) for part in parts]
    if dates[0] and dates[1] and dates[0] > dates[1]:
        notes.append(f"{parts[1].folder} is the earlier one by its date; before and after are told in the order given")
    return parts, list(dict.fromkeys(notes))


def compared(parts: Sequence[Recording], notes: Sequence[str], seed: int, tell: Tell, workers: int) -> ComparisonResult:
    """What changed from the first of two recordings to the second. `notes`: what is to be said of them."""
    return ComparisonResult(look(parts[0], parts[1], seed, tell, workers), tuple(notes))
