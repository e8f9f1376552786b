"""The JSON Schemas: as the code has them, and what they take and refuse."""

import json
import tomllib

import pytest

import spinbench as sb
from calibration.report.model import simulation
from configs import FOLDER
from scripts import schemas
from tests.documented_commands import ROOT
from tests.documents import check, validator
from tests.synthetic_runs import write_sweep

OF_FOLDER = {"benches": "bench", "imports": "import", "motors": "motor"}
FILES = [ROOT / "logs" / "published_sweep" / "recording.toml", *sorted(FOLDER.glob("*/*.toml"))]


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


@pytest.mark.parametrize("pressures", [[2.0], [1.6, 2.0]])
def test_they_take_what_the_model_says(pressures):
    motor = sb.read_motor("ptm3600")
    check(simulation.points_data(motor, sb.operating_points(motor, [1e5 * bar for bar in pressures])))
    check(simulation.sensitivity_data(motor, pressures, sb.sensitivities(motor, [1e5 * bar for bar in pressures])))


def test_they_take_a_run_in_time_and_the_articles_figures():
    motor = sb.read_motor("ptm3600")
    check(simulation.transient_data(motor, "spin-up", 2.0, sb.spin_up(motor, 2e5, 0.02)))
    check(json.loads((ROOT / "docs" / "figures" / "reproduce.json").read_text(encoding="utf-8")))


def test_a_figure_of_a_fit_or_a_diagnosis_has_all_its_parts():
    found = sb.diagnose("published_sweep").document
    check(found)
    (effect,) = found["effects"]
    for wrong in ({"probability": "0.9"}, {"parameters": {"readings": {"mean": 1.0}}}, {"id": None}):
        assert not validator("diagnosis").is_valid(found | {"effects": [effect | wrong]})
    assert validator("diagnosis").is_valid(found | {"added_later": 1})
