"""Live data over MQTT, to a broker and a client of another make: read only, and what was missed comes anew."""

import asyncio
import json
import signal
import threading
import warnings

import pytest

from rig.runlog import RunWriter
from tests.console_lab import consoles, free_port, short_bench
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of
from tests.waiting import wait_for

pytestmark = pytest.mark.slow
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from amqtt.broker import Broker
    from amqtt.client import MQTTClient
QUIET = {"auto_reconnect": False}


class Served:
    """A broker in a thread, and what a client of it has heard: the last of each topic."""

    def __init__(self, port):
        self.heard, self.ready = {}, threading.Event()
        self._loop, self._over = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(port),), daemon=True)
        self._thread.start()

    async def _serve(self, port):
        listeners = {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}}
        plugins = {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}
        broker, client = Broker({"listeners": listeners, "plugins": plugins}), MQTTClient(config=QUIET)
        await broker.start()
        await client.connect(f"mqtt://127.0.0.1:{port}/")
        await client.subscribe([("spinbench/#", 1)])
        self.ready.set()
        while not self._over.is_set():
            try:
                message = await client.deliver_message(timeout_duration=0.2)
            except TimeoutError:
                continue
            self.heard[message.topic] = json.loads(message.data)
        await client.disconnect()
        await broker.shutdown()

    def close(self):
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(60.0)


@pytest.fixture
def serve():
    made = []

    def start(port):
        made.append(Served(port))
        return made[-1]

    yield start
    for one in made:
        one.close()


def test_readings_state_and_alarms_are_published_and_a_broker_that_was_away_gets_them_anew(tmp_path, serve):
    port, logs = free_port(), tmp_path / "logs"
    first = serve(port)
    wait_for(first.ready.is_set, "the broker")
    with RunWriter.create(logs, start_of()) as writer, consoles() as start:
        writer.event("state", 1, state="dwell", settled=True)
        writer.exchange(poll("gauge", {PRESSURE: 1.25}, 1_000_000_000))
        writer.exchange(poll("tach", {SPEED: None}, 1_000_000_000))
        writer.event("warning", 2, text="the gauge drifts")
        console = start(short_bench(tmp_path), logs, 0, "--mqtt", f"127.0.0.1:{port}")
        heard = wait_for(lambda: "spinbench/short/alarms" in first.heard and first.heard, "live data")
        state, pressure, speed = (
            wait_for(lambda part=part: heard.get(f"spinbench/short/{part}"), part)
            for part in ("state", "readings/pressure", "readings/speed")
        )
        assert (state["name"], state["state"], state["live"]) == (writer.folder.name, "dwell", True)
        assert (pressure["value"], pressure["unit"], pressure["time_s"]) == (1.25, "bar abs", 1.0)
        assert speed["value"] is None
        assert [one["text"] for one in heard["spinbench/short/alarms"]] == ["the gauge drifts"]
        first.close()
        writer.exchange(poll("gauge", {PRESSURE: 1.5}, 2_000_000_000))
        again = serve(port)
        told = wait_for(lambda: again.heard.get("spinbench/short/readings/pressure"), "the newest reading")
        assert told["value"] == 1.5
        wait_for(lambda: again.heard.get("spinbench/short/online") is True, "online")
        assert console.kill(signal.SIGINT) == 0
        wait_for(lambda: again.heard["spinbench/short/online"] is False, "the end of the console")


def test_a_broker_that_does_not_answer_is_told_in_a_line_before_anything_is_served(spinbench_here, tmp_path):
    words = ["console", "virtual", "--logs", tmp_path / "logs", "--port", "0", "--mqtt"]
    for place, told in ((f"127.0.0.1:{free_port()}", "no broker answers there"), (":1", "expected HOST or HOST:PORT")):
        done = spinbench_here(*words, place, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith("spinbench: --mqtt ")
        assert told in done.stderr
    assert not (tmp_path / "logs").exists()
