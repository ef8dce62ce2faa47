"""Searches side by side, each in a thread of its own, whose evaluations are one call of one program.

SciPy calls the function that it minimises; on a GPU a call for eight points takes as long as for one.
"""

from collections.abc import Callable
from threading import Barrier, BrokenBarrierError
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmpc.beside import Beside
from jaxmpc.xla.precision import in_float64

Evaluated = tuple[np.ndarray, ...]
"""What is found of a point."""
Search = Callable[[np.ndarray, Callable[[np.ndarray], Evaluated]], Any]
"""A function of where it begins, (size,), and of what evaluates a point; it returns what it has found."""


def in_step(
    search: Search, beginnings: Float[np.ndarray, "rows size"], evaluate: Callable[[np.ndarray, np.ndarray], Evaluated]
) -> list[Any]:
    """What each search returns.

    Args:
        search: Called once for each row, in a thread.
        beginnings: Where they begin.
        evaluate: Of the numbers of searches that are not over, (some,), and their points, (some, size); its results
            have a row for each.

    Raises:
        BaseException: What one of them has raised.
    """
    points, going = beginnings.copy(), np.ones(len(beginnings), bool)
    found: dict[int, Evaluated] = {}

    def all_have_asked() -> None:
        found.clear()
        if going.any():
            rows = np.flatnonzero(going)
            each = zip(*evaluate(rows, points[rows]), strict=True)
            found.update(zip(rows.tolist(), each, strict=True))

    together = Barrier(len(points), in_float64(all_have_asked))

    def one(row: int) -> Any:
        def at(x: np.ndarray) -> Evaluated:
            points[row] = x
            together.wait()
            return found[row]

        try:
            result = search(beginnings[row], at)
            going[row] = False
            together.wait()
            while found:
                together.wait()
        except BaseException:
            # The others wait for this one: they fail too.
            together.abort()
            raise
        return result

    with Beside(len(points)) as threads:
        ended = [threads.submit(one, row) for row in range(len(points))]
    failed = [error for each in ended if (error := each.exception())]
    for error in sorted(failed, key=lambda error: isinstance(error, BrokenBarrierError)):
        raise error
    return [each.result() for each in ended]
