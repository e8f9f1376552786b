"""The files in configs/instruments: each loads, builds, and says where it is from and how far it is trusted."""

import pytest

from rig.bench import DeviceTable, LineTable, Place
from rig.instruments.instrument import FOLDER, families, read_instrument

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
