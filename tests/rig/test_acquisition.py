"""The acquisition over the virtual bench's real bytes: what is logged, what a fault does, and how a line comes back."""

import threading
import time

import pytest

from rig.acquisition import Acquisition, RecorderError, actions
from rig.acquisition.worker import Worker
from rig.bench.bench import DeviceTable, LineTable, Place
from rig.bench.instrument import IdentityError, instrument_of
from rig.clock import Clock
from rig.instruments import modbus
from rig.lines import Line, LineError, NoReplyError, Timing
from rig.lines.serial import SerialPort
from rig.readings import NS, Quality
from tests.acquired import Kept, acquisitions, ports_of
from tests.modbus_peer import ModbusPeer
from tests.virtual_benches import FLOW, MODBUS, bench, serving
from tests.waiting import wait_for


@pytest.fixture
def acquiring():
    """Starts the acquisition of a bench that is served, and stops both."""
    with acquisitions() as start:
        yield lambda served, found=None, **options: start(served, found or bench(MODBUS), **options)


def test_every_channel_is_read_and_the_devices_are_named(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, sink = acquiring(served, simulated=True)
        wait_for(lambda: acquisition.window("speed", 1e6).size and acquisition.window("pressure", 1e6).size)
        assert set(acquisition.identities()) == {"gauge", "dac", "flowmeter", "tach"}
        assert {reading.quality for reading in sink.readings("gauge.pressure_bar_abs")} == {Quality.SIMULATED}


def test_the_flow_at_the_inlet_is_a_channel_beside_the_meters_own(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, sink = acquiring(served)
        acquisition.command("dac", "write", 1.0)
        wait_for(
            lambda: (acquisition.last("flow") or acquisition.last("speed")) and acquisition.window("flow", 1e6).size
        )
        derived = next(reading for reading in sink.readings("derived.flow_l_min") if reading.value is not None)
        own = next(r for r in sink.readings("flowmeter.flow_sl_min") if r.time_ns == derived.time_ns)
        assert derived.raw == own.raw
        assert "standard_volume" in derived.detail


def test_a_set_point_is_written_and_read_back(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, _ = acquiring(served)
        exchange = acquisition.command("dac", "write", 1.0)
        assert exchange.argument == 1.0
        assert exchange.outcome.startswith("reads back 1.0")


def test_a_gap_stays_a_gap_and_the_line_comes_back(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, sink = acquiring(served)
        wait_for(lambda: acquisition.window("pressure", 1e6).size > 3)
        served.ask(do="unplug", line="bus")
        wait_for(lambda: any(kind == "line lost" for kind, _ in sink.events))
        count = acquisition.window("pressure", 1e6).size
        others = acquisition.window("speed", 1e6).size
        time.sleep(0.5)
        assert acquisition.window("pressure", 1e6).size == count
        assert acquisition.window("speed", 1e6).size > others  # another line goes on
        served.ask(do="plug", line="bus")
        wait_for(lambda: acquisition.window("pressure", 1e6).size > count + 3)
        back = next(details for kind, details in sink.events if kind == "line back")
        assert back["gap_s"] > 0.4
        lost = next(
            i for i, exchange in enumerate(sink.exchanges) if exchange.events and exchange.events[-1].kind == "lost"
        )
        after = [
            exchange
            for exchange in sink.exchanges[lost:]
            if exchange.line == "bus" and not exchange.outcome.startswith("/")
        ]
        assert "identify" in [exchange.action for exchange in after]  # who answers is asked again before it is read


def test_a_command_on_a_lost_line_is_refused(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, sink = acquiring(served)
        served.ask(do="unplug", line="bus")
        wait_for(lambda: any(kind == "line lost" for kind, _ in sink.events))
        with pytest.raises(LineError):
            acquisition.command("dac", "write", 0.0)


def test_a_dead_device_does_not_slow_the_others_on_its_line(acquiring, tmp_path):
    text = MODBUS.replace("baud = 19200", "baud = 19200\ntimeout_s = 0.1\nslowest_reply_s = 0.2")
    with serving(bench(text, paced=False), tmp_path, rate=1.0) as served:
        _, sink = acquiring(served, bench(text, paced=False))
        served.ask(do="fault", kind="dropped", device="dac", chance=1.0)
        failed = lambda: [r for r in sink.readings("dac.setpoint_bar_gauge") if r.quality is Quality.TIMEOUT]  # noqa: E731
        wait_for(lambda: len(failed()) >= 3)
        begin, count = served.clock.now_ns(), len(failed())
        time.sleep(4.0)
        spent_s = (served.clock.now_ns() - begin) / 1e9
        times = [r.time_ns for r in sink.readings("gauge.pressure_bar_abs") if r.usable and r.time_ns > begin]
        assert len(times) > 0.85 * spent_s / 0.2  # asked every 0.2 s
        assert len(failed()) - count <= 3  # the dead one, which would be asked 20 times


@pytest.mark.long
def test_a_device_among_others_is_read_again_soon_after_a_silence(acquiring, tmp_path):
    text = MODBUS.replace("baud = 19200", "baud = 19200\ntimeout_s = 0.5\nslowest_reply_s = 1.0")
    with serving(bench(text, paced=False), tmp_path, rate=1.0) as served:
        _, sink = acquiring(served, bench(text, paced=False))
        readings = lambda: sink.readings("gauge.pressure_bar_abs")  # noqa: E731
        served.ask(do="fault", kind="dropped", device="gauge", chance=1.0)
        wait_for(lambda: sum(one.quality is Quality.TIMEOUT for one in readings()) >= 4)
        served.ask(do="clear")
        back_ns = served.clock.now_ns()
        wait_for(lambda: any(one.usable and one.time_ns > back_ns for one in readings()))
        assert (served.clock.now_ns() - back_ns) / NS < 8.0  # four times what a question without an answer takes


def alone(device):
    """A worker of a line with one meter, which the device of a pty plays, and what it has read."""
    settings = instrument_of(FLOW.encode(), "flow.toml")
    where = Place(DeviceTable(instrument="i", line="net", unit_id=1), LineTable(kind="serial", port="pty"))
    clock, sink = Clock(), Kept()
    line = Line("net", SerialPort(device.path, clock, 19200), clock, Timing(timeout_s=0.5, slowest_reply_s=0.6))
    driver = modbus.build("meter", settings, where)
    return Worker(line, {"meter": (driver, 0.2)}, sink.exchange, lambda *_, **__: None, clock), sink


@pytest.mark.long
def test_a_device_alone_on_its_line_is_read_again_soon_after_a_silence():
    registers = {58 + place: 0 for place in range(6)}
    with ModbusPeer({1: registers}) as device:
        worker, sink = alone(device)
        clock, driver = worker.clock, worker.devices["meter"].driver
        worker.connect()
        worker.start()
        read = lambda: sum(one.usable for one in sink.readings("meter.flow_sl_min"))  # noqa: E731
        try:
            wait_for(lambda: read() > 3)
            device.units.clear()
            wait_for(lambda: driver.failing)
            time.sleep(1.5)
            count, back_ns = read(), clock.now_ns()
            device.units[1] = registers
            wait_for(lambda: read() > count)
            assert (clock.now_ns() - back_ns) / NS < 2.0
        finally:
            worker.stop()


class Busy(ModbusPeer):
    """Says for some questions that it is busy."""

    def __init__(self, units, times, code):
        self.times, self.code = times, code
        super().__init__(units)

    def _answer(self, frame):
        self.times -= 1
        return (
            self._framed(bytes([frame[0], frame[1] | 0x80, self.code])) if self.times >= 0 else super()._answer(frame)
        )


@pytest.mark.parametrize("code", [5, 6, 10, 11])
def test_a_device_that_is_busy_at_the_start_is_asked_again(code):
    with Busy({1: {58 + place: 0 for place in range(6)}}, 2, code) as device:
        worker, _ = alone(device)
        worker.connect()
        worker.stop()


def test_a_device_that_stays_busy_is_told_as_such():
    with Busy({1: {}}, 1000, 6) as device:
        worker, _ = alone(device)
        with pytest.raises(LineError, match=r"exception 6 \(device busy\)"):
            worker.connect()
        worker.stop()


def test_a_missing_device_is_told_at_the_start(tmp_path):
    text = MODBUS.replace("unit_id = 2", "unit_id = 2\nperiod_s = 0.5")
    found = bench(text)
    with serving(found, tmp_path) as served:
        served.ask(do="fault", kind="dropped", device="dac", chance=1.0)
        acquisition = Acquisition(found, served.clock, ports_of(served))
        with pytest.raises(LineError) as refused:
            acquisition.connect()
    assert len(str(refused.value).splitlines()) == 1
    assert "bus" in str(refused.value)


def test_a_device_that_answers_as_another_is_told_at_the_start(tmp_path):
    other = bench(
        MODBUS.replace('instrument = "edges"\nline = "usb"', 'instrument = "edges"\nline = "usb"\nserial_number = "X9"')
    )
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition = Acquisition(other, served.clock, ports_of(served))
        with pytest.raises(IdentityError, match="X9"):
            acquisition.connect()


def test_rate_jitter_and_failures_are_counted(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, _ = acquiring(served)
        wait_for(lambda: acquisition.window("pressure", 1e6).size > 10)
        found = acquisition.statistics()
    gauge = found["devices"]["gauge"]
    assert gauge["asked_hz"] == pytest.approx(5.0)
    assert gauge["failures"] == 0
    assert {"achieved_hz", "jitter_ms", "latency_p50_ms", "latency_p99_ms", "skipped"} <= set(gauge)
    assert found["queue_high_water"] >= 1


@pytest.mark.long
def test_a_hurried_gauge_is_read_as_fast_as_its_line_bears_and_disturbs_nobody_on_it(acquiring, tmp_path):
    with serving(bench(MODBUS), tmp_path, rate=1.0) as served:
        acquisition, sink = acquiring(served)
        asked = lambda name: len(sink.readings(name))  # noqa: E731

        def rates(seconds=3.0):
            names = ("gauge.pressure_bar_abs", "dac.setpoint_bar_gauge", "tach.speed_rpm")
            begin, before = served.clock.now_ns(), [asked(name) for name in names]
            time.sleep(seconds)
            spent_s = (served.clock.now_ns() - begin) / 1e9
            return [(asked(name) - count) / spent_s for name, count in zip(names, before, strict=True)]

        wait_for(lambda: asked("gauge.pressure_bar_abs") > 2)
        acquisition.hurry("gauge")
        wrote = acquisition.command("dac", "write", 1.0, 1.0)  # gets through within a second
        assert "reads back" in wrote.outcome
        for _ in range(3):  # a machine that stalls spoils one look; what the hurry disturbs, it disturbs in each
            gauge, dac, tach = rates()
            if min(dac, tach) > 4.0:
                break
        assert gauge > 12.0  # its own period is 0.2 s
        assert 4.0 < dac < 5.5
        assert tach > 3.5
        acquisition.relax("gauge")
        time.sleep(0.2)
        assert 4.0 < rates()[0] < 6.0
        told = acquisition.statistics()["devices"]["gauge"]
        assert told["achieved_hz"] == pytest.approx(5.0, rel=0.15)  # of its own period, the hurry left aside


def test_a_hurried_gauge_that_does_not_answer_is_not_asked_at_once_again(acquiring, tmp_path):
    text = MODBUS.replace("baud = 19200", "baud = 19200\ntimeout_s = 0.05\nslowest_reply_s = 0.06")
    with serving(bench(text, paced=False), tmp_path, rate=1.0) as served:
        acquisition, sink = acquiring(served, bench(text, paced=False))
        served.ask(do="fault", kind="dropped", device="gauge", chance=1.0)
        acquisition.hurry("gauge")
        failed = lambda: [r for r in sink.readings("gauge.pressure_bar_abs") if r.quality is Quality.TIMEOUT]  # noqa: E731
        wait_for(lambda: len(failed()) >= 3)
        count = len(failed())
        time.sleep(2.0)
        assert len(failed()) - count <= 2


def test_a_log_that_cannot_be_written_ends_the_run(acquiring, tmp_path):
    class Full(Kept):
        def exchange(self, exchange):
            raise OSError(28, "No space left on device")

    with serving(bench(MODBUS), tmp_path) as served:
        acquisition = Acquisition(bench(MODBUS), served.clock, ports_of(served))
        acquisition.connect()
        acquisition.begin(Full())
        wait_for(lambda: acquisition.recorder.failure is not None)
        with pytest.raises(RecorderError, match="No space left"):
            acquisition.last("speed")
        with pytest.raises(RecorderError):
            acquisition.stop()


def test_a_command_that_was_not_begun_in_time_is_never_done_unless_it_is_to_stand(acquiring, tmp_path, monkeypatch):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, _ = acquiring(served)
        worker = acquisition.workers["bus"]
        gate = threading.Event()
        done = []
        perform = actions.perform

        def slow(line, device, driver, action, argument=None):
            gate.wait(10.0)
            done.append((action, argument))
            return perform(line, device, driver, action, argument)

        monkeypatch.setattr(actions, "perform", slow)
        time.sleep(0.3)  # the line's thread waits in a poll by now
        with pytest.raises(NoReplyError, match="not done within"):
            acquisition.command("dac", "write", 2.0, 0.1)
        with pytest.raises(NoReplyError, match="not done within"):
            acquisition.command("dac", "write", 0.0, 0.1, take_back=False)
        gate.set()
        wait_for(lambda: ("write", 0.0) in done)
        assert ("write", 2.0) not in done
        assert worker.failure is None


def test_whatever_fails_while_a_line_is_mended_ends_the_run_in_words(acquiring, tmp_path, monkeypatch):
    with serving(bench(MODBUS), tmp_path) as served:
        acquisition, _ = acquiring(served)
        wait_for(lambda: acquisition.window("pressure", 1e6).size > 3)

        def broken(line):
            raise RuntimeError("what nobody thought of")

        monkeypatch.setattr(actions, "open_line", broken)
        served.ask(do="unplug", line="bus")
        wait_for(lambda: acquisition.workers["bus"].failure is not None)
        assert acquisition.workers["bus"].is_alive()
        with pytest.raises(RuntimeError, match="what nobody thought of"):
            acquisition.check()
