"""What points of a front hand on between the legs of their descent, without any descent."""

import numpy as np
import pytest

from tuning.search.front import handed_on
from tuning.search.state import SearchState


@pytest.mark.parametrize(
    ("second", "scores", "chosen"),
    [
        ((1.7, 7.0), (1.0, 0.5), 1),
        ((1.7, 5.0), (1.0, 0.5), 0),
        ((1.9, 7.0), (1.0, 0.5), 0),
        ((1.7, 7.0), (1.0, 1.5), 0),
    ],
    ids=["better, and holds the tighter limits", "breaks the floor", "breaks the ceiling", "worse"],
)
def test_a_point_takes_over_what_is_better_and_holds_its_own_limits(
    second: tuple[float, float], scores: tuple[float, float], chosen: int
) -> None:
    """The first asks for M_s <= 1.8 and a gain margin of 6 dB, the second for 2 and 4 dB; each found one vector."""
    asked, floors = np.array([[1.8, 6.0], [2.0, 4.0]]), np.array([False, True])
    z, reached = np.array([[0.1], [0.2]]), np.array([(1.75, 6.5), second])
    state = SearchState.new(z, None, 3, (2, 1))
    state.iteration, state.best, state.best_z = 1, np.array(scores), z
    state.path[0], state.hard[0] = z, np.where(floors, asked / reached, reached / asked)
    assert handed_on(state, asked, floors)[0] == z[chosen]


def test_who_has_nothing_takes_over_what_holds_or_goes_on_from_its_closest() -> None:
    asked, floors = np.array([[1.8], [2.0]]), np.array([False])
    state = SearchState.new(np.array([[0.1], [0.2]]), None, 3, (1, 1))
    state.iteration, state.best, state.best_z = 1, np.array([np.inf, 0.5]), np.array([[np.nan], [0.2]])
    state.path[0] = state.z
    for M_s, start in ((1.7, 0.2), (1.9, 0.1)):
        state.hard[0] = np.array([[2.5 / 1.8], [M_s / 2.0]])
        assert handed_on(state, asked, floors)[0] == start
