import ctypes
import gc
import os
import resource
import sys
import time

import pytest

from deploy.loop import realtime
from deploy.loop.realtime import Granted, MonotonicClock, next_deadline, prepare, prepared

MS = 1_000_000


def test_waits_end_after_the_deadline_and_on_the_monotonic_clock(monkeypatch):
    def forbidden():
        raise AssertionError("the wall clock was read")

    monkeypatch.setattr(time, "time", forbidden)
    monkeypatch.setattr(time, "time_ns", forbidden)
    clock = MonotonicClock()
    for wait in (0, 50_000, 2 * MS):
        deadline = clock.now() + wait
        clock.wait_until(deadline)
        assert clock.now() >= deadline


def test_a_deadline_that_has_passed_is_no_wait(monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda _: pytest.fail("it slept"))
    clock = MonotonicClock()
    clock.wait_until(clock.now() - 10 * MS)


def test_the_end_of_a_wait_is_not_slept(monkeypatch):
    slept = []
    monkeypatch.setattr(time, "sleep", slept.append)
    clock = MonotonicClock()
    clock.wait_until(clock.now() + 2 * MS)
    assert len(slept) == 1
    assert 0.0 < slept[0] <= 0.002 - 1e-9 * realtime.SPIN_NS


@pytest.mark.parametrize(
    ("now", "following", "missed"),
    [
        (100, 2000, 0),
        (1999, 2000, 0),
        (2000, 3000, 1),
        (2001, 3000, 1),
        (4999, 5000, 3),
        (101_000, 102_000, 100),
    ],
)
def test_deadlines_stay_on_their_grid_and_passed_ones_are_left_out(now, following, missed):
    assert next_deadline(1000, now, 1000) == (following, missed)


def test_everything_is_given_back():
    def state():
        scheduler = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.sched_getaffinity(0)
        return gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval(), scheduler

    before = state()
    cpu = min(os.sched_getaffinity(0))
    with prepared(cpu=cpu) as granted:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert os.sched_getaffinity(0) == {cpu}
        assert len(granted) == 6
        priority = next(each for each in granted if each.sentence.startswith("priority"))
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == priority.ok
    assert state() == before


def test_prepare_says_one_sentence_each_and_keeps_it(monkeypatch):
    asked = []
    monkeypatch.setattr(realtime, "_ask", lambda undo, *rest: asked.append(rest) or [Granted(True, "a: b")])
    assert prepare() == ["a: b"]
    assert asked == [(realtime.PRIORITY, None)]
    assert realtime.PRIORITY < realtime.WATCHDOG_PRIORITY < 50


@pytest.mark.parametrize("cpu", [2**31 - 1, 10**20])
def test_a_processor_that_no_system_has_is_refused_in_words(cpu):
    before = os.sched_getaffinity(0)
    with prepared(cpu=cpu) as granted:
        (found,) = (each for each in granted if each.sentence.startswith("processor"))
        assert not found.ok
        assert f"{cpu} refused" in found.sentence
    assert os.sched_getaffinity(0) == before


def test_refusals_name_the_permission_and_the_file(monkeypatch):
    def refused(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "sched_setaffinity", refused)
    monkeypatch.setattr(realtime, "_libc", lambda *_: "Cannot allocate memory")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with prepared(cpu=0) as granted:
        text = {each.sentence.partition(":")[0]: each for each in granted}
    assert not any(text[name].ok for name in ("priority", "processor", "memory", "threads", "linear algebra"))
    assert "rtprio" in text["priority"].sentence
    assert realtime.LIMITS_FILE in text["priority"].sentence
    assert "memlock unlimited" in text["memory"].sentence
    assert "Cannot allocate memory" in text["memory"].sentence
    assert "OMP_NUM_THREADS=1" in text["linear algebra"].sentence
    assert text["garbage collector"].ok


@pytest.mark.parametrize(
    ("limit", "user", "later"),
    [(resource.RLIM_INFINITY, 1000, True), (1 << 26, 0, True), (1 << 26, 1000, False), (0, 1000, False)],
)
def test_later_pages_are_locked_too_where_they_may_be_and_nowhere_else(monkeypatch, limit, user, later):
    """Locked ahead under a limit, memory that is asked for beyond it would be refused."""
    called = []
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(realtime, "_libc", lambda *call: called.append(call) or "")
    granted = realtime.lock_memory(lambda *_: None)
    assert called == [("mlockall", 3 if later else 1)]
    assert ("later pages are not" in granted.sentence) != later


def test_one_thread_of_linear_algebra_is_noticed(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert realtime.one_thread().ok


def test_a_system_without_these_calls_is_told_so(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    assert realtime._libc("mlockall", 1) == "no mlockall here"
    assert not realtime.lock_memory(lambda *_: None).ok
