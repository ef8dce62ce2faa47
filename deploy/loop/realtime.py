"""Time and the machine: deadlines on the monotonic clock, and what the system grants of real time.

Nothing here is assumed. Each step tries, and says in a sentence what came of it and, where it was refused,
which permission is missing. All of it is given back by `prepared`.
"""

import ctypes
import gc
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

PRIORITY = 45
"""Priority of the controller: below the kernel's interrupt threads (50), which must be able to fetch its frames."""
WATCHDOG_PRIORITY = 48
"""Above the controller, so that a controller that never sleeps cannot keep its watchdog from acting."""
SPIN_NS = 100_000
"""The end of a wait that is not slept [ns]: a sleep ends that much late where real time is not granted."""
SWITCH_INTERVAL = 1e-4
"""After so long a thread that writes a log gives way to the loop [s]; Python's own 5 ms are five cycles."""
LIMITS_FILE = "/etc/security/limits.d/99-realtime.conf"
_MCL_CURRENT, _MCL_FUTURE, _PR_SET_TIMERSLACK = 1, 2, 29


class Granted(NamedTuple):
    """Outcome of one request to the system."""

    ok: bool
    sentence: str


class MonotonicClock:
    """The machine's monotonic clock; nothing that sets the wall clock can move it."""

    def now(self) -> int:
        """Time since some fixed moment [ns]."""
        return time.monotonic_ns()

    def wait_until(self, deadline: int) -> None:
        """Return at a moment of this clock [ns], or at once where it has passed.

        It sleeps until shortly before, then asks the clock again and again.
        """
        left = deadline - time.monotonic_ns()
        if left > SPIN_NS:
            time.sleep((left - SPIN_NS) * 1e-9)
        while time.monotonic_ns() < deadline:
            pass


def next_deadline(deadline: int, now: int, period: int) -> tuple[int, int]:
    """The deadline after this one, and how many were missed.

    Deadlines stay on their grid. Those that have passed are left out and counted, never caught up with: a
    burst of cycles would hand the arm several torques at once, each from measurements that are hardly new.

    Args:
        deadline: Of the cycle that has just ended [ns].
        now: The present [ns].
        period: Of the loop [ns].
    """
    missed = max(0, (now - deadline) // period)
    return deadline + (missed + 1) * period, missed


def prepare(priority: int = PRIORITY, cpu: int | None = None) -> list[str]:
    """Ask for everything and keep it until the process ends; one sentence each."""
    return [granted.sentence for granted in _ask(ExitStack(), priority, cpu)]


@contextmanager
def prepared(priority: int = PRIORITY, cpu: int | None = None) -> Iterator[list[Granted]]:
    """Ask for everything, and give it back at the end.

    Args:
        priority: SCHED_FIFO priority, 1 to 99.
        cpu: The only processor to run on; None leaves that to the system.
    """
    with ExitStack() as undo:
        yield _ask(undo, priority, cpu)


def _ask(undo: ExitStack, priority: int, cpu: int | None) -> list[Granted]:
    back = undo.callback
    return [
        freeze_garbage(back),
        shorten_waits(back),
        use_priority(priority, back),
        use_processor(cpu, back),
        one_thread(),
        lock_memory(back),  # last, when everything that it is to hold is there
    ]


def freeze_garbage(back: Callable[..., object]) -> Granted:
    """Collect once, and never again while the loop runs.

    Args:
        back: Takes a function and its arguments that undo this, here and below.
    """
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    back(gc.unfreeze)
    if was_enabled:
        back(gc.enable)
    return Granted(True, f"garbage collector: off, {gc.get_freeze_count()} objects set aside")


def shorten_waits(back: Callable[..., object]) -> Granted:
    """Sleeps end on time, and other threads of this process give way soon; needs no permission."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    back(sys.setswitchinterval, interval)
    # The slack of threads under SCHED_FIFO is always zero; 0 sets the default of 50 µs again.
    refused = _libc("prctl", _PR_SET_TIMERSLACK, 1, 0, 0, 0)
    back(_libc, "prctl", _PR_SET_TIMERSLACK, 0, 0, 0, 0)
    text = f"threads: give way after {1e6 * SWITCH_INTERVAL:.0f} µs; timer slack "
    return Granted(not refused, text + (f"stays 50 µs ({refused})" if refused else "1 ns"))


def use_priority(priority: int, back: Callable[..., object]) -> Granted:
    """Run before everything that has no real-time priority."""
    if not hasattr(os, "sched_setscheduler"):
        return Granted(False, "priority: this system has no SCHED_FIFO; cycles will be late under load")
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, ValueError) as error:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0] if hasattr(resource, "RLIMIT_RTPRIO") else 0
        remedy = f"put `@realtime - rtprio {max(priority, WATCHDOG_PRIORITY)}` into {LIMITS_FILE}"
        what = f"priority: SCHED_FIFO {priority} refused ({_words(error)}; rtprio limit {limit})"
        return Granted(False, f"{what}: {remedy}, join that group and log in again; cycles will be late under load")
    back(os.sched_setscheduler, 0, *before)
    return Granted(True, f"priority: SCHED_FIFO {priority}")


def use_processor(cpu: int | None, back: Callable[..., object]) -> Granted:
    """Stay on one processor, if one is named."""
    if not hasattr(os, "sched_setaffinity"):
        return Granted(False, "processor: this system cannot pin a process")
    before = os.sched_getaffinity(0)
    if cpu is None:
        return Granted(True, f"processor: any of {len(before)}; name one that `isolcpus` keeps free to pin the loop")
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError, OverflowError) as error:
        return Granted(False, f"processor: {cpu} refused ({_words(error)}); there are {sorted(before)}")
    back(os.sched_setaffinity, 0, before)
    return Granted(True, f"processor: {cpu} only")


def one_thread() -> Granted:
    """Whether linear algebra keeps to one thread. The loop calls none, but numpy's idle threads spin at first."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    if any(os.environ.get(name) == "1" for name in names):
        return Granted(True, "linear algebra: one thread")
    return Granted(False, "linear algebra: may start threads when numpy is loaded: set OMP_NUM_THREADS=1 before")


def lock_memory(back: Callable[..., object]) -> Granted:
    """Keep every page in memory, so that none must be fetched from a disk within a cycle."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    # Under a limit, memory that is asked for later and may not be locked would be refused altogether.
    whole = limit == resource.RLIM_INFINITY or os.geteuid() == 0
    refused = _libc("mlockall", _MCL_CURRENT | (_MCL_FUTURE if whole else 0))
    if refused:
        where = "unlimited" if limit == resource.RLIM_INFINITY else f"{limit >> 10} KiB"
        remedy = f"put `@realtime - memlock unlimited` into {LIMITS_FILE}, join that group and log in again"
        return Granted(False, f"memory: lock refused ({refused}; memlock limit {where}): {remedy}")
    back(_libc, "munlockall")
    return Granted(True, "memory: locked" if whole else "memory: locked as it is now; later pages are not (memlock)")


def _libc(name: str, *arguments: int) -> str:
    """Call a function of the C library; empty, or the system's words for its refusal."""
    try:
        function = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (AttributeError, OSError, TypeError):
        return f"no {name} here"
    return os.strerror(ctypes.get_errno()) if function(*map(ctypes.c_ulong, arguments)) else ""


def _words(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
