"""The truths of a campaign, encrypted, beside the hash that was committed to before anything was run.

The key lies beside the seal unless it is put elsewhere: the seal keeps a program from looking by accident, and a key
kept by another person keeps that person's colleague from looking on purpose. The plain text holds random salt, so that
the hash, which is public from the start, cannot be tried against likely truths.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.challenge.campaign.layout import ChallengeError, canonical, sha256
from rig.recording.files import write_file

FOLDER, TRUTHS, KEY, HASH = "sealed", "truths.bin", "key", "hash"
CONCEALED = "concealed/1"  # format of what the seal of a bench that conceals something holds


class SealError(ChallengeError):
    """The truths cannot be opened, or are not those that were committed to."""


def seal(folder: Path, contents: Mapping[str, Any], key: Path | None = None) -> str:
    """Encrypt, and commit to a hash.

    `key`: where the key goes; into the seal's folder when left out.
    Returns SHA-256 of the plain text.
    """
    from cryptography.fernet import Fernet

    place = folder / FOLDER
    salted = canonical({"salt": secrets.token_hex(16), **contents})
    digest = sha256(salted)
    secret = _key(place / KEY if key is None else key)
    write_file(place / HASH, f"{digest}\n".encode())
    write_file(place / TRUTHS, Fernet(secret).encrypt(salted))  # last: where it is, the rest is
    return digest


def default_key() -> Path:
    """Where the key of a concealed bench lies when no other place is named: of the user, and away from every seal."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "spinbench" / "conceal.key"


def is_sealed(folder: Path) -> bool:
    """Whether a campaign has its seal."""
    return (folder / FOLDER / TRUTHS).exists()


def hash_of(folder: Path) -> str:
    """SHA-256 of what was sealed, which is public; empty where nothing is."""
    file = folder / FOLDER / HASH
    return file.read_text(encoding="ascii").strip() if file.is_file() else ""


def open_seal(folder: Path, key: Path | None = None) -> tuple[dict[str, Any], str]:
    """Decrypt.

    Returns `contents`: as sealed; `digest`: SHA-256 of the plain text, which is that in ``sealed/hash``. Raises
    SealError when a file is missing, the key does not fit, or the hash differs.
    """
    from cryptography.fernet import Fernet, InvalidToken

    place = folder / FOLDER
    try:
        locked = (place / TRUTHS).read_bytes()
        told = (place / HASH).read_text(encoding="ascii").strip()
        secret = (place / KEY if key is None else key).read_bytes().strip()
    except OSError as problem:
        raise SealError(
            f"{problem.filename}: {problem.strerror}; a seal is opened with its key: name that with --key"
        ) from None
    try:
        salted = Fernet(secret).decrypt(locked)
    except (InvalidToken, ValueError):
        raise SealError(
            f"{place / TRUTHS}: the key does not open it, or it was changed; give the key with --key"
        ) from None
    digest = sha256(salted)
    if digest != told:
        raise SealError(f"{place / HASH}: the truths are not those that were committed to ({digest} against {told})")
    contents: dict[str, Any] = json.loads(salted)
    return contents, digest


def _key(place: Path) -> bytes:
    """A new key, readable by its owner alone; one that is there already is used."""
    from cryptography.fernet import Fernet

    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        handle = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        secret = place.read_bytes().strip()
        try:
            Fernet(secret)
        except ValueError:
            raise SealError(f"{place} exists and is no key; name another file with --key") from None
        return secret
    secret = Fernet.generate_key()
    with os.fdopen(handle, "wb") as stream:
        stream.write(secret + b"\n")
    return secret
