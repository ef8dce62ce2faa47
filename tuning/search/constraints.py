"""A job by spectra as a program with constraints: log risk, and what must be at most 0, with their slopes.

Margins and runs are programs of their own, which compile side by side.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmpc.metrics import Metrics
from jaxmpc.xla.blocks import OverDevices, fetched
from tuning.job.space import SearchSpace
from tuning.objective.loss import margin_constraints, run_constraints
from tuning.objective.measures import Data, ProblemStructure
from tuning.objective.problem import Problem


class Constrained(NamedTuple):
    """Log risk and constraints of vectors, each (rows, …)."""

    values: Float[np.ndarray, "rows values"]
    """Log risk; then 1 − 1/g and the headroom, of each margin at every stiffness, and of what the runs are held to
    [-]."""
    slopes: Float[np.ndarray, "rows values moved"]
    """Per number that moves: horizons, which have no slope at whole numbers, do not."""
    stable: Bool[np.ndarray, " rows"]


class Constraints:
    """What gives them, so many vectors at a time; as fast for any problem of the same shapes."""

    def __init__(self, spectra: Problem, searches: int) -> None:
        """Take a job.

        Args:
            spectra: Its problem by spectra.
            searches: How many vectors there mostly are.
        """
        self.spectra = spectra
        # On a GPU all take as long as one; else a core has one.
        self._size = jax.local_device_count() if jax.default_backend() == "cpu" else searches
        self._margins, self._runs = programs_of(spectra.structure)
        limits = jax.tree.map(np.float64, {"margins": spectra.data.margins, "hard": spectra.data.hard})
        self._shared = self._runs.everywhere(spectra.data._replace(**limits, correction=None))

    @property
    def moved(self) -> np.ndarray:
        """Which numbers move, indices."""
        return moved_of(self.spectra.data, self.spectra.structure)

    def __call__(self, z: Float[np.ndarray, "rows size"], factors: Metrics | None) -> Constrained:
        """Judge any number of vectors.

        Args:
            z: The vectors.
            factors: Correction of each, each field (rows, stiffness, scenarios, 3); None corrects nothing.
        """
        parts = []
        for first in range(0, len(z), self._size):
            rows = np.minimum(np.arange(first, first + self._size), len(z) - 1)
            own = z[rows], jax.tree.map(lambda field, rows=rows: field[rows], factors)
            margins = self._margins.launched(own, self._shared)
            runs = self._runs.launched(own, self._shared, margins[1])
            ((held, held_slopes), stable), (done, done_slopes) = fetched((margins, runs), self._size)
            values = np.concatenate([done[:, :1], held, done[:, 1:]], axis=1)
            slopes = np.concatenate([done_slopes[:, :1], held_slopes, done_slopes[:, 1:]], axis=1)
            parts.append(Constrained(values, slopes, stable))
        return Constrained(*(np.concatenate(part)[: len(z)] for part in zip(*parts, strict=True)))

    def compile_margins(self) -> None:
        """Compile what judges margins of corrected spectra."""
        self._margins.compile(self._anything(), self._shared)

    def compile_runs(self) -> None:
        """Compile the rest."""
        self._runs.compile((*self._anything(), np.ones(self._size, bool)), self._shared)

    def _anything(self) -> tuple[Any, ...]:
        data = self.spectra.data
        size = SearchSpace(data.base, self.spectra.structure.axes).size
        factors = jax.tree.map(lambda field: np.ones((self._size, *field.shape)), data.reference)
        return np.zeros((self._size, size)), factors


@cache
def programs_of(structure: ProblemStructure) -> tuple[OverDevices, OverDevices]:
    """Compiled functions of rows and of data: of margins, and of runs, whose rows tell what is stable, too."""
    return OverDevices(_of_margins, {"structure": structure}), OverDevices(_of_runs, {"structure": structure})


def moved_of(data: Data, structure: ProblemStructure) -> np.ndarray:
    """Which numbers of a vector have slopes, indices."""
    return np.flatnonzero(~SearchSpace(data.base, structure.axes).whole)


def _of_margins(rows: Any, shared: Data, structure: ProblemStructure) -> Any:
    z, factors = rows
    data = shared._replace(correction=factors)
    found, push, stable = jax.linearize(lambda z: margin_constraints(z, data, structure), z, has_aux=True)
    return (found, _slopes(push, z, moved_of(data, structure))), stable


def _of_runs(rows: Any, shared: Data, structure: ProblemStructure) -> Any:
    z, factors, stable = rows
    data = shared._replace(correction=factors)
    found, push = jax.linearize(lambda z: run_constraints(z, data, structure, stable), z)
    return found, _slopes(push, z, moved_of(data, structure))


def _slopes(push: Any, z: Float[Array, "rows size"], moved: np.ndarray) -> Float[Array, "rows values moved"]:
    """In forward mode: some ten numbers move, and there are as many constraints as goals times tissues."""
    # A row depends on nothing but itself, so one direction serves them all.
    along: Any = jax.vmap(lambda direction: push(jnp.broadcast_to(direction, z.shape)), out_axes=2)
    return jnp.asarray(along(jnp.eye(z.shape[1])[moved]))
