"""A puck whose state nobody hears of any more is not driven on, though it tells its position."""

import pytest

from deploy.puck.codec import GROUPS
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.twin import Twin
from tests.twin.flying import fly

AT = 1.2
"""In contact [s]."""


@pytest.mark.parametrize("node", [1, 4])
def test_a_puck_that_does_not_tell_its_state_ends_the_run(plain, monkeypatch, node):
    take = Twin.take

    def without(twin, *args):
        untold = GROUPS["property"] | node << 5
        return [frame for frame in take(twin, *args) if twin.now < AT or frame.id != untold]

    monkeypatch.setattr(Twin, "take", without)
    flight = fly(plain, seconds=3.0)
    ended = flight.ended.safety_state
    assert (ended.state, ended.reason) == (OperatingState.FAULT, Reason.PUCK_FAULT)
    assert ended.detail == f"puck {node} does not tell its state"
    assert flight.detected(AT) <= 700
