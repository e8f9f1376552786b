"""The edge counter over a pty: times of teeth become speeds and angles, and nothing lost passes unseen."""

import itertools
import math
import os
import pty
import select
import threading
import tty

import pytest

from configs import ConfigError
from rig.bench.bench import DeviceTable, LineTable, Place
from rig.bench.instrument import IdentityError
from rig.clock import Clock
from rig.instruments import edge_counter
from rig.instruments.codecs.edge_frames import EDGE, HEARTBEAT, DeviceClock, Frame
from rig.lines import BadReplyError, Line, Timing
from rig.lines.serial import SerialPort
from rig.readings import NS, Quality
from tests.instrument_peers import edge_bytes, read_instrument

TIMING = Timing(timeout_s=0.2, slowest_reply_s=0.2, quiet_s=0.005)
TICKS_A_SECOND = 1_000_000  # of 1000 ns, which a driver assumes until the device has told


class Counter:
    """The device's end: makes frames with a clock, a count and a sequence of its own."""

    def __init__(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.ticks, self.edges, self.sequence = 0xFFFF_0000, 250, 250  # all of them wrap soon

    def frame(self, kind, after_s, flags=0, edges=None):
        self.ticks = (self.ticks + round(after_s * TICKS_A_SECOND)) & 0xFFFFFFFF
        self.edges = (self.edges + (kind == EDGE if edges is None else edges)) & 0xFF
        self.sequence = (self.sequence + 1) & 0xFF
        return edge_bytes(Frame(kind, self.sequence, flags, self.ticks, self.edges))

    def teeth(self, count, after_s, **more):
        return b"".join(self.frame(EDGE, after_s, **more) for _ in range(count))

    def beats(self, count):
        return b"".join(self.frame(HEARTBEAT, 0.05) for _ in range(count))

    def send(self, data):
        os.write(self.master, data)

    def asked(self, wait_s=0.0):
        return os.read(self.master, 100) if select.select([self.master], [], [], wait_s)[0] else b""


@pytest.fixture
def tach():
    """A driver of a wheel of 20 teeth on an open line, and its counter."""
    counter, clock = Counter(), Clock()
    line = Line("usb", SerialPort(os.ttyname(counter.slave), clock), clock, TIMING)
    line.open()
    driver = edge_counter.EdgeCounter("tach", read_instrument("edge_counter_20"))
    driver.open(line)
    yield driver, line, counter
    line.close()
    os.close(counter.master)
    os.close(counter.slave)


def poll(tach, data):
    driver, line, counter = tach
    counter.send(data)
    (reading,) = driver.poll(line)
    return reading


def capture(tach, data):
    driver, line, counter = tach
    counter.send(data)
    return driver.poll_edges(line)


def test_a_poll_is_the_mean_over_the_whole_teeth_since_the_last(tach):
    _, _, counter = tach
    first = poll(tach, counter.teeth(11, 0.01))  # 20 teeth in 0.2 s: 300 rpm
    assert first.value == pytest.approx(300.0)
    assert (first.quality, first.raw, first.channel) == (Quality.OK, "10 edges in 100000 ticks", "speed_rpm")
    second = poll(tach, counter.teeth(4, 0.01) + counter.teeth(2, 0.02))
    assert second.value == pytest.approx(60.0 * 6 / 20 / 0.08)
    assert second.time_ns > first.time_ns


def test_the_device_is_started_before_it_is_listened_to(tach):
    _, _, counter = tach
    poll(tach, counter.teeth(2, 0.01))
    assert counter.asked() == b"S\n"


def test_a_frame_in_two_pieces_is_read_whole(tach):
    _, _, counter = tach
    data = counter.teeth(5, 0.01)
    later = threading.Timer(0.02, counter.send, [data[17:]])
    later.start()
    assert poll(tach, data[:17]).value == pytest.approx(300.0)
    later.join()


def test_a_poll_waits_for_a_tooth_while_heartbeats_come(tach):
    _, _, counter = tach
    poll(tach, counter.teeth(3, 0.01))
    beat = counter.beats(1)
    later = threading.Timer(0.02, counter.send, [counter.beats(1) + counter.teeth(1, 0.01)])
    later.start()
    assert poll(tach, beat).value == pytest.approx(3.0 / 0.11)
    later.join()


def test_heartbeats_alone_are_standstill_read_as_zero_or_less(tach):
    _, _, counter = tach
    poll(tach, counter.teeth(3, 0.01))
    standing = poll(tach, counter.beats(11))
    assert (standing.value, standing.quality, standing.censored) == (0.0, Quality.OK, -1)
    assert poll(tach, counter.beats(1)).censored == -1
    # the first tooth after a stand says when, not how fast
    assert poll(tach, counter.teeth(1, 0.01) + counter.teeth(2, 0.02)).value == pytest.approx(150.0)


def test_silence_is_a_timeout_and_the_device_is_started_again(tach):
    driver, line, counter = tach
    reading = poll(tach, counter.teeth(2, 0.01))
    assert counter.asked() == b"S\n"
    (reading,) = driver.poll(line)
    assert (reading.value, reading.quality) == (None, Quality.TIMEOUT)
    assert counter.asked() == b""
    driver.poll(line)
    assert counter.asked() == b"S\n"
    driver.poll(line)
    assert driver.failing


@pytest.mark.parametrize(
    ("spoil", "quality", "words"),
    [
        (lambda data: data[:30] + data[40:], Quality.CRC, "1 frames are missing"),
        (lambda data: data[:34] + b"\x00" + data[35:], Quality.CRC, "1 frames are missing"),
        (lambda data: data[:30] + b"\x00\xa5E\x00" + data[30:], Quality.OK, ""),
        (lambda data: data[:30] + data[20:30] + data[30:], Quality.OK, ""),
    ],
    ids=["dropped", "corrupt", "noise between", "doubled"],
)
def test_a_spoiled_stream_gives_no_wrong_speed(tach, spoil, quality, words):
    _, _, counter = tach
    reading = poll(tach, spoil(counter.teeth(11, 0.01)))
    assert (reading.quality, reading.detail) == (quality, words)
    assert reading.value == (pytest.approx(300.0) if quality is Quality.OK else None)
    assert poll(tach, counter.teeth(10, 0.01)).value == pytest.approx(300.0)


def test_a_counter_whose_clock_stands_is_told_though_it_sends(tach):
    """It has no other way to tell that the shaft stands."""
    driver, line, counter = tach
    ended = threading.Event()

    def beats():
        while not ended.wait(0.02):
            counter.send(counter.frame(HEARTBEAT, 0.0))

    sending = threading.Thread(target=beats)
    sending.start()
    try:
        (reading,) = driver.poll(line)
    finally:
        ended.set()
        sending.join()
    assert (reading.value, reading.quality) == (None, Quality.STALE)
    assert "the counter's clock stands" in reading.detail


def test_edges_that_the_device_lost_are_an_exception(tach):
    _, _, counter = tach
    poll(tach, counter.teeth(3, 0.01))
    reading = poll(tach, counter.teeth(2, 0.01) + counter.frame(EDGE, 0.05, flags=1))
    assert (reading.value, reading.quality) == (None, Quality.EXCEPTION)
    assert "the device has lost edges" in reading.detail


def test_a_count_that_jumps_is_not_believed(tach):
    _, _, counter = tach
    reading = poll(tach, counter.teeth(3, 0.01) + counter.frame(EDGE, 0.01, edges=2))
    assert (reading.value, reading.quality) == (None, Quality.CRC)


@pytest.mark.parametrize("ticks", [0x3000_0000, 0x7000_0000, 0xA000_0000])
def test_a_counter_that_was_started_anew_is_noticed(tach, ticks):
    _, _, counter = tach
    poll(tach, counter.teeth(3, 0.01))
    counter.ticks = ticks
    assert "was started anew" in poll(tach, counter.teeth(3, 0.01)).detail
    assert poll(tach, counter.teeth(3, 0.01)).value == pytest.approx(300.0)


def test_bytes_without_a_frame_are_damage(tach):
    assert poll(tach, bytes(300)).quality is Quality.CRC


def test_a_capture_gives_speed_and_angle_at_each_tooth(tach):
    _, _, counter = tach
    readings = capture(tach, counter.teeth(1, 0.01) + counter.teeth(1, 0.01, flags=2) + counter.teeth(1, 0.02))
    assert [reading.channel for reading in readings] == [
        "angle_rad",
        "speed_rpm",
        "angle_rad",
        "speed_rpm",
        "angle_rad",
    ]
    speeds = [reading for reading in readings if reading.channel == "speed_rpm"]
    angles = [reading for reading in readings if reading.channel == "angle_rad"]
    assert [speed.value for speed in speeds] == pytest.approx([300.0, 150.0])
    assert [angle.value for angle in angles] == pytest.approx([0.0, math.pi / 10, math.pi / 5])
    assert [angle.detail for angle in angles] == ["", "index tooth", ""]
    assert [b.time_ns - a.time_ns for a, b in itertools.pairwise(angles)] == [10_000_000, 20_000_000]


def test_a_capture_goes_on_over_standstill_and_loss(tach):
    _, _, counter = tach
    capture(tach, counter.teeth(3, 0.01))
    assert capture(tach, counter.beats(2)) == []
    (standing,) = capture(tach, counter.beats(9))
    assert (standing.value, standing.censored) == (0.0, -1)
    assert [reading.channel for reading in capture(tach, counter.teeth(1, 0.01))] == ["angle_rad"]
    counter.sequence += 3
    speed, angle = capture(tach, counter.teeth(1, 0.01))
    assert (speed.value, speed.quality, angle.quality) == (None, Quality.CRC, Quality.CRC)


def test_a_capture_from_a_counter_that_has_fallen_silent_is_a_timeout(tach):
    driver, line, counter = tach
    capture(tach, counter.teeth(2, 0.01))
    (reading,) = driver.poll_edges(line)
    assert (reading.channel, reading.value, reading.quality) == ("speed_rpm", None, Quality.TIMEOUT)


def test_frames_that_are_missing_ahead_of_a_heartbeat_are_told_in_a_capture(tach):
    _, _, counter = tach
    capture(tach, counter.teeth(2, 0.01))
    counter.sequence += 2
    (reading,) = capture(tach, counter.beats(1))
    assert (reading.value, reading.quality, reading.detail) == (None, Quality.CRC, "2 frames are missing")


def test_a_counter_that_is_started_anew_in_a_capture_gives_no_speed_over_the_start(tach):
    """Of the time before only what its clock counted since would be in it: 60 000 rpm."""
    _, _, counter = tach
    capture(tach, counter.teeth(2, 0.01))
    counter.ticks = 0xA000_0000
    readings = capture(tach, counter.beats(1) + counter.teeth(1, 5e-5) + counter.teeth(1, 0.01))
    speeds = [reading for reading in readings if reading.channel == "speed_rpm"]
    assert ["was started anew" in speed.detail for speed in speeds] == [True, False]
    assert (speeds[0].value, speeds[1].value) == (None, pytest.approx(300.0))


def test_half_a_frame_is_no_reading_of_a_capture_and_its_other_half_is(tach):
    _, _, counter = tach
    capture(tach, counter.teeth(2, 0.01))
    frame = counter.teeth(1, 0.01)
    assert capture(tach, frame[:4]) == []
    speed, _ = capture(tach, frame[4:])
    assert speed.value == pytest.approx(300.0)


def test_what_was_left_behind_by_a_full_read_is_of_the_same_capture(tach):
    _, _, counter = tach
    readings = capture(tach, counter.teeth(300, 0.01))
    assert len([one for one in readings if one.channel == "angle_rad"]) == 300


def test_a_counter_without_an_angle_in_its_file_tells_speeds_alone(tach):
    driver, _, counter = tach
    driver.channels = {name: one for name, one in driver.channels.items() if name == "speed_rpm"}
    assert [one.channel for one in capture(tach, counter.teeth(3, 0.01))] == ["speed_rpm"] * 2


def test_a_tooth_s_time_is_the_device_s_on_the_quickest_way_here():
    clock = DeviceClock()
    clock.saw(arrival_ns=10_500, device_ns=100)  # 400 late
    assert clock.offset_ns == 10_400
    clock.saw(arrival_ns=10_300, device_ns=300)
    assert clock.offset_ns == 10_000
    clock.saw(arrival_ns=11_200, device_ns=500)  # late again, and the quick one still counts
    assert clock.offset_ns == 10_000


def test_however_long_nothing_comes_quickly_a_time_is_off_by_no_more_than_the_clocks_drift():
    clock = DeviceClock()
    clock.saw(arrival_ns=NS, device_ns=0)
    for second in range(2, 62):  # a machine that is busy for a minute: everything is two seconds late
        clock.saw(arrival_ns=(second + 2) * NS, device_ns=(second - 1) * NS)
    assert NS <= clock.offset_ns <= NS + 7_000_000
    clock.saw(arrival_ns=70 * NS, device_ns=69 * NS + 1_000_000)  # the device's clock is the faster one
    assert clock.offset_ns == NS - 1_000_000


def identify(tach, answer, serial_number=""):
    _, line, counter = tach
    driver = edge_counter.EdgeCounter("tach", read_instrument("edge_counter_20"), serial_number)
    ended = threading.Event()
    heard = []

    def answers():
        while not ended.is_set():
            heard.append(counter.asked(0.01))
            if b"I\n" in heard[-1]:
                counter.send(answer)

    thread = threading.Thread(target=answers)
    thread.start()
    try:
        return driver.identify(line)
    finally:
        ended.set()
        thread.join()
        tach[2].heard = b"".join([*heard, counter.asked(0.01)])


def test_a_counter_tells_its_number_even_while_it_sends(tach):
    _, _, counter = tach
    counter.send(counter.teeth(3, 0.01))
    found = identify(tach, counter.teeth(1, 0.01)[3:] + b"EDGE1 K42 1.2 teeth=20 tick_ns=250\n", "K42")
    assert found == "edge counter K42, firmware 1.2, 20 teeth, ticks of 250 ns"
    assert counter.heard == b"X\nI\nS\n"


@pytest.mark.parametrize(
    ("answer", "serial_number", "words"),
    [
        (b"EDGE1 K42 1.2 teeth=60 tick_ns=250\n", "", "set to 60 teeth .* its file says 20 teeth"),
        (b"EDGE1 K42 1.2 teeth=20 tick_ns=250\n", "K43", "number 'K42' answers, the bench file says 'K43'"),
    ],
)
def test_another_counter_is_told(tach, answer, serial_number, words):
    with pytest.raises(IdentityError, match=words):
        identify(tach, answer, serial_number)


def test_a_device_that_sends_on_and_does_not_tell_who_it_is_is_none(tach):
    _, _, counter = tach
    with pytest.raises(BadReplyError, match="bytes without the identity of an edge counter"):
        identify(tach, counter.teeth(500, 0.01))


def test_a_file_with_a_channel_that_no_counter_has_is_refused():
    settings = read_instrument("edge_counter_20")
    channels = settings.model_dump(exclude_unset=True)["channels"]
    with pytest.raises(ValueError, match=r"an edge counter has speed_rpm, and angle_rad for captures"):
        type(settings).model_validate(settings.model_dump() | {"channels": channels | {"flow": channels["angle_rad"]}})


def test_an_edge_counter_is_built_from_its_place():
    place = Place(DeviceTable(instrument="i", line="usb"), LineTable(kind="serial", port="p", paced=False))
    driver = edge_counter.build("tach", read_instrument("edge_counter_20"), place)
    assert set(driver.channels) == {"speed_rpm", "angle_rad"}


def test_an_edge_counter_is_on_no_keyboard():
    place = Place(DeviceTable(instrument="i", line="keys"), LineTable(kind="keyboard"))
    with pytest.raises(
        ConfigError, match=r"devices\.tach\.line: this instrument has a cable; name a serial or tcp line"
    ):
        edge_counter.build("tach", read_instrument("edge_counter_20"), place)
