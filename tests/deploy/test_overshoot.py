"""A run that has pressed much more than was wanted does not end `finished`."""

import math

import pytest

from deploy.safety.overshoot import LEAST, Pushes, pushed


def after(*samples):
    pushes = Pushes()
    for wanted, measured in samples:
        pushes = pushed(pushes, wanted, measured)
    return pushes


@pytest.mark.parametrize(("wanted", "most"), [(5.0, 6.0), (2.0, 2.0 + LEAST), (0.5, 0.5 + LEAST)])
def test_a_fifth_more_but_at_least_half_a_newton(wanted, most):
    assert not after((wanted, most)).beyond(1.2)
    assert after((wanted, math.nextafter(most, math.inf))).beyond(1.2)


def test_the_largest_of_either_counts_whenever_it_was():
    assert not after((5.0, 5.0), (1.0, 5.5)).beyond(1.2)
    assert after((1.0, 6.5), (5.0, 5.0)).beyond(1.2)


def test_pulls_count_for_nothing():
    assert not after((5.0, -20.0)).beyond(1.2)


def test_a_limit_may_allow_more():
    assert not after((5.0, 7.0)).beyond(1.5)
