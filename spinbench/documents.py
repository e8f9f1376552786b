"""The JSON that commands write, as types: `scripts/schemas.py` makes configs/schemas from them.

Numbers are SI unless a name ends in another unit. A later version may add keys, and takes none away.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, RootModel, WithJsonSchema, create_model

from calibration.diagnosis.changes import Answer
from calibration.diagnosis.next_test.promised import Kept
from calibration.diagnosis.steps.confirm import Predicted
from calibration.diagnosis.steps.locate import Place
from calibration.fit.posterior import FitQuality, SuspectRow
from calibration.likelihood.expected import Capture
from model.article.comparison import Comparison as OfArticle
from model.article.reproduction import StepRow
from model.motor import Readings
from model.operation.performance import OperatingPoint


class Document(BaseModel):
    """What is written as a table of keys."""

    model_config = ConfigDict(extra="allow")


def _with_fields(name: str, base: type[Document], kind: type) -> Any:
    """A document with the keys of another, and with the fields of a dataclass beside them."""
    fields: dict[str, Any] = {field: (annotation, ...) for field, annotation in get_type_hints(kind).items()}
    return create_model(name, __base__=base, **fields)


class Figures(Document):
    """A quantity: mean, standard deviation, and 5 and 95 % quantiles."""

    mean: float
    sd: float
    q05: float
    q95: float


class FileRows(Document):
    """How many rows of a file were used, and why not the rest."""

    file: str
    rows: int
    rows_used: int
    why: str


class Dated(Document):
    """A recording, and its date where it states one."""

    recording: str
    date: str | None


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
    recordings: list[Dated] = []


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
    recordings: list[EffectOfEach] = []


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
    rms_of_readings: dict[str, float | None] = {}
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
    origin: dict[str, str] = {}


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
    """diagnosis/1: what `spinbench diagnose` writes. From `rig` on: of machines that are not the article's motor."""

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
    recordings: list[MadeOf] = []
    rig: str = ""
    left: Left | None = None
    nuisances: dict[str, Nuisance] = {}
    noise: list[Noise] = []
    friction_unit: str = ""


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
    why: str
    files: list[FileRows]


# simulation/1, sensitivity/1 and reproduction/1: the model alone


class OfMotor(Document):
    """The motor: its parameters, each with its unit in the name, and how equations were read."""

    motor: str
    parameters: dict[str, float]
    readings: Readings


class _Simulated(OfMotor):
    format: Literal["simulation/1"]


_Point = _with_fields("Point", _Simulated, OperatingPoint)


class Sweep(_Simulated):
    """Several operating points."""

    points: list[OperatingPoint]


class InTime(_Simulated):
    """A run in time: lists by time."""

    transient: Literal["spin-up", "coast-down"]
    pressure_bar_abs: float
    time_s: list[float]
    speed_rpm: list[float]
    mean_speed_rpm: list[float]
    angle_rad: list[float]
    inlet_kg: list[float]
    outlet_kg: list[float]


class Simulation(RootModel):  # type: ignore[type-arg]
    """simulation/1: what `spinbench simulate` writes."""

    root: _Point | Sweep | InTime  # type: ignore[valid-type]


class Ranked(Document):
    """What a parameter does, a number for each pressure; null where the motor would stall, or there is no prior."""

    name: str
    unit: str
    value: float
    prior_step: str
    speed_rpm_per_percent: list[float | None]
    flow_l_min_per_percent: list[float | None]
    speed_rpm_per_prior_sd: list[float | None] | None
    flow_l_min_per_prior_sd: list[float | None] | None


class Sensitivity(OfMotor):
    """sensitivity/1: what `spinbench sensitivity` writes."""

    format: Literal["sensitivity/1"]
    pressure_bar_abs: list[float]
    ranking: list[Ranked]


class _Differing(Document):
    difference: float


_Compared = _with_fields("Compared", _Differing, OfArticle)


class Reproduction(Document):
    """reproduction/1: what `spinbench reproduce` writes; rows as docs/reproduction.md has them, units in the keys."""

    format: Literal["reproduction/1"]
    comparisons: list[_Compared]  # type: ignore[valid-type]
    plateaus: list[dict[str, float]]
    steps: list[StepRow]
    flow_peaks: list[dict[str, float]]
    steady_speed_rpm: float
    friction: dict[str, list[Any]]
    diameter: dict[str, list[Any]]


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


DOCUMENTS: dict[str, type[BaseModel]] = {
    "posterior": Posterior,
    "diagnosis": Diagnosis,
    "comparison": Comparison,
    "simulation": Simulation,
    "sensitivity": Sensitivity,
    "reproduction": Reproduction,
    "reveal": Reveal,
}
