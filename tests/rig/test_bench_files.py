"""Bench files with mistakes that a stranger makes: each is refused in a line that says what to write."""

import pytest

import configs
from configs import ConfigError
from rig.bench.bench import read_bench

BENCH = """
format = "bench/1"
title = "test"
[lines.net]
kind = "tcp"
host = "192.168.1.20"
[lines.bus]
kind = "serial"
port = "/dev/ttyUSB0"
[devices.gauge]
instrument = "keller_30x_abs"
line = "bus"
unit_id = 1
[devices.meter]
instrument = "siargo_mf5700"
line = "net"
unit_id = 1
[devices.tach]
instrument = "monarch_act3x"
line = "bus"
[roles]
pressure = "gauge.pressure_bar_abs"
flow = "meter.flow_sl_min"
speed = "tach.speed_rpm"
[sweep]
levels_bar_abs = [1.2]
"""


def read(tmp_path, old="", new="", encoding="utf-8"):
    assert old in BENCH
    (tmp_path / "bench.toml").write_bytes(BENCH.replace(old, new).encode(encoding))
    return read_bench(tmp_path / "bench.toml")


def test_a_file_is_read_with_the_mark_that_windows_writes(tmp_path):
    assert read(tmp_path, "\n", "\r\n", "utf-8-sig").file.title == "test"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "tach.speed_rpm",
            "gauge.pressure_bar_abs",
            "roles.speed: 'gauge.pressure_bar_abs' is no speed; its name would",
        ),
        ("gauge.pressure_bar_abs", "gauge.temperature_c", "roles.pressure: 'gauge.temperature_c' is no pressure"),
        (
            "[sweep]",
            "[sweep]\nwindow_s = 300.0",
            "sweep.window_s = 300 and sweep.settle_timeout_s = 60: no level could settle before it is given up",
        ),
        (
            'line = "bus"\nunit_id = 1',
            'line = "bus"\nunit_id = 1\nperiod_s = 100.0',
            "devices.gauge.period_s = 100 and sweep.window_s = 3: 5 readings are needed in the window",
        ),
        (
            "[sweep]",
            "[virtual]\nseed = -1\n[sweep]",
            "'virtual.seed' should be greater than or equal to 0 (given: -1)",
        ),
        (
            "192.168.1.20",
            "192.168.1.20:502",
            "'192.168.1.20:502' is more than a name or an address; tcp_port has the port",
        ),
        ("192.168.1.20", "tcp://box", "'tcp://box' is more than a name or an address"),
        ("192.168.1.20", " 192.168.1.20", "' 192.168.1.20' is more than a name or an address"),
        (
            "[devices.gauge]",
            '[lines.other]\nkind = "serial"\nport = "/dev/../dev/ttyUSB0"\nbaud = 19200\n[devices.gauge]',
            "lines.other.port: is that of line 'bus'; devices of one cable are on one line, all with its baud rate",
        ),
        ("[devices.meter]", "[devices.derived]", "devices.derived: the log calls channels so that are computed"),
        ("keller_30x_abs", "keller_30x", "there is no 'keller_30x' in configs/instruments, nor 'keller_30x.toml'"),
        ("keller_30x_abs", "keller_30x", "did you mean 'keller_30x_abs'?"),
        ("keller_30x_abs", "keller_30x_abs.toml", "the shipped one is 'keller_30x_abs', without folder and ending"),
        ("keller_30x_abs", "mine/gauge.toml", "there is no file 'mine/gauge.toml', counted from the bench file's"),
        (
            'title = "test"',
            'title = "test"\nmotor = "ptm360"',
            "motor: there is no motor 'ptm360'; did you mean 'ptm3600'",
        ),
        ("[1.2]", "[1.2]\ndwell_s = 1e12", "dwell_s' should be less than or equal to 86400"),
        ("[1.2]", "[1.2]\nramp_bar_s = 1e-300", "ramp_bar_s' should be greater than or equal to 0.0001"),
        ("[devices.gauge]", '[devices."gauge.1"]', "devices.'gauge.1': a device's name has no dot"),
        ("[devices.gauge]", '[devices."gau\\nge"]', r"devices.'gau\nge': a device's name has no dot"),
        ("[devices.gauge]", '[devices.""]', "is not empty"),
        ("unit_id = 1", "unit_id = 1\nperiod_s = 1e300", "period_s' should be less than or equal to 3600"),
        ("unit_id = 1", "unit_id = 1\nperiod_s = 1e-300", "period_s' should be greater than or equal to 0.001"),
        (
            'kind = "tcp"',
            'kind = "tcp"\nslowest_reply_s = 1e300',
            "slowest_reply_s' should be less than or equal to 3600",
        ),
    ],
)
def test_a_mistake_is_refused_with_what_to_do(tmp_path, old, new, words):
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, old, new)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("unit", "lowest", "words"),
    [
        ("psi", 0.0, "the set-point of 'regulator' is in 'psi'; a sweep needs bar gauge or bar abs"),
        ("bar gauge", 0.2, "'regulator' takes no less than 0.2 bar gauge, so that it cannot be ordered to give no"),
        (
            "bar abs",
            1.1,
            "'regulator' takes no less than 1.1 bar abs, so that it cannot be ordered to give no pressure",
        ),
        ("bar abs", 0.0, ""),
        ("bar gauge", -0.5, ""),
    ],
)
def test_a_regulator_has_to_take_the_order_for_no_pressure(tmp_path, unit, lowest, words):
    setpoint = f'[setpoint]\naddress = 1\ntype = "f32"\nunit = "{unit}"\nlowest = {lowest}\nhighest = 5.0\n'
    head = 'format = "instrument/1"\nfamily = "modbus"\ntitle = "x"\nsource = "x"\ntrust = "documented"\n'
    channel = '[channels.held_bar]\nunit = "bar"\naddress = 1\ntype = "f32"\n'
    (tmp_path / "mine.toml").write_text(head + channel + setpoint)
    device = '[devices.regulator]\ninstrument = "mine"\nline = "bus"\nunit_id = 7\n[roles]\nregulator = "regulator"'
    if words:
        with pytest.raises(ConfigError) as refused:
            read(tmp_path, "[roles]", device)
        assert words in str(refused.value)
    else:
        assert read(tmp_path, "[roles]", device).file.roles.regulator == "regulator"


def test_a_person_reads_no_instrument_of_a_bench_whose_regulator_makes_the_run(tmp_path):
    keys = '[lines.keys]\nkind = "keyboard"\n[devices.glass]\ninstrument = "manual_bench"\nline = "keys"\n'
    regulator = 'instrument = "adam_4024_regulator"\nline = "bus"\nunit_id = 2\nchannel = 0\nspan = [0.0, 5.0]\n'
    flow, glass = '[roles]\npressure = "gauge.pressure_bar_abs"\nflow = "meter.flow_sl_min"', "glass.flow_l_min"
    roles = flow.replace("meter.flow_sl_min", glass)
    assert read(tmp_path, flow, f"{keys}{roles}").file.roles.flow == glass
    with pytest.raises(
        ConfigError, match=r"roles\.flow: a person reads 'glass\.flow_l_min', and nobody is asked while"
    ):
        read(tmp_path, flow, f'{keys}[devices.regulator]\n{regulator}{roles}\nregulator = "regulator"')


@pytest.mark.parametrize("name", ["lab", "virtual"])  # the tachometer of the other speaks unasked
def test_on_a_shipped_bench_one_lost_answer_ends_no_run(name):
    bench = read_bench(configs.FOLDER / "benches" / f"{name}.toml")
    for role in (bench.file.roles.pressure, bench.file.roles.speed):
        device = role.partition(".")[0]
        table, settings = bench.file.devices[device], bench.instruments[device]
        line = bench.file.lines[table.line]
        slowest_s = max(line.timeout_s, settings.slowest_reply_s or line.slowest_reply_s)
        assert table.period_s + 2.0 * slowest_s <= bench.file.safety.speed_stale_s
