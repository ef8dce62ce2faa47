"""What one run of one tuner cost and found, as a sealed file: finished runs are not run again."""

import time
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import SealError, seal, unseal, write_atomic

KIND = "jaxmpc rival"


class Spent(NamedTuple):
    """What has been spent since the beginning of a run."""

    evaluations: float = 0.0
    """Controllers evaluated by runs; a gradient counts at its cost ratio."""
    steps: float = 0.0
    """Simulated steps, likewise; what steps no time counts as the steps that its wall-clock is worth."""
    seconds: float = 0.0
    """Wall-clock, without compilation [s]."""
    cpu: float = 0.0
    """Of all threads, which other work on the machine disturbs less [s]."""

    def plus(self, other: "Spent") -> "Spent":
        """Both together."""
        return Spent(*(a + b for a, b in zip(self, other, strict=True)))


class Clock:
    """Wall-clock and CPU time since it was made, or since what was spent before."""

    def __init__(self, before: Spent | None = None) -> None:
        self._before = before or Spent()
        self._began = time.perf_counter(), time.process_time()

    def spent(self, evaluations: float, steps: float) -> Spent:
        """All that has been spent by now, given what was evaluated since."""
        seconds, cpu = time.perf_counter() - self._began[0], time.process_time() - self._began[1]
        return self._before.plus(Spent(evaluations, steps, seconds, cpu))


@dataclass(frozen=True)
class Run:
    """One tuner with one seed; a row per batch or look."""

    spent: np.ndarray
    """(rows, 4), as `Spent`."""
    best: np.ndarray
    """Least loss so far, (rows,) [-]."""
    z: np.ndarray
    """Where that was found at last, unconstrained (size,)."""
    score: float
    """Its risk of the soft goals [-]."""
    hard: float
    """Its largest hard goal [-]."""
    own: float
    """Seconds that were not spent in the objective: the tuner's own."""
    starts: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """What the spectra proposed, (starts, size)."""
    coarse: np.ndarray = field(default_factory=lambda: np.zeros(4))
    """What that had cost, (4,)."""

    def until(self, loss: float, column: str) -> float:
        """What it took to come to a loss; ∞ if it never did."""
        reached = np.flatnonzero(self.best <= loss)
        return float(self.spent[reached[0], Spent._fields.index(column)]) if len(reached) else np.inf

    def save(self, path: Path, key: str) -> None:
        """Write it, whole or not at all."""
        arrays = {each.name: np.asarray(getattr(self, each.name)) for each in fields(self)}
        write_atomic(path, seal({"kind": KIND, "key": key}, arrays))

    @staticmethod
    def load(path: Path, key: str) -> "Run":
        """A finished run of the same job.

        Raises:
            InputError: The file is damaged or of another job.
        """
        try:
            header, arrays = unseal(path.read_bytes())
        except SealError as error:
            raise InputError(str(path), "damaged", "an intact result", f"{error}. Remove it.") from None
        if header != {"kind": KIND, "key": key}:
            raise InputError("-o", path.parent, "a new folder, or one of this very job", "Choose another or remove it.")
        numbers = {name: float(arrays.pop(name)[()]) for name in ("score", "hard", "own")}
        values: dict[str, Any] = {**arrays, **numbers}
        return Run(**values)
