"""What the loop meets at each sample of an experiment, and which samples count."""

from typing import NamedTuple, TypeVar

import numpy as np

from jaxmpc.experiment.reference import Reference, wanted_force
from jaxmpc.files.errors import InputError
from jaxmpc.quantities import AXES, HP_MAX

Arrays = TypeVar("Arrays", bound=tuple[np.ndarray, ...])


class Signals(NamedTuple):
    """What the loop meets at each sample, the same for every controller."""

    heart: np.ndarray
    """Position of the heart's surface, shape (steps, 3) [m]."""
    noise: np.ndarray
    """Sensor noise, shape (steps, 3) [N]."""
    force_ref: np.ndarray
    """Wanted force, shape (steps, 3), longer by `HP_MAX` with preview [N]."""
    score: np.ndarray
    """Whether a sample counts in the metrics, shape (steps, 3)."""


def fixed(arrays: Arrays) -> Arrays:
    """The same arrays, which nobody can write to any more: an experiment keeps them for its next run."""
    for array in arrays:
        array.setflags(write=False)
    return arrays


def scored(reference: Reference, steps: int, T_s: float, settle: float) -> tuple[np.ndarray, np.ndarray]:
    """Wanted force [N] and whether a sample counts in the metrics, as in `Signals`.

    Args:
        reference: The wanted force over time.
        steps: Number of samples.
        T_s: Sampling time [s].
        settle: What is left out at the start [s]; ramps are left out as well.

    Raises:
        InputError: None counts.
    """
    t = np.arange(steps) * T_s
    ahead = np.arange(steps + (HP_MAX if reference.preview else 0)) * T_s
    wanted, ramps = zip(*(wanted_force(getattr(reference, axis), ahead) for axis in AXES), strict=True)
    score = (t >= settle)[:, None] & ~np.stack(ramps, 1)[:steps]
    if not score.any(axis=0).all():
        raise InputError("settle", settle, "shorter", "No sample is left to score: all are settling or ramps.")
    return np.stack(wanted, 1), score
