"""Who lets the arm go sends the pucks to idle in that very cycle: zero torque alone lets it fall, unbraked."""

from deploy.loop.cycle import OperatorCommand
from deploy.safety.machine import OperatingState, Task
from deploy.safety.reasons import Reason
from deploy.twin.flight import started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.scenario import twin_settings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact


def undriven(until, *faults):
    """Cycles without torque after which no puck drives any more, and why the run ended.

    Args:
        until: The operator's command after a cycle, from its safety state.
        *faults: Of the twin.
    """
    twin = Twin(twin_settings(gap=0.0003, rhythm="none", faults=faults))
    session, bus = started(arm_artifact(), LockstepClock(twin), "0,0,-1@5", 5.0, tare=False)
    driving = []

    def each(result):
        now = result.safety_state
        if result.task is Task.OFF and now.state is not OperatingState.IDLE:
            driving.append(any(puck.driving for puck in twin.pucks))
        if now.state is OperatingState.ARMED and now.cycles == 50:
            twin.press("activate")
        return until(now)

    ended = session.run(OperatorCommand(True, True), None, each)
    bus.close()
    assert driving, "it was held to the end"
    return driving.index(False), ended.safety_state.reason


def test_a_second_ctrl_c_while_the_arm_is_held_after_its_retraction():
    def until(now):
        if now.state in (OperatingState.IDLE, OperatingState.ARMED, OperatingState.APPROACH):
            return OperatorCommand(True, True)
        return OperatorCommand(True, True, Reason.OPERATOR, now.state is OperatingState.STOPPED and now.cycles >= 3)

    assert undriven(until) == (0, Reason.OPERATOR)


def test_an_encoder_that_goes_on_leaping():
    """Its reason is older than the letting go, and stays."""
    assert undriven(lambda now: OperatorCommand(True, True), "J4:wrong=120@0.605") == (0, Reason.ENCODER_JUMP)
