"""An encoder of which most replies are lost ends the run, and the arm stands quietly until it has withdrawn."""

import pytest

from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from tests.twin.flying import fly

pytestmark = pytest.mark.oracle


@pytest.mark.parametrize("fault", ["J1:intermittent=0.8@1.5", "J2:lost=0.7@1.5"])
def test_what_stands_in_for_lost_replies_does_not_swing_the_arm(plain, fault):
    """A rate measured from what stood in doubled at every reply: joints came to 1.9 and 2.0 rad/s."""
    flight = fly(plain, fault, seconds=2.0, tissue="fung", seed=144)
    assert flight.reason is Reason.POSITION_OLD
    assert sum(now.state is OperatingState.FAULT and not now.let_go for now in flight.safety_states) > 100
    assert flight.fastest.max() < 0.35
