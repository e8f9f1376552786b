"""import/1: how columns of a table that was taken elsewhere become the columns of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from configs import FOLDER as CONFIGS
from configs import Strict, find, read_toml, validate
from rig.exchange.binary.columns import WAVEFORM_TIME
from rig.exchange.units import unit_of
from rig.recording.columns import MEASURED, NAMES, nearest
from rig.recording.contents import Kind
from rig.recording.mistakes import shown
from rig.recording.origin import mistake_in
from rig.recording.schema import Air, NotNegative, OriginTable, Positive
from rig.runlog.folder import RunError

FORMAT = "import/1"
FOLDER = CONFIGS / "imports"
OVER_RANGE = (
    *("OL", "+OL", "O.L", "0L", "0.L", "OVLD", "OVER", "+OVER", "+OVR", "OVERLOAD", "OVERRANGE", "OVER RANGE", "OFL"),
    *("OVER-RANGE", "OVERFLOW", "1.#INF", "+1.#INF", "INF", "+INF", "INFINITY", "+INFINITY", "∞"),
    *("+" * count for count in range(2, 9)),
)
INVALID = (
    *("NaN", "-NaN", "1.#QNAN", "-1.#IND", "1.#IND", "#N/A", "N/A", "NA", "NULL", "None"),
    *("ERR", "ERROR", "-OL", "UNDER", "-OVER", "-OVR", "-INF", "-1.#INF", "-INFINITY", "-∞", "BURNOUT"),
    *(
        "NAN(IND)",
        "-NAN(IND)",
        "NAN(SNAN)",
        "1.#IND00",
        "-1.#IND00",
        "1.#QNAN0",
        "#DIV/0!",
        "#NUM!",
        "#VALUE!",
        "#REF!",
    ),
    *(mark * count for mark in "-*" for count in range(1, 9)),
)


def _is_factor(value: float) -> float:
    if not 1e-12 <= abs(value) <= 1e12:
        raise ValueError("the size of a factor, of either sign, lies between 1e-12 and 1e12")
    return value


Factor = Annotated[float, pydantic.AfterValidator(_is_factor)]
Whole = Annotated[int, Field(ge=1, le=10_000_000)]


class StandardTable(Strict):
    """The state that a standard flow refers to."""

    pressure_bar_abs: Annotated[float, Field(ge=0.5, le=2.0)]
    temperature_c: Annotated[float, Field(ge=-50.0, le=50.0)]


class RotameterTable(Strict):
    """The gas that a rotameter's scale was made for, at its state."""

    gas: Literal["air", "nitrogen", "oxygen", "argon", "carbon dioxide", "helium"] = "air"
    pressure_bar_abs: Annotated[float, Field(ge=0.3, le=50.0)]
    temperature_c: Annotated[float, Field(ge=-50.0, le=200.0)]


class ColumnTable(Strict):
    """[columns.NAME]: where a column comes from, in which unit, and its instrument's 1-sigma figures."""

    # Its heading, or its place from 1; of a date and a time two, which are read as one.
    column: str | Whole | Annotated[list[str | Whole], Field(min_length=2, max_length=2)] | None = None
    constant: float | None = None  # in `unit`
    sample_period_s: Positive | None = None  # of `time_s`, where the source has no times
    unit: str = ""
    factor: Factor = 1.0  # of the source's number, such as -1 for a sign; the unit is that of the product
    pulses_per_rev: Positive | None = None  # of a pulse rate
    standard: StandardTable | None = None  # of a standard flow
    rotameter: RotameterTable | None = None  # of a flow that is read on a scale made for one state of one gas
    differentiate: bool = False  # the source is a length or an angle, the column its mean rate since the row before
    highest: float | None = None  # as the source writes it: what the instrument shows at most, over range is more
    drop_repeats: bool = False  # a value that the logger held is no reading
    words: dict[str, str] = Field(default_factory=dict)  # of `direction`: the source's word to up or down
    noise_sd: NotNegative | None = None
    bias_sd: NotNegative | None = None
    scale_sd: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    resolution: NotNegative | None = None

    @pydantic.model_validator(mode="after")
    def _comes_from_one_place(self) -> ColumnTable:
        if sum(one is not None for one in (self.column, self.constant, self.sample_period_s)) != 1:
            raise ValueError(
                "give one of column (a heading, or a place from 1), constant, and for time_s sample_period_s"
            )
        return self


class TableTable(Strict):
    """[table]: how the files are read."""

    reader: Literal["csv", "tdms", "mat", "xlsx", "hdf5", "mdf", "parquet"]
    delimiter: Literal[",", ";", "\t", "|", " "] | None = None
    decimal: Literal[".", ","] | None = None
    encoding: Literal["utf-8", "latin-1", "utf-16", "cp1252"] = "utf-8"
    heading_line: Annotated[int, Field(ge=0, le=1000)] = 1  # 0: there are no headings
    first_line: Whole | None = None  # of the data; the one after the headings when left out
    group: str = ""  # of a TDMS or MDF file, or the path of one in an HDF5 file
    sheet: str = ""  # of a workbook
    over_range: list[str] = Field(default_factory=lambda: list(OVER_RANGE))  # what stands where the range ended
    invalid: list[str] = Field(default_factory=lambda: list(INVALID))  # what stands where there is no reading

    @pydantic.model_validator(mode="after")
    def _text_says_its_marks(self) -> TableTable:
        if self.reader == "csv" and (self.delimiter is None or self.decimal is None):
            raise ValueError("a CSV file needs delimiter and decimal; they are said and never guessed")
        return self


class OnlyTable(Strict):
    """Takes the rows in which a column holds one number or word."""

    column: str | Whole
    equals: str | float


class FileTable(Strict):
    """[[files]]: what is made of one file; a file may stand in several entries."""

    file: str
    kind: Kind
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,60}$")] | None = None
    start_s: float = 0.0
    noise_scale: Positive = 1.0
    rows: Annotated[list[Whole], Field(min_length=2, max_length=2)] | None = None  # first and last, from 1
    only: OnlyTable | None = None
    average_rows: Whole = 1  # so many rows become one, their mean
    sheet: str = ""
    group: str = ""


class AmbientTable(Air, Strict):
    """[ambient]: the room, as in recording/1."""


class MappingFile(Strict):
    """A mapping file."""

    format: Literal["import/1"]
    title: str
    source: str  # who took the data, and where they are
    licence: str
    motor: str | dict[str, Any]  # a name in configs/motors, or the table of another rig
    kind: Kind | None = None  # of every file, when there is no [[files]]
    ambient: AmbientTable = AmbientTable()
    origin: OriginTable = OriginTable()
    table: TableTable
    columns: Annotated[dict[str, ColumnTable], Field(min_length=1)]
    files: Annotated[list[FileTable], Field(max_length=1000)] = Field(default_factory=list)


@dataclass(frozen=True)
class Mapping:
    """A mapping file with its name and its bytes."""

    path: Path
    file: MappingFile
    data: bytes


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Raises ConfigError when it is missing, or a key is wrong; RunError, a line each, when columns or units are wrong.
    """
    path = Path(path)
    if not path.suffix and not path.is_file():
        path = find("imports", path.name) or FOLDER / f"{path.name}.toml"
    file = validate(MappingFile, read_toml(path), str(path))
    mistakes = [f"{path}: {mistake}" for name, table in file.columns.items() for mistake in _mistakes(name, table)]
    mistakes += [f"{path}: {mistake}" for mistake in _taken_twice(file.columns)]
    if not file.files and file.kind is None:
        mistakes.append(f"{path}: the key 'kind' is missing; say steady, transient or zero, or list [[files]]")
    date = file.origin.date
    if date and (wrong := mistake_in(date)):
        mistakes.append(f"{path}: origin.date '{shown(date)}' {wrong}")
    if mistakes:
        raise RunError("\n".join(mistakes))
    return Mapping(path, file, path.read_bytes())


def _taken_twice(columns: dict[str, ColumnTable]) -> list[str]:
    """Where one column of the source is two readings."""
    taken: dict[object, str] = {}
    mistakes = []
    for name in MEASURED:
        key = columns[name].column if name in columns else None
        if isinstance(key, str | int) and taken.setdefault(key, name) != name:
            mistakes.append(f"columns.{name}: '{shown(str(key))}' is columns.{taken[key]} already")
    return mistakes


def _mistakes(name: str, table: ColumnTable) -> list[str]:
    place = f"columns.{shown(name)}"
    if name not in NAMES:
        return [f"{place}: no recording has this column{nearest(name)}; known: {', '.join(NAMES)}"]
    if table.sample_period_s is not None:
        return [] if name == "time_s" else [f"{place}: sample_period_s is of time_s alone"]
    try:
        unit = unit_of(name, "words" if name == "direction" else table.unit, table.differentiate)
    except RunError as error:
        return [f"{place}: {error}"]
    mistakes = []
    if unit.quantity == "standard flow" and table.standard is None:
        mistakes.append(
            f"{place}: '{table.unit}' refers to a standard state; say which in "
            "standard = {pressure_bar_abs = .., temperature_c = ..}"
        )
    if table.standard is not None and (table.rotameter is not None or unit.quantity == "mass flow"):
        what = "a flow of mass" if table.rotameter is None else "a rotameter's scale"
        mistakes.append(f"{place}: {what} refers to no standard state; take standard away")
    if table.rotameter is not None and unit.quantity != "flow":
        mistakes.append(f"{place}: a rotameter's scale is of a volume flow such as L/min, not of {unit.quantity}")
    if (unit.quantity == "pulse rate") != (table.pulses_per_rev is not None):
        mistakes.append(f"{place}: Hz needs pulses_per_rev, and no other unit takes it")
    if table.column == WAVEFORM_TIME and table.unit != "s":
        mistakes.append(f"{place}: '{WAVEFORM_TIME}' is in seconds, whatever the file has: unit = \"s\"")
    if isinstance(table.column, list) and unit.quantity != "time of day":
        mistakes.append(f"{place}: two columns are read as one for a date and a time alone")
    if table.highest is not None and name not in MEASURED:
        mistakes.append(f"{place}: this column is no instrument and has no highest")
    figures = (table.noise_sd, table.bias_sd, table.scale_sd, table.resolution)
    if name not in MEASURED and any(figure is not None for figure in figures):
        mistakes.append(f"{place}: this column is no instrument and has no figures")
    return mistakes
