"""Everything the descent must remember to go on after a kill, bit for bit."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmpc import __version__
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import SealError, seal, unseal, write_atomic
from jaxmpc.loop.linear import HIGHEST_FORCE
from jaxmpc.xla.store import source_of
from tuning.objective.loss import Values

NAME = "state.npz"
LARGEST = 2**31
"""Largest state that is read [bytes]: 1024 starts keep 100 kB an iteration."""
FEASIBLE = 1.0
"""Largest normalised goal that counts as met."""


@dataclass
class SearchState:
    """The descent between two iterations. Histories have one row per iteration; rows not yet reached are NaN."""

    iteration: int
    """Iterations so far."""
    z: np.ndarray
    """Unconstrained parameters, (starts, size)."""
    memory: Any
    """What the optimiser remembers."""
    best_z: np.ndarray
    """The best vector of each start that holds the hard goals, (starts, size); NaN while there is none."""
    best: np.ndarray
    """Its score: risk of the soft goals, (starts,) [-]; ∞ while there is none."""
    closest_z: np.ndarray
    """The vector of each start that came closest to the hard goals with whole horizons, (starts, size)."""
    closest: np.ndarray
    """Its largest normalised hard goal, (starts,) [-]; ∞ while unstable."""
    gained: int
    """The iteration of the last gain worth counting."""
    skipped: np.ndarray
    """Steps not taken because the gradient was not finite, per start."""
    score: np.ndarray
    """Risk of the soft goals per iteration and start [-]."""
    worst: np.ndarray
    """Worst residual per iteration and start [N]."""
    tissue: np.ndarray
    """Where the soft goals stood worst per iteration and start, index into the stiffnesses."""
    M_s: np.ndarray
    """M_s at the worst stiffness per iteration and start [-]."""
    hard: np.ndarray
    """Hard goals per iteration, start and goal [-]."""
    hard_at: np.ndarray
    """Where each of them on the runs stood worst, likewise, index into the stiffnesses; NaN for margins and what no run
    tells."""
    soft: np.ndarray
    """Soft goals per iteration, start and goal [-]."""
    path: np.ndarray
    """z per iteration and start."""
    incumbent: np.ndarray
    """The least `best` after each iteration [-]."""

    @staticmethod
    def new(z: np.ndarray, memory: Any, iterations: int, goals: tuple[int, int]) -> "SearchState":
        """Before the first iteration; `goals` counts the hard and the soft ones."""
        starts, size = z.shape

        def rows(*shape: int) -> np.ndarray:
            return np.full((iterations, *shape), np.nan)

        return SearchState(
            iteration=0,
            z=z,
            memory=memory,
            best_z=np.full((starts, size), np.nan),
            best=np.full(starts, np.inf),
            closest_z=z,
            closest=np.full(starts, np.inf),
            gained=0,
            skipped=np.zeros(starts, np.int64),
            score=rows(starts),
            worst=rows(starts),
            tissue=rows(starts),
            M_s=rows(starts),
            hard=rows(starts, goals[0]),
            hard_at=rows(starts, goals[0]),
            soft=rows(starts, goals[1]),
            path=rows(starts, size),
            incumbent=rows(),
        )

    @property
    def feasible(self) -> bool:
        """Whether any start has held all hard goals."""
        return bool(np.isfinite(self.best).any())

    @property
    def leader(self) -> int:
        """The start with the best vector so far, or with the one that came closest."""
        return int(np.argmin(self.best if self.feasible else self.closest))

    @property
    def leader_z(self) -> np.ndarray:
        """Its vector."""
        vector: np.ndarray = (self.best_z if self.feasible else self.closest_z)[self.leader]
        return vector

    def record(self, values: Values, exact: bool, worth: float, hard_at: np.ndarray | None = None) -> None:
        """Enter one iteration into the histories; with whole horizons it may hold the best so far.

        Args:
            values: What was seen at `z`.
            exact: Whether the horizons were whole: only then the goals are those of a real controller.
            worth: Relative gain from which on it counts against the patience.
            hard_at: `Problem.hard_at` of it; None tells nothing.
        """
        i = self.iteration
        self.score[i], self.worst[i], self.tissue[i] = values.score, values.worst, values.tissue
        self.M_s[i], self.hard[i], self.soft[i] = values.M_s.max(axis=1), values.hard, values.soft
        self.path[i] = self.z
        if hard_at is not None:
            self.hard_at[i, :, values.hard.shape[1] - hard_at.shape[1] :] = hard_at
        if exact:
            # A start that left the finite numbers, or 1 kN, is as far from its goals as can be.
            # Spectra know no peaks: what is no number there was not measured.
            lost = values.cells.peak_error.max(axis=(1, 2, 3)) >= HIGHEST_FORCE
            largest = np.nan_to_num(values.hard.max(axis=1, initial=0.0), nan=np.inf, posinf=np.inf)
            largest = np.where(lost, np.inf, largest)
            score = np.where(largest <= FEASIBLE, np.nan_to_num(values.score, nan=np.inf), np.inf)
            if score.min() < self.best.min() * (1.0 - worth):
                self.gained = i
            better, nearer = score < self.best, largest < self.closest
            self.best, self.best_z = np.minimum(self.best, score), np.where(better[:, None], self.z, self.best_z)
            self.closest = np.minimum(self.closest, largest)
            self.closest_z = np.where(nearer[:, None], self.z, self.closest_z)
        self.incumbent[i] = self.best.min()

    def stalled(self, patience: int, since: int) -> bool:
        """Whether nothing was gained for so many iterations, counted from iteration `since` on."""
        return self.feasible and self.iteration - max(self.gained, since) > patience


def check_states(folder: Path, keys: Collection[str]) -> None:
    """Refuse a folder in which another job, or another program, has left the state of a search of whatever kind.

    Args:
        folder: Of the results.
        keys: Specs whose states may be there. Fronts are told apart as each of their legs begins.

    Raises:
        InputError: Another's is.
    """
    for path in sorted(set(folder.glob("state*.npz")) - set(folder.glob("state-pareto*.npz"))):
        with suppress(SealError):  # told when it is to be read
            _of_these(unseal(path.read_bytes(), LARGEST)[0], keys, folder)


def _of_these(header: Mapping[str, Any], keys: Collection[str], folder: Path) -> None:
    if header.get("spec") not in keys:
        raise InputError("-o", folder, "a new folder, or one of this very spec", "Choose another or remove it.")
    if any(header.get(key) != value for key, value in _program().items()):
        remedy = "What it measures may have been something else before: choose another or remove it."
        raise InputError("-o", folder, "a new folder, or one that this very program has begun", remedy)


def _program() -> dict[str, str]:
    """What made a state: numbers of two programs, which may mean different things, do not belong in one search."""
    return {"version": __version__, "jaxmpc": source_of("jaxmpc"), "tuning": source_of("tuning")}


def save(folder: Path, key: str, state: SearchState, name: str = NAME) -> None:
    """Write the state, whole or not at all."""
    arrays = {field.name: np.asarray(getattr(state, field.name)) for field in fields(state) if field.name != "memory"}
    arrays |= {f"memory_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(state.memory))}
    write_atomic(folder / name, seal({"kind": "jaxmpc tuning state", "spec": key, **_program()}, arrays))


def load(folder: Path, key: str, fresh: SearchState, name: str = NAME) -> SearchState:
    """The saved state of the same spec, or the fresh one where nothing is saved.

    Raises:
        InputError: The folder holds the state of another spec or program, or a damaged one.
    """
    path = folder / name
    if not path.exists():
        return fresh
    try:
        header, arrays = unseal(path.read_bytes(), LARGEST)
    except SealError as error:
        raise InputError(str(path), "damaged", "an intact state", f"{error}. Remove it to begin anew.") from None
    _of_these(header, (key,), folder)
    leaves, structure = jax.tree.flatten(fresh.memory)
    memory = jax.tree.unflatten(structure, [arrays.pop(f"memory_{i}") for i in range(len(leaves))])
    iteration, gained = (int(arrays.pop(name)[()]) for name in ("iteration", "gained"))
    return SearchState(memory=memory, **arrays, iteration=iteration, gained=gained)
