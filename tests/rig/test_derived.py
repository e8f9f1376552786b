"""Flow at the inlet's state, from a meter that refers to another one."""

import re

import pytest

import configs
from rig.acquisition.derived import InletFlow, State, inlet_flow
from rig.bench.bench import read_bench
from rig.bench.instrument import Reference
from rig.readings import NS, Quality, Reading

NORMAL = Reference(kind="standard_volume", pressure_bar_abs=1.01325, temperature_c=0.0)
SCALE = Reference(kind="rotameter_scale", pressure_bar_abs=1.01325, temperature_c=20.0)


def at(pressure_bar=2.0, sd=0.0, celsius=20.0, temperature_sd=0.0):
    return State(pressure_bar, sd, celsius + 273.15, temperature_sd)


def test_standard_litres_shrink_with_pressure_and_grow_with_temperature():
    assert inlet_flow(100.0, 0.0, NORMAL, at())[0] == pytest.approx(100.0 * 1.01325 / 2.0 * 293.15 / 273.15)


def test_at_the_reference_state_the_reading_stands():
    assert inlet_flow(50.0, 0.5, NORMAL, at(1.01325, celsius=0.0)) == pytest.approx((50.0, 0.5))


def test_a_rotameter_reads_with_the_root_of_the_density():
    assert inlet_flow(80.0, 0.0, SCALE, at(4 * 1.01325))[0] == pytest.approx(40.0)


def test_the_uncertainty_is_that_of_repeated_draws():
    import numpy as np

    rng = np.random.default_rng(3)
    drawn = [
        inlet_flow(
            100.0 + rng.normal(0.0, 1.0), 0.0, NORMAL, at(2.0 + rng.normal(0.0, 0.02), celsius=20.0 + rng.normal())
        )[0]
        for _ in range(4000)
    ]
    assert inlet_flow(100.0, 1.0, NORMAL, at(2.0, 0.02, 20.0, 1.0))[1] == pytest.approx(np.std(drawn), rel=0.05)


def test_a_meter_of_standard_litres_that_tells_no_state_is_refused(tmp_path):
    instruments, benches = (configs.FOLDER / name for name in ("instruments", "benches"))
    meter = (instruments / "siargo_mf5700.toml").read_text(encoding="utf-8")
    meter = re.sub(r"(?m)^reference = .*\n", "", meter)
    (tmp_path / "meter.toml").write_text(meter, encoding="utf-8")
    bench = (benches / "virtual.toml").read_text(encoding="utf-8").replace("siargo_mf5700", "meter")
    (tmp_path / "bench.toml").write_text(bench, encoding="utf-8")
    with pytest.raises(
        configs.ConfigError, match=r"roles.flow: 'flowmeter.flow_sl_min' is no flow at the inlet's state"
    ):
        read_bench(str(tmp_path / "bench.toml"))


@pytest.fixture
def derive():
    return InletFlow(read_bench("virtual"))


def reading(name, value, time_s, quality=Quality.OK, unit="bar"):
    device, _, channel = name.partition(".")
    ns = int(time_s * NS)
    return Reading(device, channel, value, unit, quality, ns, ns, ns, raw=f"raw {value}")


FLOW, PRESSURE = "flowmeter.flow_sl_min", "gauge.pressure_bar_abs"


def test_the_meters_reading_is_kept_raw_beside_the_derived_one(derive):
    derive(reading(PRESSURE, 2.0, 0.9))
    found = derive(reading(FLOW, 100.0, 1.0, unit="L/min"))
    assert (found.name, found.unit, found.raw, found.quality) == (
        "derived.flow_l_min",
        "L/min",
        "raw 100.0",
        Quality.OK,
    )
    assert found.value == pytest.approx(100.0 * 1.01325 / 2.0)
    assert float(re.search(r"sd ([0-9.]+) L/min", found.detail)[1]) > 0.0


def test_without_a_pressure_there_is_no_derived_flow(derive):
    found = derive(reading(FLOW, 100.0, 1.0))
    assert (found.value, found.quality, found.detail) == (None, Quality.STALE, "no pressure at the time")


def test_an_old_pressure_does_not_belong_to_the_flow(derive):
    derive(reading(PRESSURE, 2.0, 0.0))
    assert derive(reading(FLOW, 100.0, 10.0)).value is None


def test_a_failed_pressure_is_not_bridged_with_the_last_one(derive):
    derive(reading(PRESSURE, 2.0, 0.0))
    derive(reading(PRESSURE, None, 0.5, Quality.TIMEOUT))
    assert derive(reading(FLOW, 100.0, 0.6)).value is None


def test_a_failed_flow_stays_a_gap_of_the_same_kind(derive):
    derive(reading(PRESSURE, 2.0, 0.9))
    assert derive(reading(FLOW, None, 1.0, Quality.CRC)).quality is Quality.CRC


def test_an_unverified_pressure_makes_the_derived_flow_unverified(derive):
    derive(reading(PRESSURE, 2.0, 0.9, Quality.UNVERIFIED))
    assert derive(reading(FLOW, 100.0, 1.0)).quality is Quality.UNVERIFIED


def test_other_channels_derive_nothing(derive):
    assert derive(reading("tach.speed_rpm", 300.0, 1.0)) is None
