"""Curves with fewer points, none of whose peaks is lost."""

import numpy as np

POINTS = 700
"""Points of a force over time; of each stretch the least and the largest sample stay."""


def thinned(x: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """A curve with fewer points: the least and the largest of each stretch, so that no peak is lost.

    Args:
        x: Ascending, (samples,).
        y: (samples,).
        points: How many are left, about.
    """
    if len(y) <= points:
        return x, y
    stretch = -(-2 * len(y) // points)
    count = len(y) // stretch
    parts = y[: count * stretch].reshape(count, stretch)
    first = np.arange(count) * stretch
    # What is missing is larger and smaller than anything, so that a gap stays one.
    lost = np.isnan(parts)
    low, high = np.where(lost, -np.inf, parts).argmin(axis=1), np.where(lost, np.inf, parts).argmax(axis=1)
    places = np.sort(np.stack([first + low, first + high], axis=1), axis=1).ravel()
    return x[places], y[places]
