"""posterior/1, diagnosis/1, comparison/1 and reveal/1."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema

from calibration.diagnosis.changes import Answer
from calibration.diagnosis.next_test.promised import Kept
from calibration.diagnosis.steps.confirm import Predicted
from calibration.diagnosis.steps.locate import Place
from calibration.fit.posterior import FitQuality, SuspectRow
from calibration.likelihood.expected import Capture
from spinbench.documents.parts import Dated, Document, Figures, FileRows

# posterior/1


class Parameter(Figures):
    """An unknown of a fit, in its unit."""

    unit: str
    q50: float


class Convergence(Document):
    """How well the chain has converged."""

    rhat_max: float
    ess_min: float
    acceptance: float
    steps: int
    walkers: int
    ensembles: int


class Posterior(Document):
    """posterior/1: what `spinbench fit` writes. `recordings`: of several, along their dates."""

    format: Literal["posterior/1"]
    parameters: dict[str, Parameter]
    convergence: Convergence
    suspect_rows: list[SuspectRow]
    fit_quality: FitQuality | None
    files: list[FileRows]
    seconds: float
    recordings: list[Dated] = Field(default_factory=list)


# diagnosis/1


class Mismatch(Document):
    """Of the base model; `beyond_the_draws`: the p-value is of a fitted tail."""

    p_value: float
    beyond_the_draws: bool


class Size(Figures):
    """A parameter of an effect. `unit`: of a machine that is not the article's motor; else it is in the name."""

    unit: str = ""


class EffectOfEach(Dated):
    """An effect in one of several recordings."""

    parameters: dict[str, Size]


class Effect(Document):
    """An effect that the verdict rests on. `recordings`: where each has a size of its own."""

    id: str
    probability: float
    log10_bayes_factor: float | None
    parameters: dict[str, Size]
    recordings: list[EffectOfEach] = Field(default_factory=list)


class Term(Document):
    """A law that was found from the data."""

    balance: str
    expression: str
    unit: str
    stability: list[float]


class HeldOut(Document):
    """How well readings were predicted that were held out; by channel what the names say."""

    kind: Predicted
    scheme: str
    folds: int
    same_set_in_folds: int
    rmse_before: dict[str, float | None]
    rmse_after: dict[str, float | None]
    rms_of_readings: dict[str, float | None] = Field(default_factory=dict)
    elpd_gain: float
    elpd_gain_se: float
    elpd_gain_of_declared_figures: float = 0.0


class Improvement(Document):
    """What the effects improve."""

    held_out: HeldOut | None


class NextTest(Document):
    """A recommended test.

    `information_nats`, `range_nats`: what it is expected to give; and least and most, by which explanation is true.
    `repeats`: how often it has to be taken until it decides; null where no number does.
    """

    test: str
    separates: list[str]
    information_nats: float
    range_nats: tuple[float, float] | None = None
    repeats: int | None
    needs: str
    command: str
    capture: Capture | None


class Rival(Document):
    """A set of effects that the next tests are to tell apart."""

    effects: list[str]
    log_evidence: float
    probability: float


class Resolved(Document):
    """From which size on an effect would have been seen, and told from the nearest one; null: not at all."""

    id: str
    parameter: str
    seen_from: float | None
    told_from: float | None
    nearest: str
    rho: float | None


class MadeOf(Document):
    """A recording that was diagnosed; the folder as seen from the one that the diagnosis is in."""

    folder: str
    sha256: str
    without: list[str]
    origin: dict[str, str] = Field(default_factory=dict)


class Left(Document):
    """What the named effects leave of the mismatch."""

    p_value: float | None
    share_of_mismatch: float | None


class Nuisance(Document):
    """An unknown that every fit carries."""

    mean: float | None
    sd: float | None
    unit: str


class Noise(Document):
    """The noise of an array of readings, in declared ones, and its correlation from one to the next."""

    readings: str
    scale: float | None
    correlation: float | None


class Diagnosis(Document):
    """diagnosis/1: what `spinbench diagnose` writes. From `rig` on: of machines that are not the article's motor.

    `per_recording`: ids of effects whose sizes were asked to be each recording's own.
    """

    format: Literal["diagnosis/1"]
    verdict: Literal["consistent", "named", "confounded", "unresolved"]
    mismatch: Mismatch
    located: list[Place]
    set_probability: float
    effects: list[Effect]
    alternatives: list[list[str]]
    term: Term | None
    improvement: Improvement
    f_overall_before: Figures | None
    f_overall_after: Figures | None
    next_tests: list[NextTest]
    rivals: list[Rival]
    promised: list[Kept]
    suspect_rows: list[SuspectRow]
    resolves: list[Resolved]
    not_observable: list[str]
    check: list[str]
    why: str
    files: list[FileRows]
    recordings: list[MadeOf] = Field(default_factory=list)
    per_recording: list[str] = Field(default_factory=list)
    rig: str = ""
    left: Left | None = None
    nuisances: dict[str, Nuisance] = Field(default_factory=dict)
    noise: list[Noise] = Field(default_factory=list)
    friction_unit: str = ""


class GoneOnWith(Document):
    """What `diagnose --continue` reads of a diagnosis/1."""

    recordings: list[MadeOf]
    per_recording: list[str] = Field(default_factory=list)
    next_tests: list[NextTest]
    rivals: list[Rival] = Field(default_factory=list)
    promised: list[Kept] = Field(default_factory=list)


# comparison/1


class Explanation(Document):
    """What changed, and the effects that both recordings have."""

    changed: list[str]
    shared: list[str]
    probability: float
    log_evidence: float
    refused: str | None


class Moved(Document):
    """A quantity in both recordings, in its unit."""

    unit: str
    before: Figures
    after: Figures
    change: Figures


class Change(Document):
    """Something that may have changed. `of`: ``motor``, or where the effect acts."""

    id: str
    of: str
    listed: bool
    probability: float
    refused: str | None
    log10_bayes_factor: float | None
    parameters: dict[str, Moved]


class Comparison(Document):
    """comparison/1: what `spinbench compare` writes."""

    format: Literal["comparison/1"]
    recordings: list[Dated]
    verdict: Answer
    mismatch: Mismatch
    unchanged_probability: float | None
    explanations: list[Explanation]
    changes: list[Change]
    sets: list[Explanation]
    next_tests: list[NextTest]
    suspect_rows: list[SuspectRow]
    why: str
    files: list[FileRows]


# reveal/1


class HeldTo(Figures):
    """f_overall of a diagnosis, held to the true one; `holds`: whether the true one lies within its 90 %."""

    true: float
    holds: bool


class Score(Document):
    """What a diagnosis is worth against what was concealed."""

    concealed: list[str]
    category: str
    verdict: str
    named: list[str]
    score: str
    p_value: float
    f_overall: HeldTo | None


class Reveal(Document):
    """reveal/1: what `spinbench reveal` writes. `truth`: what was drawn; `score`: null without a diagnosis."""

    format: Literal["reveal/1"]
    bench: str
    truth: Annotated[dict[str, Any], WithJsonSchema({"type": "object"})]
    line: dict[str, float]
    truth_sha256: str
    score: Score | None
    only: str = ""
    salt: str = ""
    seed: int = 0
    sealed: str = ""
