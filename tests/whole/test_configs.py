"""The strict TOML reader: what it refuses, and what it tells the person to do."""

import re

import pydantic
import pytest

import configs
from configs import ConfigError, Strict


class Wheel(Strict):
    radius_mm: float
    spokes: int = 0
    maker: str = ""
    holes_mm: list[float] = pydantic.Field(default_factory=list)


class Cart(Strict):
    name: str
    loads_kg: list[pydantic.PositiveFloat] = pydantic.Field(default_factory=list)
    driver: str | int | list[str | int] = 0
    wheels: list[Wheel] = pydantic.Field(default_factory=list)
    spare: Wheel | None = None
    extra: dict[str, Wheel] = pydantic.Field(default_factory=dict)


def written(folder, text):
    path = folder / "cart.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(data):
    with pytest.raises(ConfigError) as refused:
        configs.validate(Cart, data, "cart.toml")
    return str(refused.value)


def test_a_file_becomes_its_tables(tmp_path):
    path = written(tmp_path, 'name = "hay"\n[spare]\nradius_mm = 300.0\n')
    assert configs.read_toml(path) == {"name": "hay", "spare": {"radius_mm": 300.0}}


def test_a_file_that_a_windows_editor_saved_is_read(tmp_path):
    assert configs.read_toml(written(tmp_path, b"\xef\xbb\xbfname = 'hay'\r\n")) == {"name": "hay"}


def test_a_missing_file_is_refused_with_the_nearest_one(tmp_path):
    written(tmp_path, "")
    with pytest.raises(ConfigError, match=r"cart2\.toml: no such file; did you mean 'cart\.toml'\?"):
        configs.read_toml(tmp_path / "cart2.toml")


def test_a_missing_folder_is_refused_without_a_guess(tmp_path):
    with pytest.raises(ConfigError, match=r"no such file$"):
        configs.read_toml(tmp_path / "nowhere" / "cart.toml")


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot be read \(Is a directory\)"):
        configs.read_toml(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"name = '\xff'", "not UTF-8 text; save it as UTF-8"),
        ("name = hay", r"not valid TOML: .*line 1, column 8"),
        ("name = 'a'\nname = 'b'\n", r"not valid TOML: the same key stands twice .*line 2"),
        ("[spare]\n[spare]", "not valid TOML: .*line 2"),
        ("x = " + "[" * 50_000, "not TOML that can be read; it is nested too deeply"),
        (b"#" * (configs.MAX_TOML_BYTES + 1), "larger than 1000000 bytes; this is not a configuration file"),
    ],
)
def test_what_is_no_configuration_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(ConfigError, match=rf"cart\.toml: {message}"):
        configs.read_toml(written(tmp_path, text))


def test_the_largest_file_allowed_is_read(tmp_path):
    assert configs.read_toml(written(tmp_path, b"#" * configs.MAX_TOML_BYTES)) == {}


def test_valid_data_become_the_schema_and_cannot_be_changed():
    cart = configs.validate(Cart, {"name": "hay", "wheels": [{"radius_mm": 300.0}]}, "cart.toml")
    assert cart.wheels[0].radius_mm == 300.0
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        cart.name = "dung"


def test_every_mistake_has_a_line_of_its_own_with_file_and_place():
    lines = refusal({"nam": "hay", "wheels": [{"radius_mm": "300"}], "spare": {}}).splitlines()
    assert all(line.startswith("cart.toml: ") for line in lines)
    assert sorted(line.removeprefix("cart.toml: ") for line in lines) == [
        "'radius_mm' in [[wheels]] entry 1 should be a valid number (given: '300')",
        "the key 'name' is missing",
        "the key 'spare.radius_mm' is missing",
        "unknown key 'nam'; did you mean 'name'?",
    ]


@pytest.mark.parametrize("place", ["wheels", "spare", "extra"])
def test_a_misspelt_key_is_met_with_the_nearest_one_however_deep(place):
    wheel = {"radius_mm": 300.0, "spoke": 5}
    data = {"wheels": [wheel], "spare": wheel, "extra": {"left": wheel}}[place]
    said = refusal({"name": "hay", place: data})
    assert re.search(r"unknown key '[a-z.]*spoke'.*; did you mean 'spokes'\?", said)


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("spoke", ("spokes", "radius_mm"), "spokes"),
        ("hsot", ("host", "port"), "host"),
        ("baudrate", ("baud", "parity"), "baud"),  # it begins with the one that is meant
        ("unit", ("unit_id", "line"), "unit_id"),
        ("speed", ("speed_rpm", "speed_slope_rpm_s"), ""),  # two begin so
        ("up", ("up-down", "x"), ""),
        ("colour", ("order", "period_s", "channel"), ""),
        ("zzz", ("name",), ""),
        ("zzz", (), ""),
    ],
)
def test_a_name_is_suggested_only_where_one_is_close(word, known, meant):
    assert configs.close_to(word, known) == meant


def test_a_key_like_no_other_is_met_with_those_that_are_known():
    assert "unknown key 'zzz'; known here: name, loads_kg, driver, wheels, spare, extra" in refusal(
        {"name": "hay", "zzz": 1}
    )


@pytest.mark.parametrize("radius", ["300.0", True, float("inf"), float("nan"), None])
def test_nothing_is_converted_silently(radius):
    assert "'spare.radius_mm' should be a" in refusal({"name": "hay", "spare": {"radius_mm": radius}})


def test_a_long_value_is_shown_short():
    assert len(refusal({"name": "hay", "spare": {"radius_mm": "9" * 10_000}})) < 200


WHEEL = {"radius_mm": 300.0}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (
            {"wheels": [WHEEL, {"maker": "Ash", **WHEEL, "spokes": "8"}]},
            "'spokes' in [[wheels]] entry 2 (maker = 'Ash')",
        ),
        ({"wheels": [WHEEL, {"spokes": 8}]}, "the key 'radius_mm' in [[wheels]] entry 2 is missing"),
        ({"wheels": [{**WHEEL, "maker": 7}]}, "'maker' in [[wheels]] entry 1 should be a valid string (given: 7)"),
        ({"wheels": [{**WHEEL, "spoke": 8}]}, "unknown key 'spoke' in [[wheels]] entry 1; did you mean 'spokes'?"),
        ({"wheels": ["oak"]}, "value 1 of 'wheels' should be a table (given: 'oak')"),
        ({"loads_kg": [1.0, -2.0]}, "value 2 of 'loads_kg' should be greater than 0 (given: -2.0)"),
        (
            {"wheels": [WHEEL, {**WHEEL, "holes_mm": [1.0, "x"]}]},
            "value 2 of 'holes_mm' in [[wheels]] entry 2 should be a valid number (given: 'x')",
        ),
    ],
)
def test_an_entry_of_a_list_is_named_as_its_writer_knows_it(data, said):
    told = refusal({"name": "hay", **data})
    assert told.startswith(f"cart.toml: {said}")
    assert "\n" not in told


@pytest.mark.parametrize(
    ("driver", "said"),
    [
        (
            1.5,
            "'driver' should be a valid string or a valid integer or a valid list (given: 1.5); or leave it out: 0 is",
        ),
        (["Ann", 1.5], "value 2 of 'driver' should be a valid string or a valid integer (given: 1.5)"),
    ],
)
def test_a_value_of_one_of_several_kinds_is_told_in_one_line(driver, said):
    told = refusal({"name": "hay", "driver": driver})
    assert told.startswith(f"cart.toml: {said}")
    assert "\n" not in told


def test_what_is_taken_for_a_key_that_is_left_out_is_told():
    assert refusal({"name": "hay", "spare": {**WHEEL, "spokes": "8"}}).endswith(
        "(given: '8'); or leave it out: 0 is taken then"
    )
    assert refusal({"name": "hay", "extra": 8}).endswith("(given: 8); or leave it out")
    assert refusal({"name": 8}).endswith("(given: 8)")
