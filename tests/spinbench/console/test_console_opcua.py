"""Live data over OPC UA, to a client: read only, with the quality of each reading."""

import pytest
from asyncua import ua
from asyncua.sync import Client

from rig.runlog import RunWriter
from tests.console_lab import consoles, free_port, short_bench
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of
from tests.waiting import wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def served(tmp_path):
    """A run that goes on, and the address at which its console serves it."""
    place, logs = f"127.0.0.1:{free_port()}", tmp_path / "logs"
    with RunWriter.create(logs, start_of()) as writer, consoles() as start:
        writer.event("state", 1, state="dwell", settled=True)
        writer.exchange(poll("gauge", {PRESSURE: 1.25}, 1_000_000_000))
        writer.exchange(poll("tach", {SPEED: None}, 1_000_000_000))
        writer.event("warning", 2, text="the gauge drifts")
        start(short_bench(tmp_path), logs, 0, "--opcua", place)
        yield f"opc.tcp://{place}/spinbench", writer


def test_a_client_reads_state_alarms_and_readings_with_their_quality_and_cannot_write(served):
    address, writer = served
    with Client(address) as client:

        def read(name):
            return client.get_node(f"ns=2;s=short/{name}").read_data_value(raise_on_bad_status=False)

        wait_for(lambda: read("readings/speed/value").StatusCode.value != ua.StatusCodes.BadNodeIdUnknown, "readings")
        pressure, speed = read("readings/pressure/value"), read("readings/speed/value")
        assert (pressure.Value.Value, pressure.StatusCode.is_good()) == (1.25, True)
        assert speed.Value.Value is None and speed.StatusCode.is_bad()
        assert read("readings/pressure/unit").Value.Value == "bar abs"
        assert (read("state/name").Value.Value, read("state/state").Value.Value) == (writer.folder.name, "dwell")
        assert [text.split(".")[0] for text in read("alarms").Value.Value] == ["the gauge drifts"]
        writer.exchange(poll("gauge", {PRESSURE: 1.5}, 2_000_000_000))
        wait_for(lambda: read("readings/pressure/value").Value.Value == 1.5, "the newest reading")
    for user in ("", "admin"):
        client = Client(address)
        client.set_user(user)
        with client:
            with pytest.raises(ua.UaStatusCodeError):
                client.get_node("ns=2;s=short/readings/pressure/value").write_value(9.0)
            with pytest.raises(ua.UaStatusCodeError):
                client.nodes.objects.add_folder(2, "mine")
            with pytest.raises(ua.UaStatusCodeError):
                client.delete_nodes([client.get_node("ns=2;s=short/readings")])[1][0].check()


def test_an_address_that_cannot_be_served_is_told_in_a_line(spinbench_here, tmp_path):
    words = ["console", "virtual", "--logs", tmp_path / "logs", "--port", "0", "--opcua"]
    for place in ("192.0.2.7", ":1"):
        done = spinbench_here(*words, place, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith("spinbench: --opcua ") and done.stderr.count("\n") == 1
    assert not (tmp_path / "logs").exists()
