"""The push that a sensor hides, told from friction: against numpy's least squares, and on either side of its bound."""

import numpy as np
import pytest

from deploy.safety.force_balance import HIDDEN, BalanceState, balance_step
from deploy.safety.hidden_push import FILLED, MEMORY, TURNING, MotionSums, gathered, hidden_push
from deploy.safety.reasons import Reason

T_S = 1e-3
UP = (0.0, 0.0, 1.0)
BEAT = 0.8
"""Period of a heart [s]."""


def summed(slip, push):
    sums = MotionSums()
    for s, d in zip(slip, push, strict=True):
        sums = gathered(sums, float(s), float(d), T_S)
    return sums


def test_it_is_the_weighted_least_squares_of_numpy():
    draw = np.random.default_rng(1)
    slip, push = draw.uniform(-1.0, 1.0, 2500), draw.normal(0.0, 2.0, 2500)
    root = np.sqrt((1.0 - T_S / MEMORY) ** np.arange(2499, -1, -1))
    (b, c), *_ = np.linalg.lstsq(root[:, None] * np.c_[np.ones(2500), slip], root * push, rcond=None)
    assert hidden_push(summed(slip, push), -0.9, 1.7) == pytest.approx(b - (1.7 + 0.9 * c), abs=1e-9)


def test_friction_and_gravity_s_error_are_no_push():
    slip = np.sin(2.0 * np.pi * T_S * np.arange(4000) / BEAT)
    for friction in (-3.0, -6.0):
        for gravity in (-2.0, 2.0):
            found = hidden_push(summed(slip, gravity + friction * slip + 0.7), -0.9, gravity - 0.9 * friction)
            assert found == pytest.approx(0.7, abs=1e-9)


def test_nothing_is_told_too_soon_or_where_nothing_moves():
    turning = np.where(np.arange(4000) % 2, 1.0, -1.0)
    soon = round(np.log(1.0 / (1.0 - FILLED)) * MEMORY / T_S)
    assert hidden_push(summed(turning[: soon - 5], turning[: soon - 5]), -1.0, 0.0) is None
    assert hidden_push(summed(turning[: soon + 5], turning[: soon + 5]), -1.0, 0.0) is not None
    for size, known in ((0.99, False), (1.01, True)):
        slip = size * np.sqrt(TURNING) * turning
        assert (hidden_push(summed(slip, slip), -1.0, 0.0) is not None) is known


@pytest.mark.parametrize(("hides", "reason"), [(HIDDEN - 0.3, None), (HIDDEN + 0.3, Reason.FORCE_MODEL), (-5.0, None)])
@pytest.mark.parametrize("friction", [2.5, 5.0])
def test_a_push_that_friction_hides_is_seen_within_two_seconds_and_a_smaller_one_never(hides, reason, friction):
    """Far below what the balance of a single moment may show."""
    state = BalanceState()
    for _ in range(400):
        state, found = balance_step(state, (0.0, 0.0, -friction), (0.0, 0.0, 0.0), (0.0, 0.0, -0.02), UP, True, T_S)
        assert found is None
    for k in range(2000):
        speed = 0.05 * np.sin(2.0 * np.pi * T_S * k / BEAT)
        told = friction * np.tanh(speed / 0.003) - 2.0 - hides
        velocity = (0.0, 0.0, float(speed))
        state, found = balance_step(state, (0.0, 0.0, float(told)), (0.0, 0.0, -2.0), velocity, UP, False, T_S)
        if found is not None:
            break
    assert found is reason
