"""A cycle whose every torque is refused: it must end, and let go."""

from deploy.bus import Bus
from deploy.cycle import Timing, Wishes
from deploy.reference import Constant
from deploy.safety.machine import Situation, State, Task
from deploy.safety.reasons import Reason
from deploy.session import Options, Session
from deploy.twin.lockstep import Clock, LockstepBus
from deploy.twin.settings import Settings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact


def test_a_checker_that_refuses_everything_lets_go_within_the_cycle(monkeypatch):
    clock = Clock(Twin(Settings(rhythm="none")))
    options = Options(Constant((0.0, 0.0, -5.0)), turns=False, tare=False)
    session = Session(arm_artifact(), Bus(LockstepBus(clock), clock.now), clock, options, lambda sentence: None)
    cycle, arm = session.cycle, session.arm
    cycle.situation = Situation(State.ARMED)
    clock.wait_until(clock.now() + 1_000_000)
    arm.request()
    reading = arm.collect(clock.now() + 500_000)
    monkeypatch.setattr(cycle.checker, "check", lambda *arguments: Reason.WORKSPACE)  # not a reason to let go by itself
    done = cycle.step(reading, Timing(), Wishes(True, True))
    assert done.task is Task.OFF
    assert done.situation.state is State.FAULT
    assert done.frame == arm.torque_frame((0.0, 0.0, 0.0, 0.0))
    arm.bus.close()
