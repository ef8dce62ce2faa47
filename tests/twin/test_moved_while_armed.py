"""Whoever moves an armed arm whose pucks do not follow yet finds it held where he let it go, not pulled back."""

import math

import pytest

from deploy.bus.bus import Bus
from deploy.loop.cycle import OperatorCommand
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.reference.segments import from_words
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from deploy.twin.world import _raised

GAP = 0.02
MOVED, ACTIVATED, ENDED = 20, 2500, 3500
"""Cycles at which it is moved, within a second, activated, and let go."""


@pytest.mark.parametrize("lift", [0.0, 0.001, 0.06, -0.015])
def test_activation_holds_the_arm_where_it_is(plain, lift):
    twin = Twin(TwinSettings(gap=GAP, motion=motion_named("none")))
    seen = []
    clock = LockstepClock(twin, lambda now: seen.append(now.truth()))
    bus = Bus(LockstepBus(clock), clock.now)
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False)
    session = Session(plain, bus, clock, options, lambda sentence: None)
    cycles, since = 0, 0

    def each(result):
        nonlocal cycles, since
        cycles += 1
        if cycles == MOVED:
            twin.carry(_raised(twin.settings.posture, GAP + lift), 1.0)
        if cycles == ACTIVATED:
            assert result.safety_state.state is OperatingState.ARMED
            since = len(seen)
            twin.press("activate")
        return OperatorCommand(True, False, Reason.FINISHED if cycles > ENDED else Reason.NONE, cycles > ENDED + 20)

    session.run(OperatorCommand(True, False), None, each)
    bus.close()
    held = seen[since : since + ENDED - ACTIVATED]
    # 2 mm and 0.05 m/s are gravity's error, which the servo's integral has yet to take up.
    assert max(math.dist(each.tip, held[0].tip) for each in held) < 0.005
    assert max(math.hypot(*each.tip_velocity) for each in held) < 0.1
