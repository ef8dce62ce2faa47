"""Curves with fewer points, none of whose peaks is lost."""

import numpy as np

POINTS = 700
"""Points of a force over time; of each stretch the least and the largest sample stay."""


def thinned(x: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """A curve with fewer points: the least and the largest of each stretch, so that no peak is lost, and the last.

    Args:
        x: Ascending, (samples,).
        y: (samples,).
        points: How many are left, about.
    """
    if len(y) <= points:
        return x, y
    stretch = -(-2 * len(y) // (points - 2))
    count = -(-len(y) // stretch)
    parts = np.pad(y, (0, count * stretch - len(y)), mode="edge").reshape(count, stretch)
    first = np.arange(count) * stretch
    # What is missing is larger and smaller than anything, so that a gap stays one.
    lost = np.isnan(parts)
    low, high = np.where(lost, -np.inf, parts).argmin(axis=1), np.where(lost, np.inf, parts).argmax(axis=1)
    found = np.sort(np.stack([first + low, first + high], axis=1), axis=1).ravel()
    places = np.append(np.minimum(found, len(y) - 1), len(y) - 1)
    return x[places], y[places]
