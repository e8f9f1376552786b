"""A chain on disk: blocks as they are made, each whole or not at all, and whose chain it is."""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

import numpy as np

from rig.recording import Recording
from rig.recording.files import write_file

MARK = "fingerprint"  # a file beside the chain: whose it is


def of_readings(recording: Recording) -> str:
    """What a recording holds, as a text: its hash, or that of its readings where it was never read from a folder."""
    if recording.sha256:
        return recording.sha256
    digest = hashlib.sha256()
    for file in recording.files:
        said = (file.file, file.kind, file.start_s, file.noise_scale, file.added_inertia_kg_m2, *file.columns)
        digest.update(repr(said).encode())
        for column in file.columns.values():
            digest.update(column.values.tobytes() + column.censor.tobytes())
    return digest.hexdigest()


class ChainError(ValueError):
    """The chain on disk belongs to another fit, or cannot be read."""


def refuse_another(folder: Path, fingerprint: str) -> None:
    """Refuse a folder that holds the chain of another fit.

    Raises ChainError when it does, or nothing says whose chain it holds.
    """
    mark = folder / MARK
    if mark.exists():
        if mark.read_text(encoding="utf-8") != fingerprint:
            raise ChainError(
                f"{folder}: holds the chain of another recording, motor, setting or version of the program; name "
                "another folder with -o, or remove this one"
            )
    elif any(folder.glob("block_*.npz")):
        raise ChainError(
            f"{folder}: holds a chain of which nothing says whose it is; name another folder with -o, or remove "
            "this one"
        )


class Store:
    """Blocks of a chain in a folder; nothing is kept when there is no folder."""

    def __init__(self, folder: Path | None, fingerprint: str) -> None:
        self.folder = folder
        if folder is None:
            return
        refuse_another(folder, fingerprint)
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / MARK).exists():
            write_file(folder / MARK, fingerprint.encode())

    def blocks(self) -> list[dict[str, np.ndarray]]:
        """The blocks there are, in order, up to the first that is missing."""
        found: list[dict[str, np.ndarray]] = []
        while self.folder is not None and (path := self.folder / f"block_{len(found):05d}.npz").exists():
            try:
                with np.load(path, allow_pickle=False) as stored:
                    found.append({name: stored[name] for name in stored.files})
            except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
                raise ChainError(f"{path}: cannot be read ({error}); remove {self.folder} to start afresh") from None
        return found

    def write(self, number: int, block: dict[str, np.ndarray]) -> None:
        """Write one block whole or not at all."""
        if self.folder is None:
            return
        path = self.folder / f"block_{number:05d}.npz"
        stream = io.BytesIO()
        np.savez(stream, **block)  # type: ignore[arg-type]
        write_file(path, stream.getvalue())
