"""The operator's stop, with real signals."""

import os
import signal
import threading

import pytest

from rig.interlock.stop import Stop


def send(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)


def test_nobody_has_asked_at_first():
    with Stop() as stop:
        assert (stop.asked, stop.by) == (0, "")


def test_ctrl_c_once_asks_for_an_orderly_stop():
    with Stop() as stop:
        send(signal.SIGINT)
        assert (stop.asked, stop.by) == (1, "Ctrl-C")


def test_ctrl_c_twice_asks_for_now():
    with Stop() as stop:
        send(signal.SIGINT, signal.SIGINT)
        assert stop.asked == 2


@pytest.mark.parametrize(("number", "who"), [(signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "the terminal was closed")])
def test_the_system_s_signals_ask_once_however_often_they_come(number, who):
    with Stop() as stop:
        send(number, number, number)
        assert (stop.asked, stop.by) == (1, who)


def test_ctrl_c_twice_after_a_term_is_now():
    with Stop() as stop:
        send(signal.SIGTERM, signal.SIGINT)
        assert (stop.asked, stop.by) == (1, "SIGTERM")
        send(signal.SIGINT)
        assert stop.asked == 2


def test_the_callback_hears_the_first_request_alone():
    heard = []
    with Stop(heard.append) as stop:
        send(signal.SIGTERM, signal.SIGINT)
        stop.ask("console")
    assert heard == ["SIGTERM"]


def test_the_handlers_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with pytest.raises(RuntimeError), Stop():
        assert signal.getsignal(signal.SIGTERM) != before[1]
        raise RuntimeError
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


def test_ctrl_c_raises_again_afterwards():
    with Stop():
        send(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        send(signal.SIGINT)


def test_requests_of_many_threads_are_all_counted_and_told_once():
    heard = []
    with Stop(heard.append) as stop:
        threads = [threading.Thread(target=lambda: [stop.ask() for _ in range(200)]) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert stop.asked == 1600
    assert len(heard) == 1


def test_outside_the_main_thread_no_handler_is_installed_and_asking_still_counts():
    before, counted = signal.getsignal(signal.SIGINT), []

    def work():
        with Stop() as stop:
            stop.ask("console")
            counted.append((stop.asked, signal.getsignal(signal.SIGINT) == before))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert counted == [(1, True)]
