"""What several documents hold."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Document(BaseModel):
    """What is written as a table of keys."""

    model_config = ConfigDict(extra="allow")


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
