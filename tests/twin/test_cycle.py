"""A cycle whose every torque is refused: it must end, and let go."""

from deploy.bus.bus import Bus
from deploy.loop.cycle import OperatorCommand
from deploy.loop.hazards import CycleTiming
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.reference.sources import ConstantForce
from deploy.safety.machine import OperatingState, SafetyState, Task
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact


def test_a_checker_that_refuses_everything_lets_go_within_the_cycle(monkeypatch):
    clock = LockstepClock(Twin(TwinSettings(motion=motion_named("none"))))
    options = Options(ConstantForce((0.0, 0.0, -5.0)), turns=False, tare=False)
    session = Session(arm_artifact(), Bus(LockstepBus(clock), clock.now), clock, options, lambda sentence: None)
    cycle, arm = session.cycle, session.arm
    cycle.safety_state = SafetyState(OperatingState.ARMED)
    clock.wait_until(clock.now() + 1_000_000)
    arm.request()
    reading = arm.collect(clock.now() + 500_000)
    monkeypatch.setattr(cycle.checker, "check", lambda *arguments: Reason.WORKSPACE)  # not a reason to let go by itself
    result = cycle.step(reading, CycleTiming(), OperatorCommand(True, True))
    assert result.task is Task.OFF
    assert result.safety_state.state is OperatingState.FAULT
    assert result.frame == arm.torque_frame((0.0, 0.0, 0.0, 0.0))
    arm.bus.close()
