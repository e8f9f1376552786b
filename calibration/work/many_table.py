"""Results of many recordings as one table: a row a recording, as CSV and as Parquet."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

from calibration.work.many import Result
from rig.recording.safe_text import harmless

PLACE = ("balance", "channel", "coordinate")
FIGURES = ("mean", "sd", "q05", "q95")
UNIT = "unit"
TEXT, NUMBER, WHOLE, FLAG, SET, SETS = "text", "number", "whole", "flag", "set", "sets"
DIAGNOSIS_COLUMNS = {
    "name": TEXT,
    "date": TEXT,
    "motor_serial": TEXT,
    "motor": TEXT,
    "motor_sha256": TEXT,
    "verdict": TEXT,
    "error": TEXT,
    "seconds": NUMBER,
    "p_value": NUMBER,
    "effects": SET,
    "alternatives": SETS,
    "set_probability": NUMBER,
    "elpd_gain": NUMBER,
    **{f"place_{key}": TEXT for key in PLACE},
    "f_overall_unit": TEXT,
    **{f"f_overall_{when}_{key}": NUMBER for when in ("before", "after") for key in FIGURES},
    "diagnosis": TEXT,
}
FIT_FIRST = {
    "name": TEXT,
    "date": TEXT,
    "motor_serial": TEXT,
    "motor": TEXT,
    "motor_sha256": TEXT,
    "error": TEXT,
    "seconds": NUMBER,
    "p_value": NUMBER,
    "model_fits": FLAG,
    "rhat_max": NUMBER,
    "ess_min": NUMBER,
}
# When it was taken and of which motor, kept beside what it was found to say; the hash is of the motor's figures.
OF_THE_RECORDING = ("date", "motor_serial", "motor", "motor_sha256")
MOST_TEXT = 500
NOT_IN_CSV = "diagnosis"  # the whole document, for programs


def diagnosis_row(result: Result) -> dict[str, Any]:
    """A diagnosis as a row; a failed one has its error."""
    made = dict.fromkeys(DIAGNOSIS_COLUMNS) | {"name": result.name, "error": result.error, "seconds": result.seconds}
    found = (result.value or {}).get("diagnosis")
    if found is None:
        return made | {"verdict": "failed"}
    made |= {key: (result.value or {}).get(key) for key in OF_THE_RECORDING}
    place = found["located"][0] if found["located"] else {}
    held_out = (found.get("improvement") or {}).get("held_out") or {}
    made |= {
        "verdict": found["verdict"],
        "p_value": found["mismatch"]["p_value"],
        "effects": [effect["id"] for effect in found["effects"]],
        "alternatives": found["alternatives"],
        "set_probability": found["set_probability"],
        "elpd_gain": held_out.get("elpd_gain"),
        "f_overall_unit": found.get("friction_unit", "N m s"),
        "diagnosis": json.dumps(found),
    }
    made |= {f"place_{key}": place.get(key) for key in PLACE}
    for when in ("before", "after"):
        f = found[f"f_overall_{when}"] or {}
        made |= {f"f_overall_{when}_{key}": f.get(key) for key in FIGURES}
    return made


def fit_row(result: Result) -> dict[str, Any]:
    """A fit as a row: whether the model fits, each unknown's mean, sd and 90 % interval, and its unit."""
    made = dict.fromkeys(FIT_FIRST) | {"name": result.name, "error": result.error, "seconds": result.seconds}
    found = (result.value or {}).get("posterior")
    if found is None:
        return made
    made |= {key: (result.value or {}).get(key) for key in OF_THE_RECORDING}
    made |= {key: found["fit_quality"][key] for key in ("p_value", "model_fits")}
    made |= {key: found["convergence"][key] for key in ("rhat_max", "ess_min")}
    for name, one in found["parameters"].items():
        made |= {f"{name}_{key}": one[key] for key in (*FIGURES, UNIT)}
    return made


def fit_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Columns of fits: what is always there, then every unknown that occurs."""
    unknowns = dict.fromkeys(key for row in rows for key in row if key not in FIT_FIRST)
    return FIT_FIRST | {key: TEXT if key.endswith(f"_{UNIT}") else NUMBER for key in unknowns}


def as_csv(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> bytes:
    """The table as CSV; sets are joined by words."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    shown = [name for name in columns if name != NOT_IN_CSV]
    writer.writerow(shown)
    writer.writerows([cell(row.get(name)) for name in shown] for row in rows)
    return stream.getvalue().encode()


def as_parquet(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> bytes:
    """The table as Parquet."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {TEXT: pa.string(), NUMBER: pa.float64(), WHOLE: pa.int64(), FLAG: pa.bool_()}
    kinds |= {SET: pa.list_(pa.string()), SETS: pa.list_(pa.list_(pa.string()))}
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
    stream = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema), stream)
    return bytes(stream.getvalue().to_pybytes())


def cell(value: Any) -> str:
    """A value as a cell of CSV: text from outside is bounded, on one line, and nothing a spreadsheet would run."""
    if value is None:
        return ""
    if isinstance(value, list):
        inner = [" + ".join(one) if isinstance(one, list) else one for one in value]
        return cell((" or " if any(isinstance(one, list) for one in value) else " + ").join(inner))
    if isinstance(value, str):
        line = "".join(c if c.isprintable() else " " for c in value)[:MOST_TEXT]
        return harmless(line)
    return str(value)
