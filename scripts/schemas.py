"""Write configs/schemas: a JSON Schema of the files that people and other programs write or read, from their models.

An editor that knows JSON Schema then completes and checks a TOML file that begins with ``#:schema PATH``.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pydantic

from configs import FOLDER
from model.motor import Motor
from rig.bench.bench import BenchFile
from rig.bench.instrument import families
from rig.exchange.mapping import MappingFile
from rig.recording.schema import RecordingTable
from rig.runlog.schema import EndRecord, EventLine, StartRecord, WireLine
from spinbench.documents.of_model import Reproduction, Sensitivity, Simulation
from spinbench.documents.of_recordings import Comparison, Diagnosis, Posterior, Reveal

SCHEMAS = FOLDER / "schemas"
DIALECT = "https://json-schema.org/draft/2020-12/schema"
OF = {
    "bench": BenchFile,
    "comparison": Comparison,
    "diagnosis": Diagnosis,
    "import": MappingFile,
    "motor": Motor,
    "posterior": Posterior,
    "recording": RecordingTable,
    "reproduction": Reproduction,
    "reveal": Reveal,
    "run_end": EndRecord,
    "run_event": EventLine,
    "run_start": StartRecord,
    "run_wire": WireLine,
    "sensitivity": Sensitivity,
    "simulation": Simulation,
}


def models() -> dict[str, type[pydantic.BaseModel]]:
    """The models by the names of their schemas; of instruments one a family."""
    of_families = {
        f"instrument_{name}": importlib.import_module(f"rig.instruments.{name}").Settings for name in families()
    }
    return OF | of_families


def text_of(name: str, model: type[pydantic.BaseModel]) -> str:
    """A schema as its file has it."""
    return json.dumps({"$schema": DIALECT} | model.model_json_schema() | {"title": name}, indent=1) + "\n"


def main() -> None:
    """Write all of them, and take away what is none of them."""
    SCHEMAS.mkdir(exist_ok=True)
    made = {SCHEMAS / f"{name}.json": text_of(name, model) for name, model in models().items()}
    for path in set(SCHEMAS.iterdir()) - set(made):
        Path(path).unlink()
    for path, text in made.items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
