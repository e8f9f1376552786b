"""The doctor, culprit by culprit: real bytes over pseudo-terminals, real processes, files in place of /proc."""

import contextlib
import fcntl
import os
import pickle
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from rich.console import Console

from rig.acquisition.opening import port_of
from rig.bench.bench import BENCH_SOURCE, INSTRUMENTS, bench_of, instrument_source, read_bench
from rig.doctor import Finding, Level, examine, table
from rig.doctor.host import Host
from tests.instrument_peers import Peer
from tests.modbus_peer import ADAM, ModbusPeer

KELLER = {2: 0x3F80, 3: 0, 4: 0, 5: 0, 6: 0x41A0, 7: 0}  # 1 bar, 0, 20 degree Celsius
BENCH = """
format = "bench/1"
title = "a gauge and a regulator"
[lines.bus]
kind = "serial"
port = "{port}"
baud = {baud}
timeout_s = {timeout_s}
slowest_reply_s = {timeout_s}
[devices.gauge]
instrument = "keller_30x_abs"
line = "bus"
unit_id = {gauge}
period_s = {period_s}
[devices.regulator]
instrument = "adam_4024_regulator"
line = "bus"
unit_id = 2
channel = 0
span = [0.0, 5.0]
period_s = 0.5
[lines.person]
kind = "keyboard"
[devices.hand]
instrument = "manual_bench"
line = "person"
[roles]
pressure = "gauge.pressure_bar_abs"
speed = "hand.speed_rpm"
regulator = "regulator"
[sweep]
levels_bar_abs = [1.5]
"""


@pytest.fixture
def host(tmp_path):
    """A machine on which nothing runs and no port is."""
    for name in ("proc", "sys", "dev"):
        (tmp_path / "host" / name).mkdir(parents=True)
    root = tmp_path / "host"
    return Host(root / "proc", root / "sys", root / "dev")


def bench_at(path):
    """A bench that is examined only: no run could be made with it, for a person reads its tachometer."""
    files = [file for folder in (INSTRUMENTS, path.parent) for file in folder.glob("*.toml")]
    sources = {instrument_source(file.stem): file.read_bytes() for file in files}
    return bench_of(path.stem, sources | {BENCH_SOURCE: path.read_bytes()}, str(path))


@pytest.fixture
def bench_on(tmp_path):
    """A bench file with these keys."""

    def make(port, baud=19200, timeout_s=0.15, gauge=1, period_s=0.2):
        path = tmp_path / "bench.toml"
        path.write_text(BENCH.format(port=port, baud=baud, timeout_s=timeout_s, gauge=gauge, period_s=period_s))
        return bench_at(path)

    return make


def peer(**more):
    return ModbusPeer({1: dict(KELLER), 2: dict(ADAM)}, **more)


def of(findings, where, level):
    return [finding for finding in findings if (finding.where, finding.level) == (where, level)]


def only(findings, where, level):
    (finding,) = of(findings, where, level)
    return finding


def faults(findings):
    return [finding for finding in findings if finding.level is not Level.OK]


def test_a_sound_bench_has_no_fault_and_its_figures_are_told(bench_on, host):
    with peer() as device:
        findings = examine(bench_on(device.path), host=host, polls=5)
    assert faults(findings) == []
    assert "Keller 30X, absolute at unit 1" in only(findings, "gauge", Level.OK).what
    assert "asked 5 /s, bears" in only(findings, "gauge", Level.OK).what
    assert "% of the line's time (gauge" in only(findings, "line bus", Level.OK).what


def test_nothing_is_written_into_the_regulator(bench_on, host):
    with peer() as device:
        examine(bench_on(device.path), host=host, polls=2)
        assert device.writes == []


def test_a_device_that_is_slower_than_asked_is_a_fault_with_the_period_that_would_do(bench_on, host):
    with peer(delay_s=0.05) as device:
        findings = examine(bench_on(device.path, period_s=0.02), host=host, polls=5)
    fault = only(findings, "gauge", Level.FAULT)
    assert "slower than asked" in fault.what
    assert "set period_s to 0.0" in fault.fix
    assert "raise period_s" in only(findings, "line bus", Level.FAULT).fix


def test_a_line_on_which_one_lost_answer_would_end_a_run_is_told(bench_on, host):
    words = "one lost answer leaves 1.4 s without a reading, and speed_stale_s (1 s) ends a run then"
    with peer() as device:
        told = examine(bench_on(device.path, timeout_s=0.6), host=host, polls=2)
        short = examine(bench_on(device.path, timeout_s=0.15), host=host, polls=2)
    assert only(told, "gauge", Level.WARNING).what == words
    assert of(told, "regulator", Level.WARNING) == of(short, "gauge", Level.WARNING) == []


def test_replies_close_to_the_timeout_are_a_warning(bench_on, host):
    with peer(delay_s=0.12) as device:
        findings = examine(bench_on(device.path, timeout_s=0.19), host=host, polls=4)
    assert "come close to timeout_s (190 ms)" in of(findings, "gauge", Level.WARNING)[0].what


def test_a_port_that_is_not_there_is_told_with_those_that_are(bench_on, host):
    by_id = host.dev / "serial" / "by-id"
    by_id.mkdir(parents=True)
    (host.dev / "ttyUSB0").touch()
    (host.dev / "ttyACM3").touch()
    (by_id / "usb-FTDI_RS485-if00").symlink_to(host.dev / "ttyUSB0")
    findings = examine(bench_on("/dev/ttyNOT_THERE"), host=host)
    fault = only(findings, "line bus", Level.FAULT)
    assert "/dev/ttyNOT_THERE is not there" in fault.what
    assert f"{by_id}/usb-FTDI_RS485-if00" in fault.what
    assert "ttyACM3" in fault.what
    assert "ttyUSB0" not in fault.what  # it is told by the name that survives a replug


def test_where_no_port_is_at_all_it_says_so(bench_on, host):
    assert (
        "no USB serial port is there at all"
        in only(examine(bench_on("/dev/ttyNOT_THERE"), host=host), "line bus", Level.FAULT).what
    )


def as_nobody(work):
    """Run a function as a user without rights, in a process of its own, and return what it returns."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            os.write(write, pickle.dumps(work()))
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return pickle.loads(said)  # noqa: S301 (our own child's)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become nobody")
def test_a_port_without_permission_is_told_with_the_group_that_would_do(bench_on):
    with peer() as device:
        os.chmod(device.path, 0o660)  # noqa: PTH101
        os.chown(device.path, 0, 20)  # 20 is dialout on Debian
        bench = bench_on(device.path)
        findings = as_nobody(lambda: examine(bench))
    fault = only(findings, "line bus", Level.FAULT)
    assert f"no permission to open {device.path}" in fault.what
    assert fault.fix.startswith("sudo usermod -aG ")
    assert "log in again" in fault.fix


@pytest.mark.parametrize("locks", [False, True])
def test_a_second_program_on_the_port_is_told_by_name_and_number(bench_on, locks):
    hold = "import fcntl, sys; port = open(sys.argv[1], 'rb', buffering=0)\n"
    hold += "fcntl.flock(port, fcntl.LOCK_EX)\n" if locks else ""
    hold += "print('held', flush=True); sys.stdin.read()"
    with peer() as device:
        other = subprocess.Popen(
            [sys.executable, "-c", hold, device.path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        try:
            assert other.stdout.readline() == "held\n"
            findings = examine(bench_on(device.path), polls=2)
        finally:
            other.communicate()
    fault = only(findings, "line bus", Level.FAULT)
    assert f"(process {other.pid})" in fault.what
    assert "two programs on a port" in fault.what


def test_the_doctor_does_not_accuse_itself(bench_on):
    with peer() as device, open(device.path, "rb", buffering=0):  # noqa: PTH123
        assert of(examine(bench_on(device.path), polls=2), "line bus", Level.FAULT) == []


def test_a_port_that_is_locked_by_a_program_we_may_not_see_is_still_told(bench_on, host):
    with peer() as device, open(device.path, "rb", buffering=0) as other:  # noqa: PTH123
        fcntl.flock(other, fcntl.LOCK_EX)
        findings = examine(bench_on(device.path), host=host)
    assert "another program has it open" in only(findings, "line bus", Level.FAULT).what


def test_an_ftdi_latency_timer_of_16_ms_is_told_with_the_rule(bench_on, host):
    with peer() as device:
        folder = host.sys / "class" / "tty" / Path(device.path).name / "device"
        folder.mkdir(parents=True)
        (folder / "latency_timer").write_text("16\n")
        slow = examine(bench_on(device.path), host=host, polls=2)
        (folder / "latency_timer").write_text("1\n")
        fast = examine(bench_on(device.path), host=host, polls=2)
    warning = only(slow, "line bus", Level.WARNING)
    assert "16 ms" in warning.what
    assert 'ATTR{latency_timer}="1"' in warning.fix
    assert of(fast, "line bus", Level.WARNING) == []


@pytest.mark.parametrize(
    ("name", "fix"), [("brltty", "sudo apt remove brltty"), ("ModemManager", "systemctl disable --now ModemManager")]
)
def test_a_program_that_takes_ports_is_told_with_what_to_do(bench_on, host, name, fix):
    (host.proc / "4711").mkdir()
    (host.proc / "4711" / "comm").write_text(f"{name}\n")
    with peer() as device:
        findings = examine(bench_on(device.path), host=host, polls=2)
    warning = only(findings, "host", Level.WARNING)
    assert f"{name} runs (process 4711)" in warning.what
    assert fix in warning.fix


@pytest.mark.parametrize("garbage", [b"", pytest.param(b"\xf8\x00\xe0\xfe\x1c", marks=pytest.mark.long)])
def test_a_wrong_baud_rate_is_found_by_trying_the_usual_ones(bench_on, host, garbage):
    with peer(baud=9600, byte_s=0.001, garbage=garbage) as device:
        findings = examine(bench_on(device.path, baud=38400), host=host, polls=2)
    fault = only(findings, "gauge", Level.FAULT)
    assert "It answers at 9600 baud" in fault.what
    assert ("bytes come, but no answer" if garbage else "nobody answers") in fault.what
    assert fault.fix == "write baud = 9600 into [lines.bus]"


def test_a_device_that_is_off_is_told_with_what_was_tried(bench_on, host):
    with ModbusPeer({}) as device:
        findings = examine(bench_on(device.path, timeout_s=0.05), host=host, polls=2)
    fault = only(findings, "gauge", Level.FAULT)
    assert "no other of the usual settings" in fault.what
    assert "check power" in fault.fix


def test_where_another_device_answers_the_baud_rate_is_not_doubted(bench_on, host):
    with ModbusPeer({2: dict(ADAM)}) as device:
        findings = examine(bench_on(device.path), host=host, polls=2)
    assert "baud" not in only(findings, "gauge", Level.FAULT).what
    assert of(findings, "regulator", Level.OK)


def test_a_device_that_calls_itself_otherwise_is_told(bench_on, host):
    with ModbusPeer({1: dict(KELLER), 2: ADAM | {210: 0x4017}}) as device:
        findings = examine(bench_on(device.path), host=host, polls=2)
    fault = only(findings, "regulator", Level.FAULT)
    assert "another device answers" in fault.what
    assert "4017" in fault.what


def test_a_device_at_another_unit_is_found_when_a_scan_is_asked_for(bench_on, host):
    with ModbusPeer({5: dict(KELLER), 2: dict(ADAM)}) as device:
        plain = examine(bench_on(device.path), host=host, polls=2)
        scanned = examine(bench_on(device.path), host=host, polls=2, scan_units=range(1, 7))
    assert "a scan of a few addresses" in only(plain, "gauge", Level.FAULT).fix
    fault = only(scanned, "gauge", Level.FAULT)
    assert "Not unit 1" in fault.what
    assert fault.fix == "write unit_id = 5 into [devices.gauge]"


def test_a_device_that_lacks_the_registers_refuses_and_is_told(bench_on, host):
    with ModbusPeer({1: {0: 0}, 2: dict(ADAM)}) as device:
        findings = examine(bench_on(device.path), host=host, polls=2)
    assert "answers, but refuses" in only(findings, "gauge", Level.FAULT).what


def test_a_device_whose_every_poll_is_a_fault_is_told(bench_on, host):
    nan = KELLER | {2: 0x7FC0, 6: 0x7FC0}
    with ModbusPeer({1: nan, 2: dict(ADAM)}) as device:
        findings = examine(bench_on(device.path), host=host, polls=4)
    assert "no poll gave a reading: exception" in only(findings, "gauge", Level.FAULT).what


def test_an_address_that_takes_no_connection_is_told(tmp_path, host):
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    text = BENCH.format(port="-", baud=9600, timeout_s=0.2, gauge=1, period_s=0.2)
    text = text.replace('kind = "serial"\nport = "-"', f'kind = "tcp"\nhost = "127.0.0.1"\ntcp_port = {free}')
    (tmp_path / "bench.toml").write_text(text)
    findings = examine(bench_at(tmp_path / "bench.toml"), host=host)
    assert f"127.0.0.1:{free} does not take a connection" in only(findings, "line bus", Level.FAULT).what


@pytest.mark.parametrize("hangs_up", [False, True])
def test_a_web_server_at_the_port_of_an_instrument_is_called_one(tmp_path, host, hangs_up):
    text = BENCH.format(port="-", baud=19200, timeout_s=0.5, gauge=1, period_s=0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        at = server.getsockname()[1]
        text = text.replace('kind = "serial"\nport = "-"', f'kind = "tcp"\nhost = "127.0.0.1"\ntcp_port = {at}')
        (tmp_path / "bench.toml").write_text(text)
        kept = []

        def serve():
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with contextlib.suppress(OSError):
                    connection.recv(100)
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n<html></html>")
                if hangs_up:
                    connection.close()
                kept.append(connection)

        threading.Thread(target=serve, daemon=True).start()
        found = [one for one in examine(bench_at(tmp_path / "bench.toml"), host=host) if one.level is Level.FAULT]
        server.shutdown(socket.SHUT_RDWR)
    assert found
    for one in found:
        assert f"127.0.0.1, port {at}, answers “HTTP/1.1 400 Bad Request”: it serves web pages" in one.what
        assert "tcp_port" in one.fix
        assert "swapped" not in one.fix


@pytest.fixture
def converter():
    """A serial bus behind a converter that hands on bytes as they come: its TCP port."""
    with peer() as device, socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with connection:
                    while frame := connection.recv(256):
                        connection.sendall(device._answer(frame))

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize("framing", ["", 'framing = "rtu"\n'])
def test_a_serial_bus_behind_a_converter_wants_the_other_framing(tmp_path, host, converter, framing):
    text = BENCH.format(port="-", baud=9600, timeout_s=0.2, gauge=1, period_s=0.2)
    tcp = f'kind = "tcp"\nhost = "127.0.0.1"\ntcp_port = {converter}\n{framing}'
    (tmp_path / "bench.toml").write_text(text.replace('kind = "serial"\nport = "-"\n', tcp))
    findings = examine(bench_at(tmp_path / "bench.toml"), host=host, polls=2)
    if framing:
        assert of(findings, "gauge", Level.OK)
    else:
        fault = only(findings, "gauge", Level.FAULT)
        assert "It answers with framing rtu" in fault.what
        assert fault.fix == 'write framing = "rtu" into [lines.bus]'


def test_a_person_is_not_examined(host):
    findings = examine(read_bench("manual"), host=host)
    assert [finding.level for finding in findings] == [Level.OK]
    assert findings[0].what.startswith("a person reads its instruments: ")


def test_a_virtual_bench_that_was_not_started_is_told(host):
    findings = examine(read_bench("virtual"), host=host)
    assert {finding.level for finding in findings} == {Level.FAULT}
    assert all("no virtual bench was started" in finding.what for finding in findings)


def test_a_line_that_falls_dead_during_the_examination_is_told(bench_on, host):
    class Dying(ModbusPeer):
        def _answer(self, frame):
            if self.answers == 3:
                os.close(self._master)
                self._ending.set()
                return b""
            return super()._answer(frame)

        def close(self):
            self._thread.join()
            os.close(self._slave)

    with Dying({1: dict(KELLER), 2: dict(ADAM)}) as device:
        findings = examine(bench_on(device.path), host=host, polls=5)
    assert "unplugged" in only(findings, "line bus", Level.FAULT).what


def test_the_table_shows_every_finding_and_no_control_character_of_a_device():
    console = Console(width=200, record=True, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115
    findings = [Finding(Level.OK, "gauge", "fine"), Finding(Level.FAULT, "tach", "\x1b[2J[bold]odd[/bold]", "look")]
    console.print(table(findings))
    shown = console.export_text()
    assert "fine" in shown
    assert "[bold]odd[/bold]" in shown
    assert "\x1b" not in shown


TACH = """
[lines.words]
kind = "serial"
port = "{port}"
baud = 9600
timeout_s = 0.05
slowest_reply_s = 0.05
[devices.tach]
instrument = "monarch_act3x"
line = "words"
"""


class SevenBits(Peer):
    """A tachometer of 7 data bits and even parity: its parity reaches a port that is set to 8 bits as the eighth.

    A pseudo-terminal has always 8 bits and no parity, so `ports` notes what the port was to be set to.
    """

    def __init__(self):
        self.table = None
        super().__init__(self.answer)

    def answer(self, request):
        answer = b"+0600.00\r\n"
        if (self.table.data_bits, self.table.parity) == (7, "E"):
            return [(0.02, answer)]
        return [(0.02, bytes(byte | 0x80 * (byte.bit_count() % 2) for byte in answer))]

    def ports(self, name, table, clock):
        self.table = table if name == "words" else self.table
        return port_of(name, table, clock)


def examined_words(bench_on, tmp_path, host, device, ports=None):
    bench_on("/dev/null")
    path = tmp_path / "bench.toml"
    path.write_text(path.read_text().replace("[roles]", TACH.format(port=device.path) + "[roles]"))
    try:
        return only(examine(bench_at(path), ports, host=host, polls=2), "tach", Level.FAULT)
    finally:
        device.end()


def test_a_tachometer_of_seven_bits_and_even_parity_is_found(bench_on, tmp_path, host):
    device = SevenBits()
    fault = examined_words(bench_on, tmp_path, host, device, device.ports)
    assert "It answers at 9600 baud, parity E, 7 data bits" in fault.what
    assert fault.fix == 'write data_bits = 7 and parity = "E" into [lines.words]'


def test_a_usb_device_that_answers_sooner_than_a_baud_rate_allows_is_told_with_the_key(
    bench_on, tmp_path, host, monkeypatch
):
    monkeypatch.setattr("tests.rig.test_doctor.TACH", TACH.replace("_s = 0.05", "_s = 0.5"))  # a busy machine is late
    fault = examined_words(bench_on, tmp_path, host, Peer(lambda request: b"+0600.00\r\n"))
    assert "write paced = false at this line in the bench file. It answers sooner than its bytes" in fault.what
    assert fault.fix == "write paced = false into [lines.words]"


def test_a_device_that_answers_later_than_it_is_waited_for_is_told_with_the_time(bench_on, tmp_path, host, monkeypatch):
    late = Peer(lambda request: [(0.15, b"+0600.00\r\n")])
    monkeypatch.setattr("tests.rig.test_doctor.TACH", TACH.replace("slowest_reply_s = 0.05", "slowest_reply_s = 0.3"))
    fault = examined_words(bench_on, tmp_path, host, late)
    assert "It answers when it is given 3 s" in fault.what
    assert fault.fix == "write timeout_s = 3 and slowest_reply_s = 3 into [lines.words]"


def test_a_line_that_ends_otherwise_is_told_with_the_terminator_to_write(bench_on, tmp_path, host):
    fault = examined_words(bench_on, tmp_path, host, Peer(lambda request: [(0.02, b"+0600.00\n\r")]))
    assert r'if it is a whole answer, write terminator = "\n\r" in the instrument file' in fault.what


def test_of_text_that_is_no_answer_what_came_is_shown(bench_on, tmp_path, host):
    fault = examined_words(bench_on, tmp_path, host, Peer(lambda request: b"\x1b[0m+0600,00\n"))
    assert r"What came: '\x1b[0m+0600,00\n" in fault.what
    assert r"compare it with pattern and terminator ('\r\n') in the instrument file" in fault.fix


def test_a_tachometer_that_writes_decimal_commas_is_told_with_the_key_that_takes_them(bench_on, tmp_path, host):
    fault = examined_words(bench_on, tmp_path, host, Peer(lambda request: [(0.02, b"+0600,00\r\n")]))
    assert fault.what.startswith("answers, but '+0600,00' has a comma where the file has a decimal point")
    assert fault.fix == 'write decimal = "," in the instrument file, and the comma in its pattern'


class Refusing(ModbusPeer):
    """Refuses every question with an exception."""

    def __init__(self, code):
        self.code = code
        super().__init__({})

    def _answer(self, frame):
        return self._framed(bytes([frame[0], frame[1] | 0x80, self.code]))


@pytest.mark.parametrize(
    ("code", "words"),
    [(1, "registers: input or holding"), (2, "a manual's 40001 or 30001 is 0"), (3, "most_registers")],
)
def test_what_to_look_at_in_the_file_depends_on_the_exception(bench_on, host, code, words):
    with Refusing(code) as device:
        assert words in only(examine(bench_on(device.path), host=host, polls=2), "gauge", Level.FAULT).fix


@pytest.mark.parametrize("unit", [0, 255])
def test_a_silent_unit_that_no_serial_bus_could_have_is_told_as_silent(tmp_path, host, unit):
    with socket.create_server(("127.0.0.1", 0)) as server:
        text = BENCH.format(port="-", baud=9600, timeout_s=0.05, gauge=unit, period_s=0.2)
        tcp = f'kind = "tcp"\nhost = "127.0.0.1"\ntcp_port = {server.getsockname()[1]}\n'
        (tmp_path / "bench.toml").write_text(text.replace('kind = "serial"\nport = "-"\n', tcp))
        findings = examine(bench_at(tmp_path / "bench.toml"), host=host, polls=2)
    assert "nobody answers" in only(findings, "gauge", Level.FAULT).what


@pytest.mark.parametrize(("kind", "words", "raw"), [("u16", {0: 0xFFFF}, 65535), ("i32", {0: 0x8000, 1: 0}, -(2**31))])
def test_a_number_that_often_means_no_value_is_told_with_the_key(bench_on, tmp_path, host, kind, words, raw):
    (tmp_path / "meter.toml").write_text(
        'format = "instrument/1"\nfamily = "modbus"\ntitle = "t"\nsource = "s"\ntrust = "documented"\n'
        f'[channels.flow_l_min]\nunit = "L/min"\naddress = 0\ntype = "{kind}"\n'
    )
    path = tmp_path / "bench.toml"
    with ModbusPeer({1: dict(KELLER), 2: dict(ADAM), 3: words}) as device:
        bench_on(device.path)
        meter = '[devices.meter]\ninstrument = "meter"\nline = "bus"\nunit_id = 3\n'
        path.write_text(path.read_text().replace("[roles]", meter + "[roles]"))
        warning = only(examine(bench_at(path), host=host, polls=2), "meter", Level.WARNING)
    assert f"flow_l_min came as {raw}, which many devices send where they have no value" in warning.what
    assert f"write invalid = [{raw}] at channels.flow_l_min" in warning.fix
