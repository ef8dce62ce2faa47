"""Rates of the heart at which a family that learns the beat has its least margins.

Over rates the gain reduction has a valley wherever another harmonic is the fastest that is learned, and a kink between
two; the other margins are least where the fastest begins to fade.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.law.repetition import FADING, Repetition
from jaxmpc.stability import Cells, Margins, margins_of_cells, worst_of
from jaxmpc.stability.held_beat import HeldBeat, rates_of
from jaxmpc.xla.rows import repeated, reshaped

RATES, SLOWEST = 11, 0.85
"""Rates, log-spaced, that are looked at, from so much of the one on at which the last harmonic begins to fade [-]: the
slower a heart, the less its harmonics take."""
ROUNDS, BESIDE = 2, np.array([-2.0, -1.0, 1.0, 2.0]) / 3.0
"""How often rates beside the worst are looked at, and where, over how far apart those before were."""


def looked_at(repetition: Repetition) -> Any:
    """Rates beside which the worst is looked for, (rates,) [rad/s]."""
    spread = first(repetition) * jnp.exp(apart(repetition) * jnp.arange(RATES))
    fading = rates_of(repetition, repetition.highest - FADING)
    return jnp.concatenate([jnp.array([repetition.finder.least]), spread, fading])


def first(repetition: Repetition) -> Any:
    """The slowest of those that are close together [rad/s]."""
    fading = (repetition.highest - FADING) / len(repetition.gains)
    return jnp.clip(SLOWEST * fading, repetition.finder.least, SLOWEST * repetition.finder.most)


def apart(repetition: Repetition) -> Any:
    """Distance of these, in the logarithm [-]."""
    return jnp.log(repetition.finder.most / first(repetition)) / (RATES - 1)


def closer(found: Margins, cells: Cells, beats: HeldBeat, ideal: bool) -> Margins:
    """The worst over rates, after a closer look beside the least gain reduction of every known stiffness.

    Args:
        found: At rates as `looked_at` has them, each (known, ratios, 1 + rates); the first learns nothing.
        cells: Those of one stiffness after another, a cell for each ratio.
        beats: The rates, and what is learned there, (1 + rates,).
        ideal: Whether the damping is ideal.

    Returns:
        Each (known, ratios).
    """
    known, ratios, _ = found.M_s.shape
    rows, told = np.arange(known), np.asarray(found.gain_reduction_db)[..., 1:].reshape(known, -1)
    ratio, rate = np.divmod(told.argmin(axis=1), told.shape[1] // ratios)
    middle, least = np.asarray(beats.rate)[1 + rate], told.min(axis=1)
    # Numpy takes rows without a program for each of these small things.
    one: Cells = jax.tree.map(lambda leaf: np.asarray(leaf)[rows * ratios + ratio], cells)
    seen: list[Margins] = [jax.tree.map(lambda field: np.asarray(field)[rows, ratio], found)]
    repetition: Repetition = jax.tree.map(lambda leaf: np.asarray(leaf)[-1], beats.repetition)
    lowest, highest, width = repetition.finder.least, repetition.finder.most, float(apart(repetition))
    learning = jax.tree.map(lambda leaf: np.repeat(leaf, known * len(BESIDE)), repetition)
    for _ in range(ROUNDS):
        tried = np.clip(middle[:, None] * np.exp(width * BESIDE), lowest, highest)
        each = repeated(one, len(BESIDE))._replace(held=HeldBeat(learning, tried.ravel()))
        seen.append(reshaped(margins_of_cells(each, ideal=ideal), 1, *tried.shape))
        told = np.asarray(seen[-1].gain_reduction_db)
        middle = np.where(told.min(axis=1) < least, tried[rows, told.argmin(axis=1)], middle)
        least, width = np.minimum(least, told.min(axis=1)), width / 3.0
    closest = worst_of(jax.tree.map(lambda *fields: jnp.concatenate(fields, axis=1), *seen))
    whole: Margins = jax.tree.map(lambda field, row: field.at[rows, ratio].set(row), worst_of(found), closest)
    return whole
