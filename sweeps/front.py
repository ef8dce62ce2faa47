"""The Pareto front of a table of goals."""

import numpy as np


def front(table: np.ndarray) -> np.ndarray:
    """Places of the rows that no other beats: none is at most as large in every column and smaller in one.

    Args:
        table: Goals to be minimised, (rows, goals), finite.

    Returns:
        Places, ascending; rows that are equal in every goal stay or go together.
    """
    left = np.lexsort(table.T[::-1])
    found: list[np.ndarray] = []
    while len(left):
        # Ordered by the first goal, then the second …: nothing that comes later beats the first of them.
        pivot = table[left[0]]
        values = table[left]
        same = (values == pivot).all(axis=1)
        found.append(left[same])
        left = left[~(values >= pivot).all(axis=1)]
    return np.sort(np.concatenate(found)) if found else np.zeros(0, int)
