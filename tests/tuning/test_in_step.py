"""Searches in step find what they find alone, ask together, and fail together."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import rosen, rosen_der

from tuning.search.corrected import MOST, _searched
from tuning.search.in_step import in_step

BEGINNINGS = np.array([[-1.0, 1.0], [0.3, 0.2], [1.0, 1.0], [2.0, -0.5], [0.9, 0.8]])


def halved(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray]:
    return (0.5 * x,)


def down_to(limit: float) -> Callable[..., int]:
    """A search that counts how often it must halve."""

    def search(begin: np.ndarray, at: Callable[[np.ndarray], Any]) -> int:
        x, count = begin, 0
        while np.abs(x).max() > limit:
            (x,), count = at(x), count + 1
        return count

    return search


def test_each_search_has_its_own_points_and_ends_when_it_is_done() -> None:
    asked: list[list[int]] = []

    def evaluate(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray]:
        asked.append(rows.tolist())
        return halved(rows, x)

    counts = in_step(down_to(0.1), np.array([[0.05], [0.8], [0.3]]), evaluate)
    assert counts == [0, 3, 2]
    assert asked == [[1, 2], [1, 2], [1]], "one call for all, and none for those that are over"


def test_a_search_with_company_is_a_search_alone() -> None:
    """The banana, under a constraint that is on along the way."""

    def evaluate(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.stack([[rosen(row), row.sum() - 2.5] for row in x])
        return values, np.stack([[rosen_der(row), np.ones(2)] for row in x])

    together = in_step(_searched, BEGINNINGS, evaluate)
    alone = [in_step(_searched, BEGINNINGS[i : i + 1], evaluate)[0] for i in range(len(BEGINNINGS))]
    np.testing.assert_array_equal(together, alone)


def test_a_search_that_finds_nothing_does_not_keep_the_others() -> None:
    """A slope that lies is searched along in vain; what was best counts."""
    count = 0

    def evaluate(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal count
        count += 1
        return np.sum(x**2, axis=1)[:, None], -2.0 * x[:, None]

    (found,) = in_step(_searched, np.array([[1.0, 1.0]]), evaluate)
    assert count <= MOST
    np.testing.assert_array_equal(found, [1.0, 1.0])


def test_programs_run_in_float64() -> None:
    """A thread has a precision of its own."""
    kinds = []

    def evaluate(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray]:
        kinds.append(jnp.asarray(x).dtype)
        return halved(rows, x)

    in_step(down_to(0.1), np.array([[0.3]]), evaluate)
    assert set(kinds) == {np.dtype(np.float64)}


def failing_search(begin: np.ndarray, at: Callable[[np.ndarray], Any]) -> int:
    if begin[0] == 0.3:
        raise ArithmeticError("the second")
    return down_to(0.1)(begin, at)


def failing_evaluation(rows: np.ndarray, x: np.ndarray) -> tuple[np.ndarray]:
    if len(rows) == 2:
        raise ArithmeticError("with two left")
    return halved(rows, x)


@pytest.mark.parametrize(
    ("search", "evaluate", "told"),
    [(failing_search, halved, "the second"), (down_to(0.1), failing_evaluation, "with two left")],
)
def test_what_fails_is_told_and_nobody_waits_for_it(
    search: Callable[..., int], evaluate: Callable[..., Any], told: str
) -> None:
    with pytest.raises(ArithmeticError, match=told):
        in_step(search, np.array([[0.8], [0.3], [0.15]]), evaluate)
