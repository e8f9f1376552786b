"""A kind of machine is one file and its motor table: the example of the tutorial, as it stands there."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import calibration.systems.machines as room
import rig.recording.schema as schema
from calibration.diagnosis import as_json, diagnose
from calibration.report.machines import page, words
from calibration.systems.machines.system import systems
from rig.recording import Recording, read_recording
from rig.recording.files import json_bytes
from tests.documented_python import cells_of

PAGE = "docs/tutorials/own-machine.md"
TABLE, SYSTEM = (next(c.code for c in cells_of(PAGE) if f"class {name}" in c.code) for name in ("TankTable", "Tank:"))
R, T, AMBIENT, VOLUME, AREA = 287.05, 293.15, 101_325.0, 0.05, 4e-6


@pytest.fixture(params=["pressure"])
def one_more(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The tool with a tank in it, whose channel and coordinate have a name."""
    system = SYSTEM.replace('"pressure"', f'"{request.param}"')
    (tmp_path / "tank.py").write_text(f"{system}\n\nSYSTEM = Tank\n", encoding="utf-8")
    monkeypatch.setattr(room, "__path__", [*room.__path__, str(tmp_path)])
    (tmp_path / "tank_table.py").write_text(TABLE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(schema._OTHER_RIGS, "tank", importlib.import_module("tank_table").TankTable)
    systems.cache_clear()
    yield
    systems.cache_clear()
    for name in ("calibration.systems.machines.tank", "tank_table"):
        sys.modules.pop(name, None)


def drained(folder: Path, leak: float, seed: int) -> Recording:
    """A tank of 50 L that drains from 8 bar, marched in steps of a millisecond."""
    P, step, read = 8e5, 1e-3, []
    for k in range(120_000):
        if k % 500 == 0:
            read.append(P)
        out = 0.0404 * AREA * P / np.sqrt(T) + leak * (P * P - AMBIENT**2)
        P -= step * R * T / VOLUME * out
    noise = np.random.default_rng(seed).normal(0.0, 500.0, len(read))
    rows = [f"{0.5 * i:.1f},{(p + n) / 1e5:.4f}" for i, (p, n) in enumerate(zip(read, noise, strict=True))]
    (folder / "tank.csv").write_text("\n".join(["time_s,pressure_bar_abs", *rows]) + "\n", encoding="utf-8")
    (folder / "recording.toml").write_text(
        'format = "recording/1"\n[motor]\nkind = "tank"\nvolume_m3 = 0.05\norifice_mm2 = 4.0\n[ambient]\n'
        "pressure_bar_abs = 1.01325\ntemperature_c = 20.0\n[channels.pressure_bar_abs]\nnoise_sd = 0.005\n"
        'bias_sd = 0.005\nscale_sd = 0.002\nresolution = 0.0001\n[[files]]\nfile = "tank.csv"\nkind = "transient"\n',
        encoding="utf-8",
    )
    return read_recording(folder)


@pytest.mark.usefixtures("one_more")
def test_a_tank_that_only_drains_lacks_nothing(tmp_path: Path) -> None:
    found = as_json(diagnose(drained(tmp_path, 0.0, 1), 1))
    assert (found["rig"], found["verdict"]) == ("tank", "consistent")


@pytest.mark.parametrize("one_more", ["pressure", "temperature", "fill"], indirect=True)
@pytest.mark.usefixtures("one_more")
def test_the_leak_of_a_tank_is_named_with_its_size_and_has_its_page(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    diagnosed = diagnose(drained(tmp_path, 2e-15, 1), 1)
    found = as_json(diagnosed)
    assert (found["verdict"], [one["id"] for one in found["effects"]]) == ("named", ["leakage"])
    size = found["effects"][0]["parameters"]["conductance_kg_s_pa2"]
    assert size["q05"] < 2e-15 < size["q95"]
    assert b"leak" in page.report(diagnosed, found)["report.html"]
    name = request.node.callspec.params["one_more"]
    words.table(found)
    key = {"pressure": "pressure_pa", "temperature": "temperature_c", "fill": "fill"}[name]
    assert list(found["improvement"]["held_out"]["rmse_before"]) == [key]
    assert any(name in (place["coordinate"], *place["same_as"]) for place in found["located"])
    assert json.loads(json_bytes(found)) == found
