"""JSON that commands wrote, held against the shipped schemas, with no key that is not described there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import jsonschema

from scripts import schemas

OTHER = {str: 1, int: "1", float: "1", bool: "yes", list: {}, dict: [], type(None): True}


def validator(name: str, closed: bool = False) -> jsonschema.Draft202012Validator:
    """Of a shipped schema. `closed`: it takes no key that it does not describe."""
    text = (schemas.SCHEMAS / f"{name}.json").read_text(encoding="utf-8")
    text = text.replace('"additionalProperties": true', '"additionalProperties": false') if closed else text
    return jsonschema.Draft202012Validator(json.loads(text))


def check(document: Mapping[str, Any]) -> None:
    """Hold a document against the schema of its format; it may miss no key, nor have one of another type."""
    name = document["format"].partition("/")[0]
    document = json.loads(json.dumps(document))
    validator(name, closed=True).validate(document)
    shipped = validator(name)
    optional = set(shipped.schema.get("properties", {})) - set(shipped.schema.get("required", document))
    for key, value in document.items():
        assert not shipped.is_valid(document | {key: OTHER[type(value)]}), f"{key} of another type is taken"
        less = {other: one for other, one in document.items() if other != key}
        assert key in optional or not shipped.is_valid(less), f"{key} may be missing"
