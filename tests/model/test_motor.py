"""The motor's parameters: one definition, a strict file, and overrides that say what is wrong with them."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from configs import ConfigError
from model import layout, motor

FILE = motor.MOTORS / "ptm3600.toml"
PTM3600 = motor.read_motor("ptm3600")
LAYOUT = {
    "concave_diameter": layout.R2_DIAMETER,
    "convex_diameter": layout.R3_DIAMETER,
    "cylinder_surface_radius": layout.R4,
    "roller_diameter": layout.R5_DIAMETER,
    "concave_reach": layout.R6,
    "cylinder_diameter": layout.DP,
    "piston_length": layout.LP,
    "port_lap": layout.LAP,
    "roller_friction": layout.F_R,
    "f_overall": layout.F_OVERALL,
    "inertia": layout.J,
    "ambient_pressure": layout.P_A,
    "ambient_temperature": layout.T_A,
    "inlet_temperature": layout.T_IN,
    "relative_humidity": layout.HUMIDITY,
    "inlet_pressure_drop": layout.DP_IN,
    "outlet_pressure_drop": layout.DP_OUT,
    "ambient_heat_transfer": layout.H_A,
    "wall_thickness": layout.D_C,
    "wall_conductivity": layout.K_C,
}


def refusal(folder, *changes):
    """What the reader says of the motor file after each text has been replaced, once, by another."""
    text = FILE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "changed.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        motor.read_motor(path)
    return str(refused.value).replace(f"{path}: ", "")


def set_refusal(*assignments):
    with pytest.raises(ConfigError) as refused:
        motor.set_values(PTM3600, list(assignments))
    return str(refused.value)


def test_the_order_of_the_quantities_is_that_of_the_solvers():
    names = list(motor.QUANTITIES)
    assert {name: names.index(name) for name in LAYOUT} == LAYOUT
    assert len(LAYOUT) == layout.N_SOLVER_PARAMETERS
    assert not set(names[: layout.N_SOLVER_PARAMETERS]) - set(LAYOUT)
    # What effects add lies behind the quantities, and behind it the counts.
    behind = [
        layout.EXTRA_TORQUE,
        layout.HEAT_FACTOR,
        layout.J_ADDED,
        layout.N_PISTONS,
        layout.N_LOBES,
        layout.N_VECTOR,
    ]
    assert behind == [len(names) + i for i in range(6)]


def test_the_order_of_the_readings_is_that_of_the_solvers():
    base = PTM3600.readings.vector()
    np.testing.assert_array_equal(base, [0, 0, 0, 0, 1])
    changes = {
        layout.VIRTUAL_WORK: {"torque": "virtual_work"},
        layout.WALL_AS_PRINTED: {"wall_resistance": "as_printed"},
        layout.FRICTION_AS_PRINTED: {"roller_friction": "as_printed"},
        layout.CONSTANT_AIR: {"air": "constant"},
        layout.HEAT_TRANSFER: {"heat_transfer": False},
    }
    for index, change in changes.items():
        np.testing.assert_array_equal(
            np.flatnonzero(PTM3600.with_readings(**change).readings.vector() != base), [index]
        )


def test_the_vector_is_in_si_units():
    vector = PTM3600.vector()
    assert vector[layout.DP] == pytest.approx(0.02403, rel=1e-15)
    assert vector[layout.LAP] == pytest.approx(math.radians(8.0), rel=1e-15)
    assert vector[layout.P_A] == 101325.0
    assert PTM3600.si("speed_limit") == pytest.approx(600.0 * 2.0 * math.pi / 60.0, rel=1e-15)


def test_every_figure_of_the_shipped_motor_has_a_source_and_the_assumed_ones_say_so():
    for name in ("port_lap", "roller_friction", "inertia", "ambient_pressure", "ambient_temperature"):
        assert PTM3600[name].source.startswith("assumed")
        assert PTM3600[name].prior is not None
    for name in LAYOUT:
        assert PTM3600[name].source.startswith(("assumed", "article"))


@pytest.mark.parametrize("name", ["ptm3600", FILE])
def test_a_motor_is_read_by_name_or_by_path(name):
    assert motor.read_motor(name) == PTM3600


@pytest.mark.parametrize("name", ["../ptm3600", "a/b", "", "x" * 41, "ptm 3600", "ptm3600.toml"])
def test_a_name_cannot_leave_the_folder(name):
    with pytest.raises(ConfigError, match="named by letters, digits"):
        motor.read_motor(name)


def test_an_unknown_motor_is_met_with_the_nearest_one():
    with pytest.raises(ConfigError, match=r"no such file; did you mean 'ptm3600\.toml'\?"):
        motor.read_motor("ptm360")


def test_the_mistakes_of_a_file_are_reported_at_once_each_with_its_place(tmp_path):
    text = refusal(
        tmp_path,
        ('torque = "published"', 'torque = "publishd"'),
        ("heat_transfer = true", "heat_transfr = true"),
        ("value = 24.03", 'value = "24.03"'),
        ("[parameters.wall_thickness]", "[parameters.wall_thicknes]"),
    )
    assert sorted(text.splitlines()) == [
        "'parameters.cylinder_diameter.value' should be a valid number (given: '24.03')",
        "'readings.torque' should be 'published' or 'virtual_work' (given: 'publishd')",
        "the key 'parameters.wall_thickness' is missing",
        "the key 'readings.heat_transfer' is missing",
        "unknown key 'parameters.wall_thicknes'; did you mean 'wall_thickness'?",
        "unknown key 'readings.heat_transfr'; did you mean 'heat_transfer'?",
    ]


def test_values_out_of_bounds_and_wrong_units_are_reported_at_once(tmp_path):
    text = refusal(
        tmp_path,
        ("value = 24.03", "value = -24.03"),
        ('value = 8.0\nunit = "deg"', 'value = 0.14\nunit = "rad"'),
        ("value = 0.0625", "value = 625.0"),
    )
    assert "parameters.cylinder_diameter: -24.03 mm is outside 0.1..10000 mm" in text
    assert "parameters.port_lap: the unit is 'deg', not 'rad'; convert the value" in text
    assert "parameters.f_overall: 625 N m s is outside 0.0001..10 N m s" in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "ptm3600"', 'name = "ptm3600"\nname = "other"', "the same key stands twice"),
        ('format = "motor/1"', 'format = "motor/2"', "'format' should be 'motor/1'"),
        ("value = 0.0625\n", "", "the key 'parameters.f_overall.value' is missing"),
        ('symbol = "Dp"', 'symbl = "Dp"', "unknown key 'parameters.cylinder_diameter.symbl'; did you mean 'symbol'?"),
        ("value = 24.03", "value = inf", "'parameters.cylinder_diameter.value' should be a finite number"),
        ('name = "ptm3600"', 'name = "PTM 3600"', "'name': string should match pattern"),
    ],
)
def test_one_mistake_one_sentence(tmp_path, old, new, message):
    assert message in refusal(tmp_path, (old, new))


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ('kind = "normal"', "a normal prior has sd, and nothing else"),
        ('kind = "normal", sd = 1.0, factor = 2.0', "a normal prior has sd, and nothing else"),
        ('kind = "lognormal", sd = 1.0', "a lognormal prior has factor, and nothing else"),
        ('kind = "loguniform", low = 1.0', "a loguniform prior has high and low, and nothing else"),
        ('kind = "loguniform", low = 2.0, high = 1.0', "low 2.0 is not below high 1.0"),
        ('kind = "normal", sd = 0.0', "'parameters.port_lap.prior.sd' should be greater than 0"),
        ('kind = "lognormal", factor = 1.0', "'parameters.port_lap.prior.factor' should be greater than 1"),
        ('kind = "uniform"', "'parameters.port_lap.prior.kind' should be 'normal'"),
    ],
)
def test_a_prior_has_the_figures_of_its_kind_and_no_others(tmp_path, prior, message):
    text = refusal(tmp_path, ('prior = { kind = "normal", sd = 1.0 }', f"prior = {{ {prior} }}"))
    assert message in text
    assert "parameters.port_lap.prior" in text


def test_equation_11_as_printed_is_refused_with_the_volume_it_gives(tmp_path):
    text = refusal(tmp_path, ('piston_length = "roller_surface"', 'piston_length = "roller_centre"'))
    assert "readings.piston_length: Eq. 11 as printed gives a volume of -3.81 cm3 at 45 deg" in text
    assert "use 'roller_surface' (erratum 1)" in text


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("value = 76.61", "value = 30.0"),  # the concave circle would hold the motor's centre
        ("value = 18.20", "value = 90.0"),  # the roller would not fit the concave circle
        ("value = 35.07", "value = 45.0"),  # the piston would meet the cylinder's end
    ],
)
def test_lengths_that_make_no_motor_are_refused(tmp_path, old, new):
    assert "check the diameters, concave_reach and piston_length" in refusal(tmp_path, (old, new))


def test_values_are_changed_in_the_parameters_own_unit():
    changed = PTM3600.with_values({"cylinder_diameter": 25.8, "port_lap": 9.0})
    assert changed.si("cylinder_diameter") == pytest.approx(0.0258, rel=1e-15)
    assert changed.si("port_lap") == pytest.approx(math.pi / 20.0, rel=1e-15)
    assert PTM3600["cylinder_diameter"].value == 24.03


def test_a_changed_motor_is_checked_again():
    with pytest.raises(ConfigError, match="check the diameters"):
        PTM3600.with_values({"piston_length": 45.0})


@pytest.mark.parametrize("key", ["cylinder_diameter", "cylinder_diameter_mm"])
def test_set_takes_a_parameter_with_or_without_its_unit(key):
    assert motor.set_values(PTM3600, [f"{key}=25.8"])["cylinder_diameter"].value == 25.8


def test_set_takes_readings_and_spaces():
    changed = motor.set_values(PTM3600, ["torque = virtual_work", "heat_transfer=false", " f_overall = 6.4e-2 "])
    assert changed.readings.torque == "virtual_work"
    assert changed.readings.heat_transfer is False
    assert changed["f_overall"].value == 0.064


def test_set_of_nothing_changes_nothing():
    assert motor.set_values(PTM3600, []) == PTM3600


def test_a_flywheel_adds_to_the_rotor_and_one_that_is_too_heavy_is_refused_by_its_own_name():
    heavy = PTM3600.with_flywheel(0.015)
    assert heavy.si("inertia") == pytest.approx(PTM3600.si("inertia") + 0.015)
    with pytest.raises(ConfigError, match=r"^added_inertia_kg_m2: a flywheel of 20 kg m2 is too heavy"):
        PTM3600.with_flywheel(20.0)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("f_overal=0.06", "--set f_overal: no such parameter or reading; did you mean 'f_overall'?"),
        ("torqe=virtual_work", "did you mean 'torque'?"),
        ("xyzzy=1", "no such parameter or reading; known: concave_diameter, concave_diameter_mm"),
        ("f_overall", "--set 'f_overall': write NAME=VALUE, for example f_overall=0.0633"),
        ("f_overall=", "write NAME=VALUE"),
        ("f_overall=0,06", "--set f_overall: '0,06' is not a number"),
        ("f_overall=1_0e-2", "--set f_overall: '1_0e-2' is not a number"),
        ("f_overall=nan", "--set f_overall: 'nan' is not a finite number"),
        ("f_overall=99", "parameters.f_overall: 99 N m s is outside 0.0001..10 N m s"),
        ("torque=eq25", "'readings.torque' should be 'published' or 'virtual_work' (given: 'eq25')"),
        ("heat_transfer=maybe", "'readings.heat_transfer' should be a valid boolean"),
    ],
)
def test_set_says_what_is_wrong(assignment, message):
    assert message in set_refusal(assignment)


def test_set_takes_a_reading_whose_name_a_parameter_shares():
    changed = motor.set_values(PTM3600, ["roller_friction=as_printed"])
    assert changed.readings.roller_friction == "as_printed"


def test_a_name_carries_its_unit_unless_it_has_none():
    assert motor.name_with_unit("f_overall") == "f_overall_n_m_s"
    assert motor.name_with_unit("roller_friction") == "roller_friction"
    assert len({motor.name_with_unit(name) for name in motor.QUANTITIES}) == len(motor.QUANTITIES)


@given(st.sampled_from(list(motor.QUANTITIES)), st.floats(allow_nan=False))
def test_a_value_is_taken_exactly_within_its_bounds_or_refused_by_name(name, value):
    quantity = motor.QUANTITIES[name]
    try:
        assert PTM3600.with_values({name: value})[name].value == value
        assert quantity.low <= value <= quantity.high
    except ConfigError as error:
        assert re.search(rf"parameters\.{name}|these lengths give no curve|do not fit side by side", str(error))


def test_the_motor_file_says_where_each_figure_comes_from():
    text = Path(FILE).read_text(encoding="utf-8")
    assert text.count("source = ") == text.count("[parameters.") == len(motor.QUANTITIES)
