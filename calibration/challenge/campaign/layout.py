"""The folder of a campaign, its public file, and the rig that made it."""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, cast, get_type_hints

FORMAT = "challenge/1"
SECOND_RIG = "calibration.challenge.second_rig"
CAMPAIGN, FROZEN, VERDICTS, HASHES = "campaign.json", "frozen.json", "verdicts.parquet", "recordings.sha256"
RECORDING = "recording.toml"
RECORDING_SUFFIXES = (".csv", ".toml")


class ChallengeError(ValueError):
    """A campaign that cannot be made, run or scored as asked; the message says what to do."""


class Maker(Protocol):
    """What a rig offers: a module with these functions, and the class of its truths."""

    Truth: Callable[..., Any]

    def draw(self, family: str, index: int, seed: int) -> Any:
        """A truth: a dataclass that JSON can hold."""

    def make_recording(self, truth: Any, folder: Path) -> None:
        """Write its recording/1."""

    def follow_up(self, truth: Any, test: Any, folder: Path) -> None:
        """Write its recording with a further test."""

    def separable(self, truth: Any, folder: Path) -> Any:
        """Size and likeness of its signatures."""


def maker_of(name: str) -> Maker:
    """A rig by the name of its module."""
    try:
        return cast(Maker, importlib.import_module(name))
    except ImportError as problem:
        raise ChallengeError(f"the rig {name} cannot be imported: {problem}") from None


def plain(value: Any) -> Any:
    """A dataclass or a mapping as JSON gives it back."""
    data = asdict(value) if hasattr(value, "__dataclass_fields__") else value
    return json.loads(json.dumps(data))


def canonical(data: Any) -> bytes:
    """JSON with one spelling, so that its hash means something."""
    return json.dumps(data, sort_keys=True, separators=(",", ":")).encode()


def sha256(content: bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(content).hexdigest()


def recording_sha256(folder: Path) -> str:
    """Hash of a recording's files, names and contents."""
    parts = [(path.name, sha256(path.read_bytes())) for path in sorted(folder.iterdir())]
    return sha256(canonical(parts))


def case_name(index: int) -> str:
    """Name of a case: its recording's folder, its verdict's file."""
    return f"case{index:04d}"


@dataclass(frozen=True)
class Campaign:
    """A campaign on disk, and what may be known of it before it is scored.

    `only`: the one category it was limited to; empty for all.
    """

    folder: Path
    name: str
    family: str
    maker: str
    only: str
    cases: int
    truth_sha256: str

    @property
    def recordings(self) -> Path:
        """Folder of the recordings."""
        return self.folder / "recordings"

    @property
    def names(self) -> list[str]:
        """Names of the cases."""
        return [case_name(index) for index in range(self.cases)]

    def seed(self, index: int) -> int:
        """Of a case's diagnosis."""
        return int(sha256(f"{self.name}/{index}".encode())[:8], 16)

    def public(self) -> dict[str, Any]:
        """What campaign.json says."""
        data = asdict(self)
        del data["folder"]
        return {"format": FORMAT} | data


def read_campaign(folder: Path) -> Campaign:
    """A campaign that `make` has made. Raises ChallengeError when there is none."""
    place = folder / CAMPAIGN
    try:
        data = json.loads(place.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ChallengeError(
            f"{folder} holds no campaign ({CAMPAIGN} is missing): `spinbench challenge make` it"
        ) from None
    except ValueError:
        raise ChallengeError(f"{place} is not JSON: it was changed after it was made") from None
    if not isinstance(data, dict) or data.pop("format", None) != FORMAT:
        raise ChallengeError(f"{place}: not of format {FORMAT}")
    kinds = {key: kind for key, kind in get_type_hints(Campaign).items() if key != "folder"}
    wrong = sorted(
        {key for key, kind in kinds.items() if not isinstance(data.get(key), kind)} | (set(data) - set(kinds))
    )
    if wrong:
        raise ChallengeError(f"{place}: {', '.join(wrong)}: not as it was made; the file was changed after that")
    return Campaign(folder=folder, **data)
