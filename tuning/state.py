"""Everything the descent must remember to go on after a kill, bit for bit."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmpc import __version__
from jaxmpc.errors import InputError
from jaxmpc.sealed import SealError, seal, unseal, write_atomic
from tuning.objective import Values

NAME = "state.npz"
FEASIBLE = 1.0
"""Largest normalised goal that counts as met."""


@dataclass
class State:
    """The descent between two looks. Histories have one row per look; rows not yet reached are NaN."""

    look: int
    """Looks taken so far."""
    z: np.ndarray
    """Unconstrained parameters, (starts, size)."""
    memory: Any
    """What the optimiser remembers."""
    best_z: np.ndarray
    """The best vector that meets all goals; NaN while there is none."""
    best: float
    """Its worst residual in training [N]; ∞ while there is none."""
    closest_z: np.ndarray
    """The vector that came closest to its goals with whole horizons."""
    closest: float
    """Its largest normalised goal [-]; ∞ while unstable."""
    gained: int
    """The look of the last gain worth counting."""
    skipped: np.ndarray
    """Steps not taken because the gradient was not finite, per start."""
    worst: np.ndarray
    """Worst residual per look and start [N]."""
    M_s: np.ndarray
    """M_s per look, start and stiffness [-]."""
    path: np.ndarray
    """z per look and start."""
    incumbent: np.ndarray
    """`best` after each look [N]."""

    @staticmethod
    def new(z: np.ndarray, memory: Any, looks: int, stiffnesses: int) -> "State":
        """Before the first look."""
        starts, size = z.shape
        none = np.full(size, np.nan)

        def rows(*shape: int) -> np.ndarray:
            return np.full((looks, *shape), np.nan)

        return State(
            look=0,
            z=z,
            memory=memory,
            best_z=none,
            best=np.inf,
            closest_z=z[0],
            closest=np.inf,
            gained=0,
            skipped=np.zeros(starts, np.int64),
            worst=rows(starts),
            M_s=rows(starts, stiffnesses),
            path=rows(starts, size),
            incumbent=rows(),
        )

    def record(self, values: Values, exact: bool, worth: float) -> None:
        """Enter one look into the histories; with whole horizons it may hold the best so far.

        Args:
            values: What was seen at `z`.
            exact: Whether the horizons were whole: only then the goals are those of a real controller.
            worth: Relative gain from which on it counts against the patience.
        """
        i = self.look
        self.worst[i], self.M_s[i], self.path[i] = values.worst, values.M_s, self.z
        if exact:
            # A start that left the finite numbers is as far from its goals as can be.
            largest = np.nan_to_num(np.max(values.normalised, axis=(1, 2)), nan=np.inf, posinf=np.inf)
            residual = np.where(largest <= FEASIBLE, values.worst, np.inf)
            winner, nearest = int(np.argmin(residual)), int(np.argmin(largest))
            if residual[winner] < self.best:
                if residual[winner] < self.best * (1.0 - worth):
                    self.gained = i
                self.best, self.best_z = float(residual[winner]), self.z[winner]
            if largest[nearest] < self.closest:
                self.closest, self.closest_z = float(largest[nearest]), self.z[nearest]
        self.incumbent[i] = self.best

    def stalled(self, patience: int, since: int) -> bool:
        """Whether nothing was gained for so many looks, counted from look `since` on."""
        return bool(np.isfinite(self.best)) and self.look - max(self.gained, since) > patience

    def note(self) -> str:
        """One line for the progress display."""
        i = self.look - 1
        leader = int(np.argmin(np.nan_to_num(self.worst[i], nan=np.inf)))
        best = f"best {1e3 * self.best:.1f} mN" if np.isfinite(self.best) else "no feasible point yet"
        now = f"start {leader}: worst {1e3 * self.worst[i, leader]:.1f} mN, M_s {self.M_s[i, leader].max():.2f}"
        skips = f", {self.skipped.sum()} steps skipped" if self.skipped.any() else ""
        return f"{best}; {now}{skips}"


def save(folder: Path, key: str, state: State) -> None:
    """Write the state, whole or not at all."""
    arrays = {field.name: np.asarray(getattr(state, field.name)) for field in fields(state) if field.name != "memory"}
    arrays |= {f"memory_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(state.memory))}
    write_atomic(folder / NAME, seal({"kind": "jaxmpc tuning state", "spec": key, "version": __version__}, arrays))


def load(folder: Path, key: str, fresh: State) -> State:
    """The saved state of the same spec, or the fresh one where nothing is saved.

    Raises:
        InputError: The folder holds the state of another spec or version, or a damaged one.
    """
    path = folder / NAME
    if not path.exists():
        return fresh
    try:
        header, arrays = unseal(path.read_bytes())
    except SealError as error:
        raise InputError(str(path), "damaged", "an intact state", f"{error}. Remove it to begin anew.") from None
    if header.get("spec") != key or header.get("version") != __version__:
        raise InputError(
            "-o", folder, "a new folder, or one of this very spec and version", "Choose another or remove it."
        )
    leaves, structure = jax.tree.flatten(fresh.memory)
    memory = jax.tree.unflatten(structure, [arrays.pop(f"memory_{i}") for i in range(len(leaves))])
    numbers = {name: arrays.pop(name)[()] for name in ("look", "best", "closest", "gained")}
    return State(
        memory=memory,
        **arrays,
        look=int(numbers["look"]),
        gained=int(numbers["gained"]),
        best=float(numbers["best"]),
        closest=float(numbers["closest"]),
    )
