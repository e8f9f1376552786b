"""The files in configs/instruments: each loads, builds, and says where it is from and how far it is trusted."""

import pytest

from configs import ConfigError
from rig.bench.bench import DeviceTable, LineTable, Place
from rig.bench.instrument import FOLDER, families, instrument_of
from tests.instrument_peers import read_instrument

NAMES = sorted(path.stem for path in FOLDER.glob("*.toml"))
SETTERS = {"adam_4024_regulator", "alicat_pc_ascii", "alicat_pc_modbus"}


def built(name):
    settings = read_instrument(name)
    line = LineTable(kind="keyboard") if settings.family == "manual" else LineTable(kind="serial", port="p")
    where = DeviceTable(instrument=name, line="l", unit_id=1, address="A", channel=0, span=[0.0, 5.0])
    module = __import__(f"rig.instruments.{settings.family}", fromlist=["build"])
    return settings, module.build("device", settings, Place(where, line))


def test_the_families_are_the_modules_with_settings():
    assert {"modbus", "ascii", "alicat", "alicat_modbus", "keller_30x", "lutron", "adam_4024"} <= set(families())
    assert {"edge_counter", "manual"} <= set(families())
    assert not {"polling", "registers", "instrument", "placing"} & set(families())


@pytest.mark.parametrize("name", NAMES)
def test_a_file_builds_a_driver_with_its_channels(name):
    settings, driver = built(name)
    assert driver.device == "device"
    assert set(driver.channels) == set(settings.channels)
    assert driver.failing is False


@pytest.mark.parametrize("name", NAMES)
def test_a_file_says_where_its_facts_are_from_and_that_no_hardware_was_seen(name):
    settings = read_instrument(name)
    assert len(settings.source) > 20
    assert settings.trust in ("documented", "simulated")


@pytest.mark.parametrize("name", NAMES)
def test_figures_of_uncertainty_have_a_source(name):
    for channel in read_instrument(name).channels.values():
        figures = (channel.noise_sd, channel.bias_sd, channel.scale_sd)
        assert bool(channel.figures_source) is any(figure is not None for figure in figures)


def test_teeth_say_the_pulses_and_a_display_shows_the_mean_over_its_update():
    counter = read_instrument("edge_counter_60").speed_made()
    assert (counter["pulses_per_rev"], counter["window_s"]) == (60.0, None)
    assert 0.0 < counter["pitch_error_sd"] < 0.02
    display = read_instrument("lutron_tachometer")
    assert display.speed_made()["window_s"] == display.update_s == 1.0
    assert display.speed_made()["pulses_per_rev"] is None


def changed(name, old, new):
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    assert old in text
    return instrument_of(text.replace(old, new, 1).encode(), "file.toml")


def test_a_file_may_say_otherwise_of_window_and_lag():
    made = changed("lutron_tachometer", 'unit = "rpm"', 'unit = "rpm"\nwindow_s = 0.4\nlag_s = 0.2').speed_made()
    assert (made["window_s"], made["lag_s"]) == (0.4, 0.2)


@pytest.mark.parametrize(
    ("name", "new", "words"),
    [
        ("siargo_mf5700", "lag_s = 0.2", "channels.flow_sl_min.lag_s: is for channels.speed_rpm only"),
        ("edge_counter_60", "pulses_per_rev = 30", "take it out; teeth says it"),
        ("lutron_tachometer", "pitch_error_sd = 0.1", "given without pulses_per_rev"),
        ("lutron_tachometer", "window_s = 0", "channels.speed_rpm.window_s"),
    ],
)
def test_how_a_speed_is_made_is_said_once_and_of_a_speed(name, new, words):
    with pytest.raises(ConfigError, match=words):
        changed(name, "unit = ", f"{new}\nunit = ")


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        (
            "keller_30x_abs",
            '"bar"',
            '"psi"',
            "pressure_bar_abs.unit: 'psi', and the name says bar, and 1 psi is 0.0689476 bar",
        ),
        ("keller_30x_abs", '"bar"', '"kPa abs"', "1 kPa is 0.01 bar: scale the numbers, and write bar here"),
        ("siargo_mf5700", '"L/min"', '"mL/min"', "1 mL/min is 0.001 L/min"),
        ("siargo_mf5700", '"L/min"', '"sccm"', "1 sccm is 0.001 L/min"),
        ("siargo_mf5700", '"L/min"', '"m³/h"', "1 m3/h is 16.6667 L/min"),
        ("monarch_act3x", '"rpm"', '"rps"', "1 rev/s is 60 rpm"),
        ("edge_counter_60", '"rpm"', '"rad/s"', "1 rad/s is 9.5493 rpm"),
        ("keller_30x_abs", '"degC"', '"K"', "the name says degC: scale"),
        ("siargo_mf5700", 'unit = "L/min"', 'unit = "L/min"\nlowest = 500.0\nhighest = 50.0', "lies below highest"),
        ("siargo_mf5700", "address = 0x003A", "address = 400059", "a manual's 400059 is 58"),
        ("siargo_mf5700", "trust =", "timeout_s = 1e300\ntrust =", "timeout_s' should be less than or equal to 3600"),
    ],
)
def test_a_file_whose_numbers_would_be_read_wrong_is_refused(name, old, new, words):
    with pytest.raises(ConfigError) as refused:
        changed(name, old, new)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("name", "own", "others"),
    [
        ("keller_30x_abs", "bar", "bar gauge, barg, bar ü, kgf/cm2, mmHg, torr, inHg, psig, kg/h"),
        ("suto_s418", "bar", "bar abs, bara, inHg, psig"),
        ("siargo_mf5700", "L/min", "Nm³/h, SCFH, SmL/min, kg/h, g/min, gpm, rpm"),
        ("monarch_act3x", "rpm", "1/s, s-1, r/s, Hz, L/min"),
        ("keller_30x_abs", "degC", "F, °F, kelvin"),
    ],
)
def test_another_unit_than_that_of_the_name_is_refused(name, own, others):
    """Known or not: its numbers would be taken for those of the name."""
    for unit in others.split(", "):
        with pytest.raises(ConfigError, match=f"the name says {own}"):
            changed(name, f'"{own}"', f'"{unit}"')


@pytest.mark.parametrize(
    ("name", "own", "ways"),
    [
        ("keller_30x_abs", "bar", "bar, bar abs, bar(a), bara, BAR"),
        ("siargo_mf5700", "L/min", "l/min, SL/min, NL/min, slpm, SLM, lpm"),
        ("monarch_act3x", "rpm", "RPM, 1/min, min⁻¹, U/min, r/min"),
        ("keller_30x_abs", "degC", "°C, deg C"),
    ],
)
def test_the_unit_of_the_name_may_be_written_in_any_way(name, own, ways):
    for unit in ways.split(", "):
        read = changed(name, f'"{own}"', f'"{unit}"').channels.values()
        assert unit in [channel.unit for channel in read]


@pytest.mark.parametrize("name", NAMES)
def test_a_standard_litre_has_its_reference_state(name):
    for channel, figures in read_instrument(name).channels.items():
        assert (figures.reference is not None) is channel.startswith("flow_sl")


@pytest.mark.parametrize("name", NAMES)
def test_only_the_files_of_controllers_give_a_driver_that_writes(name):
    _, driver = built(name)
    assert hasattr(driver, "write") is (name in SETTERS)
    if name in SETTERS:
        assert driver.unit in ("bar abs", "bar gauge")
        assert driver.lowest == 0.0 < driver.highest


def test_the_page_lists_every_file_and_family():
    page = (FOLDER.parent.parent / "docs" / "instruments.md").read_text(encoding="utf-8")
    assert [name for name in [*NAMES, *families()] if f"`{name}`" not in page] == []
