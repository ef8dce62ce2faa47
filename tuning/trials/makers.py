"""Processes that make what blocks of trials meet, and hand it over by shared memory.

A block is a hundred megabytes: a pipe takes as long for it as a sixteenth of a second's work of all cores. Where shared
memory is short, as in a container, the pipe has to do.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import islice
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import numpy as np

from jaxmpc.beside import forks_of
from tuning.trials.program import Met

MEMORY = Path("/dev/shm")
"""Files here are memory."""
Shapes = list[tuple[int, ...]]


def made_by_processes(make: Callable[[int], Met], firsts: Sequence[int]) -> Iterator[Met]:
    """What blocks meet, in their order, made by a process per core, no more of them than two for each process ahead.

    Args:
        make: What the block meets that begins with a trial, arrays of doubles.
        firsts: First trial of each block.
    """
    cores = len(os.sched_getaffinity(0))
    memory = MEMORY if MEMORY.is_dir() else None
    with (
        TemporaryDirectory(prefix="jaxmpc-", dir=memory) as folder,
        ProcessPoolExecutor(cores, forks_of("tuning.trials.compute"), _as_a_maker) as pool,
    ):
        one = partial(_handed_over, make, Path(folder)) if memory else make
        ahead, waiting = iter(firsts), deque[tuple[int, Any]]()

        def begin(count: int) -> None:
            waiting.extend((first, pool.submit(one, first)) for first in islice(ahead, count))

        begin(2 * cores)
        while waiting:
            first, made = waiting.popleft()
            yield _taken(made.result(), Path(folder) / str(first))
            begin(1)


def _as_a_maker() -> None:
    """A process that leaves the GPU alone, the cores to what is compiled, and Ctrl-C to the one that asked."""
    os.nice(5)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    config: Any = jax.config
    config.update("jax_platforms", "cpu")


def _handed_over(make: Callable[[int], Met], folder: Path, first: int) -> Met | Shapes:
    """The shapes of what is in the file named by the first trial; itself where no memory is left for a file."""
    met = make(first)
    path = folder / str(first)
    try:
        with path.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, sum(array.nbytes for array in met))
            for array in met:
                file.write(np.ascontiguousarray(array, np.float64).data)
    except OSError:
        path.unlink(missing_ok=True)
        return met
    return [array.shape for array in met]


def _taken(handed: Met | Shapes, path: Path) -> Met:
    if isinstance(handed, Met):
        return handed
    numbers = np.memmap(path, np.float64, "r")
    path.unlink()  # the memory goes with the last who looks at it
    ends = np.cumsum([prod(shape) for shape in handed])[:-1]
    return Met(*(part.reshape(shape) for part, shape in zip(np.split(numbers, ends), handed, strict=True)))
