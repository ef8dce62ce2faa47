"""Dask.distributed computes: workers on this machine or on many; this process alone writes."""

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from jaxmpc.files.errors import InputError
from sweeps.blocks import padded
from sweeps.crew import ComputedChunk, Crew, Round, Stop, gathered, rounds
from sweeps.leases import Leases, Stretch
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan
from sweeps.share import PATIENCE, Share
from sweeps.targets import numbered

AHEAD = 2
"""Chunks that each worker has in its hands, so that none waits for the next."""
CONNECT_S = 10.0
"""So long a scheduler may take to answer [s]."""
ALLOWED_DEATHS = 3
"""So many workers of ours may die of one chunk; a scheduler of the user's has its own `allowed-failures`."""
REPLACE_S = 5.0
"""So often workers of ours that are missing are started anew [s]."""
_SETTINGS = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    # Progress and wrong input are ours to tell.
    "distributed.admin.log-length": 0,
    # Nobody asks for a worker's profile.
    "distributed.worker.profile.enabled": False,
    # A worker that returns every block's memory to the system has to be given it again for the next.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
"""Dask's options, for a scheduler and workers of ours."""
_PROTOCOLS = ("tcp://", "tls://", "ucx://", "ws://", "wss://")


def worked(
    plan: Plan, first: int, last: int, cores: int | None
) -> tuple[list[ComputedChunk], dict[str, str], int, float]:
    """A worker's side: a chunk, in pieces where a round failed, its environment, rows that it ran, and how long [s].

    Its first round of a sweep is none of these: it has compiled as well.

    Args:
        plan: The sweep, with the content of its recordings.
        first: Place of the first row among the planned ones.
        last: Place behind the last.
        cores: CPU cores that it may use; None is all of its machine's.
    """
    _prepare(cores)
    import jax

    from sweeps.engines import engine_of
    from sweeps.machine import environment

    devices, began = jax.local_device_count(), time.perf_counter()
    made: list[Round] = []
    done, rows, seconds = first, 0, 0.0
    # Round by round: a chunk at once would be a program of its own for each length that a chunk may have.
    for each in rounds(plan, (first, last), lambda: False):
        now = time.perf_counter()
        if each.columns is not None:
            if plan.spec_hash in _compiled:
                rows, seconds = rows + padded(plan, devices, done, each.end), seconds + now - began
            _compiled.add(plan.spec_hash)
        made.append(each)
        done, began = each.end, now
    return [*gathered((first, last), made, last - first)], environment(engine_of(plan)), rows, seconds


_compiled: set[str] = set()
"""Sweeps of which this worker has computed a round."""
_prepared = False


def _prepare(cores: int | None) -> None:
    """Make this process a worker: 64-bit JAX, a device per core; once, before JAX computes anything."""
    global _prepared
    if not _prepared:
        from jaxmpc.terminal.process import use_all_cores

        use_all_cores(cores)
        _prepared = True


class DaskCrew(Crew):
    """Workers of a Dask scheduler.

    Args:
        told: Called with the columns of each chunk.
        address: Of a scheduler; None starts workers here, on the loopback interface alone.
        workers: How many to start here.
        cores: CPU cores that each worker may use.

    Raises:
        InputError: Dask is not installed, or the scheduler does not answer.
    """

    def __init__(
        self, told: Callable[[Columns], None], *, address: str | None, workers: int = 0, cores: int | None = None
    ) -> None:
        distributed, config = _dask()
        self._told, self._cores, self._local = told, cores, None
        self._wanted, self._replaced = workers, time.monotonic()
        with config.set(_SETTINGS):
            if address is None:
                self._local = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                    worker_dashboard_address=None,
                    silence_logs="ERROR",
                )
            self._client = _connected(distributed, address or self._local)
        self._landed: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def close(self) -> None:
        """Let go of the scheduler; workers that were started here end."""
        self._client.close()
        if self._local is not None:
            self._local.close()

    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        """See `Crew.work`."""
        flying: dict[Any, Stretch] = {}
        # Whoever dies here is a worker, and its scheduler counts.
        leases.warm = True
        try:
            while True:
                self._send(plan, share, pace, stop, flying)
                if not flying:
                    if stop() or share.finished():
                        return
                    share.wait(stop)
                    continue
                with suppress(queue.Empty):
                    future = self._landed.get(timeout=PATIENCE)
                    yield from self._pieces(future, flying.pop(future), pace)
        finally:
            self._client.cancel(list(flying))
            for stretch in flying.values():
                share.give_back(stretch)

    def _send(self, plan: Plan, share: Share, pace: Pace, stop: Stop, flying: dict[Any, Stretch]) -> None:
        """Hand out chunks until every worker has enough."""
        while len(flying) < AHEAD * self._workers() and not stop():
            stretch = share.next(pace.length)
            if stretch is None:
                return
            future = self._client.submit(worked, plan, *stretch, self._cores, pure=False)
            flying[future] = stretch
            future.add_done_callback(self._landed.put)

    def _workers(self) -> int:
        """How many workers there are, at least 1; those of ours that are missing are started."""
        found = len(self._client.scheduler_info(n_workers=-1)["workers"])
        if self._local is not None and found < self._wanted and time.monotonic() - self._replaced > REPLACE_S:
            self._replaced = time.monotonic()
            # Dask gives up for good who died and is not back within seconds, as on a busy machine; this opens another.
            self._local.scale(self._wanted)
        return max(found, 1)

    def _pieces(self, future: Any, stretch: Stretch, pace: Pace) -> Iterator[ComputedChunk]:
        try:
            pieces, environment, rows, seconds = future.result()
        # Of any type: whatever is wrong with these rows, the others are still wanted.
        except Exception as reason:
            yield ComputedChunk(stretch, *stretch, None, f"{type(reason).__name__}: {reason}")
            return
        if rows:
            pace.tell(rows, seconds)
        for piece in pieces:
            if piece.columns is not None:
                self._told(piece.columns)
            yield piece._replace(environment=environment)


def check_installed() -> None:
    """Refuse to go on without Dask.

    Raises:
        InputError: It is not installed.
    """
    _dask()


def check_address(address: str) -> None:
    """Refuse what is no address of a scheduler, or one that no certificate opens.

    Raises:
        InputError: It has no protocol, host or port, or asks for certificates that Dask has not been told of.
    """
    protocol, mark, rest = address.partition("://")
    host, _, port = rest.partition("/")[0].rpartition(":")
    if f"{protocol}{mark}" not in _PROTOCOLS or not host or not (numbered(port) and 0 < int(port) < 2**16):
        raise InputError("--cluster", address, "tcp://HOST:PORT or tls://HOST:PORT", "A scheduler prints its address.")
    distributed, _ = _dask()
    if protocol in ("tls", "wss") and not distributed.Security().get_connection_args("client").get("ssl_context"):
        remedy = "Name them in its settings (distributed.comm.tls.ca-file and client.cert, client.key)."
        raise InputError("--cluster", address, "given where Dask knows its certificates", remedy)


def check_answers(address: str) -> None:
    """Refuse to begin with a scheduler that does not answer.

    Raises:
        InputError: It does not, or Dask is not installed.
    """
    distributed, config = _dask()
    with config.set(_SETTINGS):
        _connected(distributed, address).close()


def _connected(distributed: Any, where: Any) -> Any:
    try:
        return distributed.Client(where, timeout=CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        remedy = "Start one: dask scheduler --host 127.0.0.1."
        raise InputError("--cluster", where, f"a scheduler that answers ({error})", remedy) from None


def _dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ModuleNotFoundError:
        remedy = "Install the extra: pip install 'jaxmpc[cluster]'."
        raise InputError("distributed", "not installed", "installed for work on several machines", remedy) from None
    return distributed, dask.config
