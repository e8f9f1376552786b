"""The manual bench, walked through at a terminal by a person who reads what the model says the dials would show."""

import contextlib
import os
import pty
import re
import select
import termios
import threading
import time
from types import SimpleNamespace

import pytest

from model.motor import read_motor
from model.operation.performance import operating_points
from rig.acquisition import Acquisition
from rig.bench.bench import read_bench
from rig.by_hand.conversation import Conversation, ValveHand
from rig.by_hand.entry import doubt_of_speed
from rig.by_hand.manual import ManualSweep
from rig.clock import Clock
from rig.exchange.export import recording_of
from rig.interlock.guard import Guard
from rig.interlock.limits import Limits
from rig.interlock.step import Verdict
from rig.lines.keyboard import KeyboardPort
from rig.plateaus.plan import Step
from rig.plateaus.plateau import Mean, Plateau
from rig.readings import Quality
from rig.replay.player import Player
from rig.replay.replaying import replay
from rig.runlog import RunWriter, read_run, start_record
from rig.runlog.start import Circumstances
from rig.sweep.ambient import Given, at_start
from rig.sweep.hooks import expecting
from rig.sweep.planning import sweep_course
from tests.person import answer, dial_in_kpa
from tests.sweep_hooks import hooks

GIVEN = Given(1.01325, 20.0, 0.5, "none", 0.0)
ZERO = "1.01 <10 0"
MOTOR = read_motor("ptm3600")


def dials(bar_abs):
    """What the person types at a pressure."""
    point = operating_points(MOTOR, [bar_abs * 1e5])[0]
    return answer(bar_abs, point.flow_l_min, point.speed_rpm)


def bench_of(levels=(1.6, 1.8), bench=None, **sweep):
    bench = bench or read_bench("manual")
    table = bench.file.sweep.model_copy(update={"levels_bar_abs": list(levels), "order": "up", "dwell_s": 0.3, **sweep})
    object.__setattr__(bench, "file", bench.file.model_copy(update={"sweep": table}))
    return bench


class Terminal:
    """A pty: the program at one end, a person who waits for words and types at the other."""

    def __init__(self):
        self.master, self.slave = pty.openpty()
        settings = termios.tcgetattr(self.slave)
        settings[3] &= ~termios.ECHO
        termios.tcsetattr(self.slave, termios.TCSANOW, settings)
        self.seen = self.unread = ""

    def expect(self, pattern):
        """Wait until the program has shown something, and forget what it showed before that."""
        end = time.monotonic() + 10.0
        while not (match := re.search(pattern, self.unread)):
            assert time.monotonic() < end, f"no '{pattern}' in:\n{self.unread}"
            if select.select([self.master], [], [], 0.2)[0]:
                data = os.read(self.master, 4096).decode()
                self.seen, self.unread = self.seen + data, self.unread + data
        self.unread = self.unread[match.end() :]
        return match

    def type(self, text):
        os.write(self.master, f"{text}\n".encode())

    def hang_up(self):
        """Ctrl-D at the start of a line."""
        os.write(self.master, b"\x04")


class Session:
    """A manual run in a thread of its own, with a real acquisition and a real run log."""

    def __init__(self, tmp_path, bench, **given):
        self.bench, self.terminal, self.clock = bench, Terminal(), Clock()
        self.stops = []
        self.ambient = at_start(bench, GIVEN)
        port = KeyboardPort(self.clock, self.terminal.slave, self.terminal.slave)
        self.conversation = Conversation(port, self.clock, lambda: len(self.stops))
        room = Circumstances(ambient=self.ambient.record())
        self.writer = RunWriter.create(tmp_path, start_record(bench, "manual", self.clock, {}, room), sync_s=60.0)
        self.acquisition = Acquisition(bench, self.clock, self.conversation.ports)
        self.course, _ = sweep_course(bench, self.ambient)
        self.hooks = hooks(**given)
        self.outcome = None
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        self.acquisition.connect()
        self.acquisition.begin(self.writer)
        with contextlib.ExitStack() as stack:
            stack.callback(self.acquisition.stop)
            parts = (self.acquisition, self.writer, self.bench, self.course, self.conversation, self.hooks)
            self.outcome = ManualSweep(*parts).run()

    def __enter__(self):
        self.thread.start()
        return self.terminal

    def __exit__(self, kind, error, trace):
        if kind is None:
            self.thread.join(10.0)
            assert not self.thread.is_alive(), self.terminal.unread
            assert self.outcome is not None
            self.writer.end(self.outcome.outcome, self.outcome.reason, vented=self.outcome.vented)
        else:
            self.writer.close()

    def read(self):
        return read_run(self.writer.folder)

    def events(self, kind):
        return [event.details for event in self.read().events if event.event == kind]


ENTRY = r"speed \[rpm\], separated by spaces: "
AFTER = r"pressure now\? .*\) "
CLOSED = r"Is it closed.*\) "


def take(terminal, bar_abs, after=None):
    """Answer a level's prompt and the one after it."""
    terminal.expect(r"set [\d.]+ bar abs")
    terminal.expect(ENTRY)
    terminal.type(dials(bar_abs))
    terminal.expect(AFTER)
    terminal.type(f"{bar_abs if after is None else after:.2f}")


def begin(terminal):
    terminal.expect("Zero at the start")
    terminal.expect(ENTRY)
    terminal.type(ZERO)


def finish(terminal):
    terminal.expect("CLOSE THE VALVE")
    terminal.expect(CLOSED)
    terminal.type("")
    terminal.expect("Zero at the end")
    terminal.expect(ENTRY)
    terminal.type(ZERO)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The article's levels, with repeat, undo, a note, a value off the scale, and everything mistyped once."""
    session = Session(tmp_path_factory.mktemp("runs"), bench_of((1.6, 1.7, 1.8, 2.0)))
    with session as terminal:
        begin(terminal)
        match = terminal.expect(r"set (\S+) bar abs = (\S+) bar gauge, from below")
        assert (match[1], match[2]) == ("1.600", "0.587")
        terminal.expect(ENTRY)
        terminal.type("1.60 44")
        terminal.expect("2 entries where there are 3 columns")
        terminal.expect(ENTRY)
        terminal.type("1,60 44 232")
        terminal.expect("write the decimals after a dot")
        terminal.expect(ENTRY)
        terminal.type("")  # it is set: count down
        terminal.expect(r"wait: 1 s over\r\n  pressure \[bar abs\]")
        assert not re.search(r"\r[^\n]", terminal.seen)  # nothing is written over
        terminal.unread = terminal.seen[-200:]
        terminal.expect(ENTRY)
        terminal.type("note the float sticks")
        terminal.expect(ENTRY)
        terminal.type(dials(1.6))
        terminal.expect(AFTER)
        terminal.type("1.64")
        terminal.expect(r"1\.6 bar abs up, 1\.62 \+- 0\.012 bar")
        take(terminal, 1.7)
        terminal.expect(r"set 1\.800")
        terminal.expect(ENTRY)
        terminal.type("undo")  # 1.7 again
        terminal.expect(r"plateau 2 at 1\.7 bar abs is taken back")
        take(terminal, 1.7)
        terminal.expect(r"set 1\.800")
        terminal.expect(ENTRY)
        terminal.type("1.80 >100 312")
        terminal.expect(AFTER)
        terminal.type("repeat")  # this level again
        take(terminal, 1.8)
        terminal.expect(r"set 2\.000")
        terminal.expect(ENTRY)
        terminal.type("repeat")  # the one before, once more
        take(terminal, 1.8)
        terminal.expect(r"set 2\.000")
        terminal.expect(ENTRY)
        terminal.type("2.00 >100 394")
        terminal.expect(AFTER)
        terminal.type("")
        finish(terminal)
    return session


def test_a_whole_manual_sweep_is_finished_and_vented(whole):
    assert (whole.outcome.outcome, whole.outcome.vented, whole.outcome.reason) == ("finished", True, "")
    run = whole.read()
    assert (run.start.kind, run.state) == ("manual", "finished")


def test_the_plateaus_are_those_that_were_not_taken_back(whole):
    taken = [(p.level_bar_abs, p.direction, p.repeat) for p in whole.read().plateaus]
    assert taken == [(1.6, "up", 1), (1.7, "up", 1), (1.8, "up", 1), (1.8, "up", 2), (2.0, "up", 1)]


def test_the_undone_plateau_is_still_in_the_table(whole):
    assert [(row.n, row.used) for row in whole.read().plateau_rows if row.level_bar_abs == 1.7] == [
        (2, True),
        (2, False),
        (3, True),
    ]


def test_the_drift_of_the_pressure_is_an_error_of_its_mean(whole):
    pressure = whole.read().plateaus[0].means["pressure_bar_abs"]
    assert pressure.mean == pytest.approx(1.62)
    assert pressure.se == pytest.approx(0.04 / 12**0.5)
    assert pressure.n == 2


def test_a_pressure_that_was_not_read_again_has_no_error(whole):
    pressure = whole.read().plateaus[-1].means["pressure_bar_abs"]
    assert (pressure.mean, pressure.se, pressure.n) == (2.0, None, 1)


def test_what_was_typed_is_what_is_logged(whole):
    speed = whole.read().plateaus[1].means["speed_rpm"]
    assert speed.mean == float(dials(1.7).split()[2])


def test_a_flow_off_the_scale_is_a_limit(whole):
    flow = whole.read().plateaus[-1].means["flow_l_min"]
    assert (flow.mean, flow.censored) == (100.0, 1)


def test_a_note_stays_with_its_plateau(whole):
    plateaus = whole.read().plateaus
    assert "the float sticks" in plateaus[0].note
    assert plateaus[1].note == ""


def test_the_zeros_are_in_the_log_for_an_export(whole):
    zeros = whole.events("zero")
    assert [(zero["which"], zero["vented"]) for zero in zeros] == [("start", True), ("end", True)]
    assert zeros[0]["start_s"] < zeros[0]["end_s"]
    assert zeros[0]["channels"]["person.pressure_bar_abs"]["mean"] == 1.01


def test_everything_that_was_typed_is_in_the_log(whole):
    typed = [event["text"] for event in whole.events("typed")]
    for text in ("1.60 44", "note the float sticks", "undo", "repeat", "2.00 >100 394"):
        assert text in typed


def test_readings_have_the_quality_manual_and_the_time_at_which_they_were_typed(whole):
    samples = whole.read().samples
    assert set(samples["quality"]) == {Quality.MANUAL.value}
    assert (samples["time_ns"].diff().dropna() >= 0).all()


def test_a_replay_of_the_wire_gives_the_same_readings_and_asks_the_same(whole):
    run = whole.read()
    player = Player(whole.bench, False, {"pressure_bar_abs": 1.01325, "temperature_c": 20.0})
    logged = [exchange for _, exchange in run.exchanges()]
    played = [player.play(exchange) for exchange in logged]
    assert sum(len(exchange.readings) for exchange in logged) > 30
    assert [exchange.readings for exchange in played] == [exchange.readings for exchange in logged]
    assert player.differences == []


# Ways out.


@pytest.fixture
def session(tmp_path):
    return Session(tmp_path, bench_of())


def test_a_dial_in_another_unit_is_set_asked_for_and_read_in_that_unit(tmp_path):
    session = Session(tmp_path, bench_of([1.6], dial_in_kpa(tmp_path)))
    asks = r"\n  pressure \[kPa gauge\], flow \[L/min\], speed \[rpm\], separated by spaces: "
    with session as terminal:
        terminal.expect(asks)
        terminal.type("0 <10 0")
        terminal.expect(r"set 1\.600 bar abs = 0\.587 bar gauge = 58\.6[78] kPa gauge on the dial" + r"[^\n]*" + asks)
        terminal.type(dials(1.6).replace("1.60", "0.59", 1))
        terminal.expect(r"\? that is 1\.019 bar abs, where 1\.6 was expected")  # bar, on a dial in kPa
        terminal.expect(asks)
        terminal.type(dials(1.6).replace("1.60", "59", 1))
        terminal.expect(r"pressure now\? \[kPa gauge\] .*\) ")
        terminal.type("58")
        terminal.expect("CLOSE THE VALVE")
        terminal.expect(CLOSED)
        terminal.type("")
        terminal.expect(asks)
        terminal.type("0 <10 0")
    (plateau,) = session.read().plateaus
    assert plateau.means["pressure_bar_gauge"].mean == pytest.approx(0.585)


def test_stop_says_close_the_valve_and_waits_for_the_answer(session):
    with session as terminal:
        begin(terminal)
        take(terminal, 1.6)
        terminal.expect(ENTRY)
        terminal.type("stop")
        terminal.expect("CLOSE THE VALVE")
        terminal.expect(CLOSED)
        terminal.type("no, it is stuck")
        terminal.expect(CLOSED)
        assert session.outcome is None
        terminal.type("closed")
    assert (session.outcome.outcome, session.outcome.reason) == ("aborted", "stopped by the operator")
    assert session.outcome.stopped_by == "operator"
    assert session.outcome.vented
    assert len(session.outcome.plateaus) == 1
    kinds = [event.event for event in session.read().events]
    assert kinds.index("unvented") < kinds.index("vented")


def test_an_input_that_ends_aborts_the_run_as_unvented(session):
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        terminal.hang_up()
    assert session.outcome.outcome == "aborted"
    assert not session.outcome.vented
    assert "nobody has said that the valve is closed" in session.outcome.reason
    assert "the input has ended" in session.outcome.reason


def test_ctrl_c_asks_for_the_valve_and_a_second_one_ends_unvented(session):
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        session.stops.append("Ctrl-C")
        terminal.expect("CLOSE THE VALVE")
        terminal.expect(CLOSED)
        session.stops.append("Ctrl-C")
    assert (session.outcome.outcome, session.outcome.vented) == ("aborted", False)


def test_a_typed_speed_beyond_the_limit_closes_the_run(tmp_path):
    bench = bench_of()
    limits = Limits(bench.file.safety, bench.file.roles, 1.01325)
    session = Session(tmp_path, bench, trip=limits.trip)
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        terminal.type("1.60 44 632")
        terminal.expect(r"\? a speed of 632 rpm is beyond the bench's limit of 600 rpm; if it is so, close the valve")
        terminal.expect(ENTRY)
        terminal.type("1.60 44  632")
        terminal.expect(r"\*\*\* speed 632 rpm")
        terminal.expect(CLOSED)
        terminal.type("")
    assert session.outcome.outcome == "aborted"
    assert "limit 600 rpm" in session.outcome.reason
    assert session.outcome.vented


@pytest.mark.parametrize("typed", [None, ""])
def test_a_polled_speed_beyond_the_limit_closes_the_run_while_a_prompt_is_open_and_while_it_counts_down(
    tmp_path, typed
):
    polled = []
    session = Session(tmp_path, bench_of(dwell_s=60.0), trip=lambda *asked: next(iter(polled), None))
    with session as terminal:
        begin(terminal)
        terminal.expect(r"set 1\.600")
        terminal.expect(ENTRY)
        if typed is not None:
            terminal.type(typed)
            terminal.expect("wait: 60 s")
        polled.append("speed 632 rpm (tach.speed_rpm), limit 600 rpm")
        terminal.expect(r"\n\*\*\* speed 632 rpm")
        terminal.expect(CLOSED)
        terminal.type("")
    assert (session.outcome.outcome, session.outcome.stopped_by) == ("aborted", "interlock")
    assert session.outcome.vented


def expected_to_the_point(bar_abs, plateaus):
    speed = operating_points(MOTOR, [bar_abs * 1e5])[0].speed_rpm
    return 0.95 * speed, 1.05 * speed


@pytest.mark.parametrize("slip", ["1.60 44 23.3", "1.60 44 2323", "1.60 44 >9999", "2.60 44 233", "5.60 44 233"])
def test_a_slip_of_the_hand_is_asked_for_again_and_is_no_reading(tmp_path, slip):
    bench = bench_of()
    trip = Limits(bench.file.safety, bench.file.roles, 1.01325).trip
    session = Session(tmp_path, bench, trip=trip, expect=expected_to_the_point)
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        terminal.type(slip)
        terminal.expect(r"\? .*Type the right figures, or the same again if they are right\.")
        terminal.expect(ENTRY)
        terminal.type(dials(1.6))
        terminal.expect(AFTER)
        terminal.type("6.0" if slip.startswith("5") else "1.06")
        terminal.expect(r"\? .*Type the right figures")
        terminal.expect(AFTER)
        terminal.type("1.60")
        take(terminal, 1.8)
        finish(terminal)
    assert (session.outcome.outcome, session.outcome.reason) == ("finished", "")
    assert slip in [event["text"] for event in session.events("typed")]
    assert len(session.events("doubted")) == 2
    assert [plateau.means["pressure"].mean for plateau in session.outcome.plateaus] == [1.6, 1.8]
    assert session.read().samples["value"].max() < 400.0  # the slip is not among the readings


def test_what_is_typed_twice_is_believed(tmp_path):
    session = Session(tmp_path, bench_of((1.6,)), expect=expected_to_the_point)
    with session as terminal:
        begin(terminal)
        for _ in range(2):
            terminal.expect(ENTRY)
            terminal.type("1.60 44 120")
        terminal.expect(AFTER)
        terminal.type("")
        finish(terminal)
    (plateau,) = session.outcome.plateaus
    assert plateau.means["speed"].mean == 120.0


def test_a_zero_that_is_none_is_asked_for_again(tmp_path):
    session = Session(tmp_path, bench_of((1.6,)))
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("1.60 44 232")
        terminal.expect(r"\? that is 1\.600 bar abs, where 1\.01\d* was expected; a speed of 232 rpm is far from")
        terminal.expect(ENTRY)
        terminal.type(ZERO)
        take(terminal, 1.6)
        finish(terminal)
    assert session.outcome.outcome == "finished"


def test_the_guard_knows_what_to_expect_after_the_first_plateaus():
    """272 rpm at 1.7 bar: 27.2 and 2720 are slips, 0 is a rotor that does not run, 260 is another motor."""
    means = {"pressure": Mean(1.6, None, 1), "speed": Mean(232.0, None, 1)}
    known = [Plateau(1, Step(1.6, "up", 1), 0, 1, True, means)]
    expected = expecting(Guard(MOTOR, 600.0, 5540.0), 1.01325, False)(1.7, known)
    doubts = {
        speed: doubt_of_speed(SimpleNamespace(value=speed, censored=0, raw=str(speed)), expected, 600.0)
        for speed in (0.0, 27.2, 260.0, 272.0, 285.0, 2720.0)
    }
    assert {speed for speed, why in doubts.items() if not why} == {260.0, 272.0, 285.0}
    assert expecting(Guard(MOTOR, 600.0, 5540.0), 1.01325, False)(50.0, known) is None


def test_undo_goes_back_to_the_zero_and_from_the_closed_valve(session):
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("1.10 <10 0")
        terminal.expect(r"set 1\.600")
        terminal.expect(ENTRY)
        terminal.type("undo")
        begin(terminal)
        take(terminal, 1.6)
        terminal.expect(r"set 1\.800")
        terminal.expect(ENTRY)
        terminal.type("1.80 54 333")
        terminal.expect(AFTER)
        terminal.type("1.80")
        terminal.expect(CLOSED)
        terminal.type("undo")
        terminal.expect(r"plateau 2 at 1\.8 bar abs is taken back")
        take(terminal, 1.8)
        finish(terminal)
    assert (session.outcome.outcome, session.outcome.vented) == ("finished", True)
    run = session.read()
    (zero,) = [file for file in recording_of(run).recording.files if file.kind == "zero"]
    assert zero.columns["pressure_bar_abs"].values.tolist() == [1.01, 1.01]
    assert len(run.plateaus) == 2
    assert run.plateaus[1].means["speed_rpm"].mean != 333.0


def test_what_was_said_of_the_room_is_put_right_at_any_prompt(session):
    session.conversation.room = session.ambient
    with session as terminal:
        begin(terminal)
        terminal.expect(r"set 1\.600 bar abs = 0\.587 bar gauge")
        terminal.expect(ENTRY)
        terminal.type("room")
        for prompt, text in (
            (r"Ambient pressure .*\(Enter for 1013.25, as said before\)", "913"),
            ("Room temperature", "back"),
            ("Ambient pressure", "983"),
            ("Room temperature", ""),
            ("Relative humidity", "40"),
            ("Minutes that the motor", ""),
            ("Lubrication", ""),
        ):
            terminal.expect(prompt)
            terminal.type(text)
        terminal.expect("the room: 983 mbar, 20 degC, 40 %, 0 min running, lubrication none")
        terminal.expect(ENTRY)
        terminal.type(dials(1.6))
        terminal.expect(AFTER)
        terminal.type("1.60")
        terminal.expect(r"set 1\.800 bar abs = 0\.817 bar gauge")
        terminal.expect(ENTRY)
        terminal.type(dials(1.8))
        terminal.expect(AFTER)
        terminal.type("1.80")
        finish(terminal)
    assert session.conversation.room.pressure_bar_abs == pytest.approx(0.983)
    recording = recording_of(session.read()).recording
    assert recording.ambient.pressure_bar_abs == pytest.approx(0.983)
    assert recording.ambient.relative_humidity == pytest.approx(0.4)
    assert session.read().start.ambient.pressure_bar_abs == 1.01325  # what was said first stays


ROOM_QUESTIONS = ("Ambient pressure", "Room temperature", "Relative humidity", "Minutes that the motor", "Lubrication")


def put_right(terminal, *answers):
    """Type what is right of the room at an open prompt."""
    terminal.type("room")
    for question, text in zip(ROOM_QUESTIONS, answers, strict=True):
        terminal.expect(question)
        terminal.type(text)


def test_a_room_that_is_put_right_holds_for_the_flow_from_then_on_in_a_replay_too_and_its_oil_is_exported(tmp_path):
    bench = dial_in_kpa(tmp_path)
    mine = (tmp_path / "manual_bench.toml").read_text()
    scale = 'reference = { kind = "rotameter_scale", pressure_bar_abs = 1.01325, temperature_c = 20.0 }\n'
    (tmp_path / "manual_bench.toml").write_text(
        mine.replace("[channels.flow_l_min]", f"[channels.flow_l_min]\n{scale}")
    )
    bench = read_bench(tmp_path / "kpa.toml")
    session = Session(tmp_path, bench_of((1.6, 1.7), bench))
    session.conversation.room = session.ambient
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("0 <10 0")
        for level, shown in ((1.6, "60"), (1.7, "70")):
            terminal.expect(rf"set {level:.3f}")
            terminal.expect(ENTRY)
            if level == 1.7:
                put_right(terminal, "900", "0", "", "", "oil today")
                terminal.expect(ENTRY)
            terminal.type(f"{shown} 50 250")
            terminal.expect(AFTER)
            terminal.type("")
        terminal.expect(CLOSED)
        terminal.type("")
        terminal.expect(ENTRY)
        terminal.type("0 <10 0")
    run = session.read()
    flows = [plateau.means["flow_l_min"].mean for plateau in run.plateaus]
    at = lambda bar, celsius: 50.0 * (1.01325 / bar * (celsius + 273.15) / 293.15) ** 0.5  # noqa: E731
    assert flows == pytest.approx([at(1.61325, 20.0), at(1.6, 0.0)], rel=1e-6)
    assert replay(run).same
    exported = recording_of(run)
    assert exported.recording.origin["oil"] == "oil today"
    assert [note for note in exported.notes if "what was told of the room by then" in note]


def test_the_guard_is_asked_before_each_level_is_prompted(tmp_path):
    def predict(level, plateaus):
        return Verdict(level < 1.7, "99 % below 640 rpm", 1.6e5)

    session = Session(tmp_path, bench_of(), predict=predict)
    with session as terminal:
        begin(terminal)
        take(terminal, 1.6)
        terminal.expect(r"1\.8 bar abs and above are left out: 99 % below 640 rpm")
        finish(terminal)
    assert [step.level_bar_abs for step in session.outcome.left_out] == [1.8]
    assert session.outcome.outcome == "finished"


def test_skip_leaves_a_level_and_a_zero_out(session):
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("skip")
        terminal.expect(r"set 1\.600")
        terminal.expect(ENTRY)
        terminal.type("skip")
        take(terminal, 1.8)
        finish(terminal)
    assert [plateau.step.level_bar_abs for plateau in session.outcome.plateaus] == [1.8]
    assert [zero["which"] for zero in session.events("zero")] == ["end"]


def test_skip_of_a_level_that_the_guard_puts_in_leaves_out_the_one_that_needs_it(tmp_path):
    def predict(level, plateaus):
        highest = 1.5 if plateaus else 1.3
        return Verdict(level <= highest, "not known well enough", highest * 1e5)

    session = Session(tmp_path, bench_of((1.4, 1.5)), predict=predict)
    with session as terminal:
        begin(terminal)
        terminal.expect(r"measuring 1\.3 bar abs first")
        terminal.expect(ENTRY)
        terminal.type("skip")
        terminal.expect(r"1\.4 bar abs is left out")
        terminal.expect(r"measuring 1\.3 bar abs first")
        take(terminal, 1.3)
        take(terminal, 1.5)
        finish(terminal)
    assert [plateau.step.level_bar_abs for plateau in session.outcome.plateaus] == [1.3, 1.5]
    assert [step.level_bar_abs for step in session.outcome.left_out] == [1.4]


def test_a_level_that_was_overshot_is_told(session):
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        terminal.type(dials(1.64))
        terminal.expect(r"1\.640 bar abs is beyond 1\.6, which is approached from below: go well down")
        terminal.expect(AFTER)
        terminal.type("repeat")
        take(terminal, 1.6)
        take(terminal, 1.8)
        finish(terminal)
    assert [plateau.note for plateau in session.outcome.plateaus] == ["", ""]


def test_a_pressure_far_from_the_level_is_told(session):
    with session as terminal:
        begin(terminal)
        terminal.expect(ENTRY)
        terminal.type(dials(1.8))
        terminal.expect(r"1\.800 bar abs was typed where 1\.6 was asked for")
        terminal.expect(AFTER)
        terminal.type("1.80")
        take(terminal, 1.8)
        finish(terminal)
    assert "was asked for" in session.outcome.plateaus[0].note


def test_help_lists_the_commands(session):
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("help")
        terminal.expect(r"undo +take the last plateau back")
        terminal.type("stop")
        terminal.expect(CLOSED)
        terminal.type("")


def test_with_agreeing_readings_a_level_is_read_until_two_agree(tmp_path):
    session = Session(tmp_path, bench_of((1.6,), agreeing_readings=2))
    with session as terminal:
        begin(terminal)
        for text in ("1.60 44 210", "1.60 44 229", "1.60 45 230"):
            terminal.expect(ENTRY)
            terminal.type(text)
        terminal.expect(AFTER)
        terminal.type("1.60")
        finish(terminal)
    speed = session.read().plateaus[0].means["speed_rpm"]
    assert (speed.mean, speed.n) == (229.5, 2)
    assert session.outcome.plateaus[0].settled


def test_readings_that_never_agree_are_recorded_as_not_settled(tmp_path):
    session = Session(tmp_path, bench_of((1.6,), agreeing_readings=2))
    with session as terminal:
        begin(terminal)
        for i in range(10):
            terminal.expect(ENTRY)
            terminal.type(f"1.60 44 {200 + 10 * i}")
        terminal.expect(AFTER)
        terminal.type("1.60")
        terminal.expect("not settled")
        finish(terminal)
    assert not session.outcome.plateaus[0].settled
    assert "no 2 readings agreed" in session.outcome.plateaus[0].note


def test_a_falling_leg_is_approached_from_above(tmp_path):
    session = Session(tmp_path, bench_of((1.6,), order="up-down"))
    with session as terminal:
        begin(terminal)
        take(terminal, 1.6)
        terminal.expect(r"set 1\.600 bar abs = 0\.587 bar gauge, from above")
        terminal.expect(ENTRY)
        terminal.type(dials(1.6))
        terminal.expect(AFTER)
        terminal.type("1.60")
        finish(terminal)


def test_control_characters_and_endless_lines_do_no_harm(session):
    with session as terminal:
        terminal.expect(ENTRY)
        terminal.type("\x1b[2J=cmd|1.0")
        terminal.expect(ENTRY)
        terminal.type("1 " * 1500)
        terminal.expect("characters; type")
        terminal.type("stop")
        terminal.expect(CLOSED)
        terminal.type("")
    assert all(len(event["text"]) <= 201 for event in session.events("typed"))


def test_a_pipe_does_as_well_as_a_terminal(tmp_path):
    session = Session(tmp_path, bench_of((1.6,)))
    read_end, write_end = os.pipe()
    session.conversation.port = KeyboardPort(session.clock, read_end, session.terminal.slave)
    session.conversation.port.open()
    session.acquisition = Acquisition(session.bench, session.clock, session.conversation.ports)
    os.write(write_end, f"{ZERO}\n{dials(1.6)}\n1.60\n\n{ZERO}\n".encode())
    with session:
        pass
    assert (session.outcome.outcome, len(session.outcome.plateaus)) == ("finished", 1)


def test_a_bench_without_a_keyboard_is_refused():
    from rig.by_hand.by_hand import manual_device
    from rig.plateaus.plan import SweepError
    from tests.sweep_lab import LabBench

    with pytest.raises(SweepError, match="keyboard"):
        manual_device(LabBench())


def test_the_room_is_asked_on_the_same_keyboard(tmp_path):
    terminal, clock = Terminal(), Clock()
    conversation = Conversation(KeyboardPort(clock, terminal.slave, terminal.slave), clock)
    found = []
    thread = threading.Thread(target=lambda: found.append(at_start(read_bench("manual"), None, conversation.ask_text)))
    thread.start()
    for pattern, text in [("mbar", "1013.25"), ("degC", "20"), ("%", "50"), ("Lubrication", ""), ("Minutes", "0")]:
        terminal.expect(pattern)
        terminal.type(text)
    thread.join(5.0)
    assert found[0].pressure_bar_abs == pytest.approx(1.01325)


def test_a_hand_at_the_valve_is_asked_and_the_bench_goes_on_meanwhile():
    terminal, clock = Terminal(), Clock()
    person = ValveHand(Conversation(KeyboardPort(clock, terminal.slave, terminal.slave), clock))
    terminal.type("typed too early")
    person.ask("Set 1.600 bar absolute, then press Enter")
    terminal.expect("Set 1.600")
    assert person.answer() is None
    terminal.type("")
    end = time.monotonic() + 5.0
    while person.answer() is None and time.monotonic() < end:
        time.sleep(0.01)
    assert person.answer() == ""
