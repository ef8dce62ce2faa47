"""A loop that asks for what no heart does is ended, at the third sample and not before."""

import math

import pytest

from deploy.safety.reasons import Reason
from deploy.safety.runaway import ASKED, runaway_step


def run(asked):
    count, found = 0, []
    for each in asked:
        count, reason = runaway_step(count, each)
        found.append(reason)
    return found


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.6, -0.8)])
def test_three_samples_in_a_row_beyond_the_bound(direction):
    at, over = (tuple(size * each for each in direction) for size in (ASKED, 1.001 * ASKED))
    assert run([at] * 100) == [None] * 100
    assert run([over, over, at, over, over, over, over]) == [None] * 5 + [Reason.FORCE_MODEL] * 2


def test_a_swing_counts_whichever_way_it_goes():
    assert run([(0.0, 0.0, size) for size in (50.0, -60.0, 80.0)])[-1] is Reason.FORCE_MODEL


@pytest.mark.parametrize("axis", range(3))
def test_what_is_not_a_number_counts(axis):
    asked = tuple(math.nan if i == axis else 0.0 for i in range(3))
    assert run([asked] * 3) == [None, None, Reason.FORCE_MODEL]
