"""The first signal asks, the second ends the process within its grace, whatever hangs."""

import signal
import subprocess
import sys
import time

import pytest

from deploy.loop.signals import GRACE, EndingSignals

HANGS = {
    "sleeps": "while True:\n    time.sleep(10.0)",
    "spins": "while True:\n    pass",
    "waits for a lock": "lock = threading.Lock(); lock.acquire(); lock.acquire()",
    "swallows": "while True:\n    try:\n        time.sleep(10.0)\n    except BaseException:\n        pass",
}
PROGRAM = """
import threading, time
from deploy.loop.signals import EndingSignals
with EndingSignals() as signals:
    signals.begin()
    print("up", flush=True)
"""


def started(body):
    source = PROGRAM + "".join(f"    {line}\n" for line in body.splitlines())
    child = subprocess.Popen([sys.executable, "-c", source], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "up\n"
    time.sleep(0.2)
    return child


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("hang", HANGS)
def test_the_second_signal_ends_a_process_that_hangs(hang, second):
    child = started(HANGS[hang])
    try:
        child.send_signal(signal.SIGINT)
        time.sleep(0.2)
        assert child.poll() is None  # the first one only asks
        at = time.monotonic()
        child.send_signal(second)
        assert child.wait(GRACE + 5.0) == -signal.SIGALRM
        assert time.monotonic() - at < GRACE + 1.0
    finally:
        child.kill()
        child.communicate()


def test_before_the_loop_the_first_signal_ends_the_program():
    with pytest.raises(KeyboardInterrupt), EndingSignals():
        signal.raise_signal(signal.SIGTERM)


def test_in_the_loop_signals_are_counted_and_afterwards_all_is_as_before():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with EndingSignals() as signals:
        signals.begin()
        signal.raise_signal(signal.SIGINT)
        assert signals.count == 1
        signal.raise_signal(signal.SIGTERM)
        assert signals.count == 2
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.fixture
def before_hangups(request):
    """What SIGHUP does before the run, whatever it does to these tests: under nohup they inherit that it is ignored."""
    inherited = signal.signal(signal.SIGHUP, request.param)
    yield
    signal.signal(signal.SIGHUP, inherited)


@pytest.mark.parametrize("before_hangups", [signal.SIG_DFL], indirect=True)
@pytest.mark.usefixtures("before_hangups")
def test_a_terminal_that_is_closed_asks_and_lets_nothing_go_however_often_it_is_told():
    with EndingSignals() as signals:
        signals.begin()
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert signals.count == 1
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGHUP)
        assert signals.count == 2
    with pytest.raises(KeyboardInterrupt), EndingSignals():
        signal.raise_signal(signal.SIGHUP)


@pytest.mark.parametrize("before_hangups", [signal.SIG_IGN], indirect=True)
@pytest.mark.usefixtures("before_hangups")
def test_under_nohup_a_closed_terminal_is_none_of_its_business():
    with EndingSignals() as signals:
        signals.begin()
        signal.raise_signal(signal.SIGHUP)
        assert signals.count == 0
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


ASKED = "while not signals.count:\n    time.sleep(0.01)\nprint(signals.count, flush=True)"


@pytest.mark.parametrize("key", [signal.SIGTSTP, signal.SIGQUIT], ids=["Ctrl-Z", "Ctrl-\\"])
def test_a_key_that_would_stop_or_kill_the_loop_asks_for_its_end(key):
    """Stopped or killed, the arm would be let go where it is."""
    child = started(ASKED)
    try:
        child.send_signal(key)
        assert child.communicate(timeout=10.0)[0] == "1\n"
        assert child.returncode == 0
    finally:
        child.kill()
        child.communicate()


def test_a_loop_that_is_put_into_the_background_goes_on():
    """Reading or writing there would stop it."""
    before = signal.getsignal(signal.SIGTTIN), signal.getsignal(signal.SIGTTOU)
    with EndingSignals():
        assert signal.getsignal(signal.SIGTTIN) is signal.getsignal(signal.SIGTTOU) is signal.SIG_IGN
    assert (signal.getsignal(signal.SIGTTIN), signal.getsignal(signal.SIGTTOU)) == before
