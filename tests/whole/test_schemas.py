"""The JSON Schemas: as the code has them, and what they take and refuse."""

import json
import tomllib

import jsonschema
import pytest

from configs import FOLDER
from scripts import schemas
from tests.documented_commands import ROOT
from tests.synthetic_runs import write_sweep

OF_FOLDER = {"benches": "bench", "imports": "import", "motors": "motor"}
FILES = [ROOT / "logs" / "published_sweep" / "recording.toml", *sorted(FOLDER.glob("*/*.toml"))]


def validator(name):
    return jsonschema.Draft202012Validator(json.loads((schemas.SCHEMAS / f"{name}.json").read_text(encoding="utf-8")))


def schema_of(path, table):
    if path.name == "recording.toml":
        return validator("recording")
    return validator(OF_FOLDER.get(path.parent.name) or f"instrument_{table['family']}")


def test_they_are_made_from_the_code():
    made = {f"{name}.json": schemas.text_of(name, model) for name, model in schemas.models().items()}
    kept = {path.name: path.read_text(encoding="utf-8") for path in schemas.SCHEMAS.iterdir()}
    assert kept == made, "not as the code has it: run `make pages`"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_they_take_what_is_shipped_and_refuse_a_misspelt_key(path):
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    schema = schema_of(path, table)
    assert [error.message for error in schema.iter_errors(table)] == []
    assert not schema.is_valid(table | {"colour": 1})
    assert not schema.is_valid({key: value for key, value in table.items() if key != "format"})


def test_they_take_the_lines_of_a_run(tmp_path):
    run = write_sweep(tmp_path)
    for name in ("start", "end"):
        validator(f"run_{name}").validate(json.loads((run / f"{name}.json").read_text(encoding="utf-8")))
    for file, name in (("events", "event"), ("wire", "wire")):
        for line in (run / f"{file}.jsonl").read_text(encoding="utf-8").splitlines():
            validator(f"run_{name}").validate(json.loads(line))
