"""Who may ask the console for what: requests that another program, another site or a stranger could make."""

import http.client
import json
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tests.console_lab import consoles, short_bench
from tests.synthetic_runs import write_sweep


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A console over one sealed run with a report, and a secret beside the logs folder."""
    folder = tmp_path_factory.mktemp("console")
    logs = folder / "logs"
    run = write_sweep(logs)
    (folder / "secret.html").write_text("secret")
    reports = logs / "reports" / run.name / "diagnosis"
    reports.mkdir(parents=True)
    (reports / "report.html").write_text("<h1>report</h1><script>1</script>")
    (reports / "out.html").symlink_to(folder / "secret.html")
    (logs / "linked").symlink_to(run)
    with consoles() as start:
        yield start(short_bench(folder), logs), logs, run


def test_the_page_and_its_files_come_with_a_policy_that_forbids_everything_else(place):
    console, _, _ = place
    for path in ("/", "/static/console.js", "/static/charts.js", "/static/console.css"):
        status, text, headers = console.ask(path)
        assert (status, bool(text)) == (200, True)
        assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'; style-src 'self'")
        assert "unsafe" not in headers["content-security-policy"]
        assert "http://" not in text.replace("http://www.w3.org", "")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "192.168.1.5:8642"])
def test_another_hosts_name_is_refused(place, host):
    console, _, _ = place
    assert console.ask("/", host=host)[0] == 421
    assert console.ask("/api/stop", {}, host=host, x_spinbench_token=console.token)[0] == 421


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://{place}"])
def test_another_sites_page_is_refused_even_with_the_token(place, origin):
    console, _, _ = place
    origin = origin.format(place=console.place.removeprefix("http://"))
    assert console.ask("/api/stop", {}, origin=origin, x_spinbench_token=console.token)[0] == 403
    assert console.ask("/api/runs", origin=origin)[0] == 403


def test_a_change_needs_origin_token_json_and_control(place):
    console, _, run = place
    stop_token = console.parts()["console"]["stop_token"]
    control = {"window": "w1", "name": "window one"}
    assert console.ask("/api/control", control)[0] == 403
    assert console.ask("/api/control", control, x_spinbench_token="x" * 40)[0] == 403
    assert console.ask("/api/control", control, x_spinbench_token=stop_token)[0] == 403
    assert console.ask("/api/control", control, x_spinbench_token=console.token, sec_fetch_site="cross-site")[0] == 403
    assert console.ask("/api/control", control, x_spinbench_token=console.token, content_type="text/plain")[0] == 415
    connection = http.client.HTTPConnection("127.0.0.1", console.port, timeout=60.0)
    headers = {"content-type": "application/json", "x-spinbench-token": console.token}
    connection.request("POST", "/api/control", json.dumps(control), headers)  # without Origin
    assert connection.getresponse().status == 403
    connection.close()
    seen = {"window": "w1", "run": run.name, "n": 0}
    assert console.ask("/api/acknowledge", seen, x_spinbench_token=console.token)[0] == 409  # nobody controls yet
    assert console.ask("/api/control", control, x_spinbench_token=console.token)[0] == 200
    assert console.ask("/api/acknowledge", seen, x_spinbench_token=console.token)[0] == 200
    assert console.ask("/api/acknowledge", seen | {"window": "w2"}, x_spinbench_token=console.token)[0] == 409
    assert (
        console.ask("/api/start", {"window": "w1", "answers": {"logs": "/"}}, x_spinbench_token=console.token)[0] == 400
    )
    assert console.ask("/api/control", control | {"name": "x" * 30_000}, x_spinbench_token=console.token)[0] == 413


def test_stop_without_a_run_is_not_delivered_and_says_what_to_do_by_hand(place):
    console, _, _ = place
    stop_token = console.parts()["console"]["stop_token"]
    assert console.ask("/api/stop", {})[0] == 403
    status, text, _ = console.ask("/api/stop", {"name": "a test"}, x_spinbench_token=stop_token)
    told = json.loads(text)
    assert (status, told["word"]) == (200, "NOT DELIVERED")
    assert "close the supply by hand" in told["text"]
    assert console.parts()["console"]["stop"]["word"] == "NOT DELIVERED"  # every window is shown it


def test_a_report_of_a_run_is_shown_without_its_scripts(place):
    console, _, run = place
    (row,) = json.loads(console.ask("/api/runs")[1])
    assert row["name"] == run.name
    path = f"reports/{run.name}/diagnosis/report.html"
    assert path in row["reports"]
    status, text, headers = console.ask(f"/files/{path}")
    assert (status, text[:4]) == (200, "<h1>")
    assert headers["content-security-policy"].startswith("sandbox allow-same-origin; default-src 'none'")
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    [
        "/files/../secret.html",
        "/files/%2e%2e/secret.html",
        "/files/..%2fsecret.html",
        "/files/{run}/../../secret.html",
        "/files/{run}/%2e%2e%2f%2e%2e%2fsecret.html",
        "/files//etc/passwd",
        "/files/%2fetc%2fpasswd",
        "/files/reports/{run}/diagnosis/out.html",
        "/files/.console.json",
        "/files/{run}/.lock",
        "/files/{run}",
        "/files/{run}/wire.jsonl",
        "/files/reports/{run}/diagnosis/report.html%00",
        "/static/..%2f__init__.py",
        "/static/__init__.py",
        "/events?run=..",
        "/events?run=linked",
        "/events?run=../logs/{run}",
        "/api/runs/..",
        "/api/runs/linked",
        "/api/runs/%2e%2e%2fx",
    ],
)
def test_a_path_that_leads_out_of_the_logs_folder_is_refused(place, path):
    console, _, run = place
    status, text, _ = console.ask(path.format(run=run.name))
    assert status in (404, 422)
    assert "secret" not in text
    assert "root:" not in text


def test_it_listens_on_the_loopback_alone_and_keeps_its_token_for_its_user(place):
    console, logs, _ = place
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    (address,) = {row[1] for row in listening if row[3] == "0A" and int(row[1].split(":")[1], 16) == console.port}
    assert address.startswith("0100007F:")
    kept = logs / ".console.json"
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    assert console.token in kept.read_text()


def test_a_port_that_is_taken_is_told_in_words(place):
    console, logs, _ = place
    command = [
        sys.executable,
        "-m",
        "spinbench",
        "console",
        "virtual",
        "--logs",
        str(logs),
        "--port",
        str(console.port),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"spinbench: port {console.port} of this machine cannot be had")
    assert "--port" in done.stderr


@pytest.fixture(scope="module")
def open_console(tmp_path_factory):
    """A console that serves other machines, over one sealed run."""
    folder = tmp_path_factory.mktemp("open")
    run = write_sweep(folder / "logs")
    report = folder / "logs" / "reports" / run.name / "report.html"
    report.parent.mkdir(parents=True)
    report.write_text("<h1>report</h1>")
    with consoles() as start:
        console = start(short_bench(folder), folder / "logs", 0, "--listen", "0.0.0.0")  # noqa: S104 - what is tested
        console.address = console.address.replace(socket.gethostname().lower(), "127.0.0.1")
        console.place = f"http://127.0.0.1:{console.port}"
        yield console, f"/files/reports/{run.name}/report.html"


def test_a_console_that_serves_others_shows_nothing_without_its_token(open_console):
    console, report = open_console
    for path in ("/", "/static/console.js"):
        assert console.ask(path)[0] == 200
    for path in ("/events", "/api/runs", report):
        status, text, _ = console.ask(path)
        assert (status, "open the address that the console printed" in text) == (403, True)
        assert console.ask(path, cookie=f"spinbench_{console.port}={console.token}")[0] == 403
    assert console.ask("/api/watch", {}, x_spinbench_token="x" * 40)[0] == 403
    assert console.ask("/api/stop", {})[0] == 403


def test_with_the_token_a_browser_may_watch_and_no_script_reads_what_lets_it(open_console):
    console, report = open_console
    status, _, headers = console.ask("/api/watch", {}, x_spinbench_token=console.token)
    assert status == 200
    cookie, *rules = headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=strict"} <= set(rules)
    assert console.token not in cookie
    for path in ("/api/runs", report):
        assert console.ask(path, cookie=cookie)[0] == 200
    control = {"window": "w1", "name": "window one"}
    assert console.ask("/api/control", control, cookie=cookie)[0] == 403  # watching is not changing


@pytest.mark.parametrize(("host", "status"), [("evil.example", 421), ("{own}", 200), ("192.0.2.7", 421)])
def test_a_console_that_serves_others_answers_to_this_machines_names(open_console, host, status):
    console, _ = open_console
    assert console.ask("/", host=host.format(own=f"{socket.gethostname()}:{console.port}"))[0] == status


@pytest.mark.parametrize(("listen", "words"), [("192.0.2.7", "no such address"), ("no such name", "--listen")])
def test_an_address_of_another_machine_is_refused_in_a_line(spinbench_here, tmp_path, listen, words):
    done = spinbench_here("console", "virtual", "--logs", tmp_path / "logs", "--listen", listen, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr and done.stderr.count("\n") == 1
