"""Lines that depart from the standard, on the virtual bench: echoes, transaction numbers, busy devices."""

import pytest

from rig.bench.bench import bench_of
from rig.doctor import Level, examine
from rig.lines import LineError
from rig.readings import Quality
from tests.acquired import acquisitions, ports_of
from tests.virtual_benches import FLOW, INSTRUMENTS, MODBUS, serving

ANY = 'transaction_numbers = "any"\n'
ECHO = "echo = true\n"
pytestmark = pytest.mark.slow  # each starts or examines a bench

TEMPERATURE = """
[channels.temperature_c]
unit = "degC"
lowest = -40.0
highest = 125.0
address = 64
type = "f32"
word_order = "little"
"""
SCALES = FLOW.replace('unit = "bar"\n', 'unit = "bar"\nlowest = -1.0\nhighest = 10.0\n') + TEMPERATURE
TACH = '[devices.tach]\ninstrument = "edges"\nline = "usb"\n'


def bench(net="", bus="", flow=SCALES):
    """The bench of `MODBUS` with more keys of its lines, and a flow meter of which the scale is known."""
    text = (
        MODBUS.replace("tach.speed_rpm", "gauge.temperature_c")
        .replace(TACH, "")
        .replace('host = "virtual"\n', f'host = "virtual"\n{net}')
        .replace("{paced}", "true")
    )
    text = text.replace("baud = 19200\n", f"baud = 19200\nslowest_reply_s = 0.5\n{bus}")
    sources = {f"instruments/{name}.toml": source.encode() for name, source in (INSTRUMENTS | {"flow": flow}).items()}
    return bench_of("test", {"bench.toml": text.encode(), **sources}, "test.toml")


@pytest.fixture
def acquiring():
    with acquisitions() as start:
        yield start


def examined(served, found):
    """Looks for the one finding at a place with some words in it."""
    findings = examine(found, ports_of(served), served.clock, polls=1)

    def finding(where, level, words):
        (only,) = [one for one in findings if (one.where, one.level) == (where, level) and words in one.what]
        return only

    return finding


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with serving(bench(), tmp_path_factory.mktemp("bench"), rate=1.0) as found:
        yield found


def at_two_bar(served):
    served.ask(do="supply", pressure_bar_abs=2.0)
    served.wait_until(lambda state: abs(state["pressure_bar_abs"] - 2.0) < 1e-4, 60.0)


@pytest.fixture(autouse=True)
def no_faults_left(served):
    yield
    served.ask(do="clear")


@pytest.mark.long
def test_a_meter_with_other_transaction_numbers_is_read_where_the_bench_file_says_so(served, acquiring):
    at_two_bar(served)
    served.ask(do="fault", kind="number_swapped", device="flowmeter")
    fault = examined(served, bench())("flowmeter", Level.FAULT, "the answer to question")
    assert 'write transaction_numbers = "any" at this line' in fault.what
    assert "It answers with other transaction numbers than the questions'" in fault.what
    assert fault.fix == 'write transaction_numbers = "any" into [lines.net]'
    _, sink = acquiring(served, bench(net=ANY))
    assert sink.good("flowmeter.pressure_bar_gauge", 3) == pytest.approx([2.0 - 1.01325] * 3, abs=1e-3)


@pytest.mark.parametrize("keys", ["", ECHO])
def test_on_a_line_that_echoes_set_points_and_readings_are_right_and_it_is_told_once(served, acquiring, keys):
    served.ask(do="fault", kind="echo", line="bus")
    acquisition, sink = acquiring(served, bench(bus=keys))
    for value in (1.0, 0.5, 1.0):
        assert acquisition.command("dac", "write", value, 30.0).outcome == f"reads back {value} bar gauge"
    assert sink.good("dac.setpoint_bar_gauge", 3)[-1] in (0.5, 1.0)
    assert set(map(round, sink.good("gauge.pressure_bar_abs", 10))) <= {1, 2}
    told = [
        details["text"] for kind, details in sink.events if kind == "warning" and "write echo = true" in details["text"]
    ]
    assert len(told) == (0 if keys else 1)


def test_on_a_line_that_echoes_a_dead_regulator_confirms_nothing(served, acquiring):
    served.ask(do="fault", kind="echo", line="bus")
    acquisition, _ = acquiring(served, bench())
    served.ask(do="fault", kind="dropped", device="dac")
    with pytest.raises(LineError, match="its own question, as an echo, and no answer"):
        acquisition.command("dac", "write", 1.0, 30.0)


def test_the_doctor_tells_of_an_echo_and_of_one_that_does_not_come(served):
    assert examined(served, bench(bus=ECHO))("line bus", Level.WARNING, "echo = true, and no question comes back")
    served.ask(do="fault", kind="echo", line="bus")
    assert examined(served, bench())("line bus", Level.WARNING, "write echo = true at this line")


@pytest.mark.parametrize(("code", "words"), [(6, "wait until it has started"), (11, "the device behind it does not")])
@pytest.mark.long
def test_a_device_that_stays_busy_is_told_as_such_and_not_as_another_model(served, acquiring, code, words):
    served.ask(do="fault", kind="exception", device="gauge", code=code)
    with pytest.raises(LineError, match=rf"gauge \(line bus\) is busy, 5 times: .*exception {code} .*{words}"):
        acquiring(served, bench())
    assert words in examined(served, bench())("gauge", Level.FAULT, "it is busy, 5 times").fix


def test_the_doctor_asks_a_device_that_is_busy_once_again(served):
    now_s = served.clock.now_ns() / 1e9
    served.ask(do="fault", kind="exception", device="gauge", code=5, to_s=now_s + 0.7)
    assert examined(served, bench())("gauge", Level.OK, "latency")


def test_the_doctor_shows_a_number_in_all_orders_and_names_that_on_the_scale(served):
    head, channels = SCALES[: SCALES.index("[channels")], SCALES[SCALES.index("[channels") :].replace(TEMPERATURE, "")
    first = head + TEMPERATURE + channels
    right = examined(served, bench(flow=first))("flowmeter", Level.OK, "as ABCD")
    assert "temperature_c (holding 64 to 65) in degC: " in right.what
    assert "20 as CDAB" in right.what
    assert "the file has CDAB" in right.what
    wrong = bench(flow=first.replace(TEMPERATURE, TEMPERATURE.replace("word_order", "byte_order")))
    warning = examined(served, wrong)("flowmeter", Level.WARNING, "as ABCD")
    assert "20 as CDAB" in warning.what
    assert 'write word_order = "little" and byte_order = "big" (CDAB)' in warning.fix


def test_a_value_far_outside_its_scale_is_never_ok_and_the_doctor_says_so_of_each_channel(served, acquiring):
    at_two_bar(served)
    far = SCALES.replace('type = "f32"\nword_order = "little"', 'type = "f32"\nword_order = "little"\nscale = 1e6')
    words = "pressure_bar_gauge gave no reading: over-range 986"
    assert examined(served, bench(flow=far))("flowmeter", Level.WARNING, words)
    _, sink = acquiring(served, bench(flow=far))
    sink.good("flowmeter.flow_sl_min", 3)
    assert {one.quality for one in sink.readings("flowmeter.pressure_bar_gauge")} == {Quality.OVER_RANGE}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bus": ANY}, r"lines\.bus: transaction_numbers is of Modbus TCP"),
        ({"net": ANY + 'framing = "rtu"\n'}, r"lines\.net: transaction_numbers is of Modbus TCP"),
        ({"net": ECHO}, r"lines\.net\.echo: is of a serial bus, and this is Modbus TCP"),
    ],
)
def test_habits_that_a_line_cannot_have_are_refused(keys, words):
    with pytest.raises(ValueError, match=words):
        bench(**keys)
