"""The library of effects: what there is, what each says of itself, and that one more is one more file."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import string
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import model.effects.definitions as room
from model import layout as at
from model.effects import effects, library
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.effect import Effect, EffectParameter, State
from model.motor import read_motor
from model.solvers.crank_angle import OMEGA
from model.solvers.steady import gas_table
from model.solvers.transient import Supply, rest_state

PROMISED = {
    "coulomb_friction": "torque",
    "stribeck_friction": "torque",
    "windage": "torque",
    "load_friction": "torque",
    "friction_warm_up": "torque",
    "once_per_rev_torque": "torque",
    "inlet_throttling": "gas path",
    "exhaust_back_pressure": "gas path",
    "leakage": "gas path",
    "wall_heat_exchange": "gas path",
    "pressure_gauge_offset": "sensor",
    "pressure_gauge_scale": "sensor",
    "flow_offset": "sensor",
    "flow_scale": "sensor",
    "flow_density_correction": "sensor",
    "speed_scale": "sensor",
    "speed_lag": "sensor",
    "bad_reading": "sensor",
    "inertia": "rig",
}
UNLISTED = {"torque_step"}  # a diagnosis does not name these: they stand for what nothing listed is
SUFFIXES = {
    "N m": "nm",
    "N m s2": "nm_s2",
    "Pa": "pa",
    "Pa s2/m6": "pa_s2_m6",
    "kg/(s Pa2)": "kg_s_pa2",
    "m3/s": "m3_s",
    "rad/s": "rad_s",
    "s": "s",
}
DOCS = Path(__file__).resolve().parents[3] / "docs" / "effects.md"


@pytest.mark.parametrize("name", PROMISED)
def test_each_promised_effect_exists_and_acts_where_promised(name: str) -> None:
    assert effects()[name].acts_in == PROMISED[name]


def test_there_is_no_effect_that_the_list_above_leaves_out() -> None:
    assert set(effects()) == set(PROMISED) | UNLISTED
    assert {name for name, effect in effects().items() if not effect.listed} == UNLISTED


@pytest.mark.parametrize("name", PROMISED)
def test_an_effect_says_what_it_is_where_its_law_comes_from_and_what_it_looks_like(name: str) -> None:
    effect = effects()[name]
    (module,) = [
        info.name
        for info in pkgutil.walk_packages(room.__path__, f"{room.__name__}.")
        if info.name.endswith(f".{name}")
    ]
    assert inspect.getdoc(importlib.import_module(module))
    assert len(effect.title) > 5 and len(effect.source) > 10
    assert "sweep: " in effect.signature
    assert re.search(r"transients: |coast-down: |spin-up: ", effect.signature)
    assert effect.sentence.endswith(".")


@pytest.mark.parametrize("name", PROMISED)
def test_its_sentence_names_its_amplitude_and_no_parameter_that_it_has_not(name: str) -> None:
    effect = effects()[name]
    named = {field for _, field, _, _ in string.Formatter().parse(effect.sentence) if field}
    assert effect.amplitude.name in named
    assert named <= {parameter.name for parameter in effect.parameters}


@pytest.mark.parametrize("name", PROMISED)
def test_its_parameters_have_units_bounds_and_a_size(name: str) -> None:
    effect = effects()[name]
    assert not effect.amplitude.shape
    for parameter in effect.parameters:
        assert parameter.text and parameter.unit
        assert parameter.low < parameter.high
        assert 0.0 < parameter.scale <= parameter.high
        assert parameter.unit == "-" or parameter.name.endswith(SUFFIXES[parameter.unit])
        if parameter.shape:
            assert parameter.low > 0.0, "a shape has a logarithmic prior"


@pytest.mark.parametrize("name", PROMISED)
def test_it_acts_in_one_place_by_one_law(name: str) -> None:
    effect = effects()[name]
    laws = {
        "torque": effect.torque is not None,
        "gas path": any(law is not None for law in (effect.inlet_drop, effect.outlet_rise, effect.leak))
        or "HEAT_FACTOR" in effect.factors,
        "sensor": bool(effect.reads) or effect.lag is not None or name == "bad_reading",
        "rig": "J" in effect.factors,
    }
    assert {place for place, has in laws.items() if has} == {effect.acts_in}


@pytest.mark.parametrize("name", PROMISED)
def test_each_law_gives_one_value_a_row(name: str) -> None:
    effect = effects()[name]
    state = State(*(np.linspace(1.0, 2.0, 5) for _ in range(10)))
    values = {parameter.name: parameter.scale for parameter in effect.parameters}
    for law in (effect.torque, effect.inlet_drop, effect.outlet_rise, effect.leak):
        if law is not None:
            assert law(values, state).shape == (5,)
    for read in effect.reads.values():
        assert read(values, np.ones(5), state).shape == (5,)


def test_factors_are_on_parameters_that_the_solvers_have() -> None:
    for effect in effects().values():
        for name in effect.factors:
            assert isinstance(getattr(at, name), int)


def test_the_page_lists_every_effect_with_its_parameters_and_bounds() -> None:
    page = DOCS.read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("| `")
    ]
    table = {row[0].strip("`"): row for row in rows if len(row) == 6}
    assert set(table) == set(effects())
    for name, effect in effects().items():
        _, acts_in, law, parameters, source, signature = table[name]
        assert acts_in == effect.acts_in
        assert law
        assert parameters == "; ".join(described(parameter) for parameter in effect.parameters)
        assert source == effect.source
        assert signature == effect.signature


def described(parameter: EffectParameter) -> str:
    """A parameter as the page prints it."""
    about = f"{parameter.expected:g} ± " if parameter.expected else ""
    span = f"{parameter.low:g} to {parameter.high:g}"
    return f"`{parameter.name}` {span} {parameter.unit}, ordinarily {about}{parameter.scale:g}"


NEW = '''
"""Drag of a brush: grows with the root of the speed."""

import numpy as np

from model.effects.effect import Effect, EffectParameter


def torque(p, state):
    return p["torque_nm"] * np.sqrt(state.omega / 100.0)


EFFECT = Effect(
    id="brush_drag",
    acts_in="torque",
    title="drag of a brush",
    sentence="A brush drags with {torque_nm}.",
    source="made up for this test",
    signature="sweep: some speed lost",
    parameters=(EffectParameter("torque_nm", "N m", 0.0, 1.0, 0.1),),
    torque=torque,
)
'''


@pytest.fixture
def one_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Effect]:
    """The library with one more file in it."""
    (tmp_path / "brush_drag.py").write_text(NEW, encoding="utf-8")
    monkeypatch.setattr(room, "__path__", [*room.__path__, str(tmp_path)])
    library.effects.cache_clear()
    yield library.effects()["brush_drag"]
    library.effects.cache_clear()
    sys.modules.pop("model.effects.definitions.brush_drag", None)


def test_one_more_file_is_one_more_effect_in_both_solvers(one_more: Effect) -> None:
    motor = read_motor("ptm3600")
    parameters, readings, P = motor.vector(), motor.readings.vector(), np.array([2e5])
    chosen = {one_more.id: {"torque_nm": 0.4}}
    bare, steady = (
        effect_steady.solve(parameters[None, :], readings, P, gas_table(motor, P), those, np.zeros(1))
        for those in ({}, chosen)
    )
    lost = motor.si("f_overall") * (bare.speed[0] - steady.speed[0])
    assert lost == pytest.approx(0.4 * np.sqrt(steady.speed[0] / 100.0), rel=0.02)
    start = rest_state(motor)
    start[OMEGA] = steady.speed[0]
    time = np.linspace(0.0, 3.0, 151)
    run = effect_transient.simulate(parameters, readings, [Supply(-1.0, 2e5)], time, start, chosen)
    assert run.reading[-1] == pytest.approx(steady.speed[0], rel=1e-3)


def test_a_file_with_another_name_than_its_effect_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "brush.py").write_text(NEW, encoding="utf-8")
    monkeypatch.setattr(room, "__path__", [*room.__path__, str(tmp_path)])
    library.effects.cache_clear()
    try:
        with pytest.raises(ValueError, match=r"brush\.py.*brush_drag"):
            library.effects()
    finally:
        library.effects.cache_clear()
        sys.modules.pop("model.effects.definitions.brush", None)
