"""State machine of the arm: states, the one way up, the many ways down.

    IDLE → ARMED → APPROACH → CONTACT → RETRACT → STOPPED
      IDLE → STOPPED, any of them → FAULT

A safety state only ever moves along these arrows. RETRACT, STOPPED and FAULT never lead back: whoever wants to go on
starts anew, with arming and the pendant. Each way down carries its reason; nothing here raises. Every state looks at
every hazard and at the operator, and none lasts for ever: IDLE and ARMED have their patience, APPROACH and RETRACT end
by how far they have asked the tip to go, CONTACT by the run's duration.
"""

from enum import StrEnum
from typing import NamedTuple

from deploy.durations import cycles
from deploy.safety.reasons import Reason

BRIDGED = 2
"""Age of a position up to which it still controls, extrapolated [cycles]: samples that the law steps over, however long
they last."""
HELD = 0.02
"""Age up to which gravity is still compensated at the last positions [s]; beyond it the arm is let go."""
IDLE_PATIENCE = 0.5
"""Time in IDLE after which no arming is to be hoped for [s]: a healthy arm tells all its positions at once."""
ARMED_PATIENCE = 600.0
"""Time for which the pendant and the operator are waited for [s]."""
CONTACT_CYCLES = 3
"""Cycles in a row above the contact threshold that make a contact: noise, which is new in each, passes it in one."""
BRAKES = frozenset(
    {
        *(Reason.JOINT_VELOCITY, Reason.TIP_VELOCITY, Reason.ELBOW_VELOCITY, Reason.WORKSPACE),
        *(Reason.POSITION_OLD, Reason.LATE),
    }
)
"""Faults after which an arm that was on its way to the tissue brakes and withdraws while its positions are fresh, or
once they are again: one that only bears its weight coasts on into the tissue, with 29 N where braking leaves 9 N (a
force 20 ms old, on a stiffening tissue), and waits there for the heart: 10 N, and 28 N when it is let go at last."""


class OperatingState(StrEnum):
    """State in which the arm is driven."""

    IDLE = "idle"
    ARMED = "armed"
    APPROACH = "approach"
    CONTACT = "contact"
    RETRACT = "retract"
    STOPPED = "stopped"
    FAULT = "fault"


class Patience(NamedTuple):
    """What is waited for, in cycles of a controller."""

    held: int
    """Age of positions up to which the arm's weight is borne."""
    idle: int
    armed: int


def patience(T_s: float) -> Patience:
    """How long is waited.

    Args:
        T_s: Time between two cycles [s].
    """
    return Patience(cycles(HELD, T_s, BRIDGED), cycles(IDLE_PATIENCE, T_s), cycles(ARMED_PATIENCE, T_s))


class Task(StrEnum):
    """Purpose of the torques of a cycle."""

    OFF = "off"
    """None; the pucks are sent to idle."""
    GRAVITY = "gravity"
    """Only hold the arm's weight at the last known angles."""
    HOLD = "hold"
    APPROACH = "approach"
    CONTROL = "control"
    RETRACT = "retract"


class Observations(NamedTuple):
    """Observations of a cycle that may change the safety state."""

    hazard: Reason = Reason.NONE
    """The arm cannot or must not be driven: e-stop, pendant, puck, bus, a stall, a refused frame."""
    position_age: int = 0
    """Age of the oldest position [cycles]."""
    danger: Reason = Reason.NONE
    """The arm is beyond a limit: holding it is still right, moving on is not."""
    doubt: Reason = Reason.NONE
    """The force cannot be trusted or is too high, or the computer is late: contact must end."""
    detail: str = ""
    """Detail, as the joint whose position is missing."""
    active: bool = False
    """The pendant has activated the pucks."""
    touching: bool = False
    """The force is above the contact threshold."""
    travelled: bool = False
    """The approach or the retraction has gone as far as it may."""
    armed: bool = True
    """The operator has armed."""
    start: bool = True
    """The operator lets the approach begin."""
    finish: Reason = Reason.NONE
    """The operator, or the end of the experiment, asks to stop."""
    abort: bool = False
    """The operator asks again: the arm is let go at once, wherever it is."""


class SafetyState(NamedTuple):
    """Operating state of the arm, the cycles spent in it, and the reason for it."""

    state: OperatingState = OperatingState.IDLE
    reason: Reason = Reason.NONE
    detail: str = ""
    cycles: int = 0
    """Cycles spent in this state."""
    contact_cycles: int = 0
    """Cycles in a row, up to now, with a force above the contact threshold."""
    let_go: bool = False
    """Whether the arm has been let go, once and for all."""
    near: bool = False
    """Whether it had been on its way to the tissue before this state: else there is nothing to withdraw from."""

    @property
    def over(self) -> bool:
        """Whether the state is final."""
        return self.state in _FINAL


_FINAL = (OperatingState.STOPPED, OperatingState.FAULT)
_NEAR = (OperatingState.APPROACH, OperatingState.CONTACT, OperatingState.RETRACT)

_TASKS = {
    OperatingState.IDLE: Task.OFF,
    OperatingState.ARMED: Task.HOLD,
    OperatingState.APPROACH: Task.APPROACH,
    OperatingState.CONTACT: Task.CONTROL,
    OperatingState.RETRACT: Task.RETRACT,
    OperatingState.STOPPED: Task.HOLD,
    OperatingState.FAULT: Task.GRAVITY,
}

_SILENCING = frozenset({Reason.E_STOP, Reason.BUS_OFF, Reason.BUS_ERROR, Reason.STALLED})
"""Why pucks fall silent, where it is told after they did: a likelier cause than that all were lost."""
_REFUSED = frozenset({Reason.ENCODER_JUMP, Reason.ENCODER_STUCK})
"""Why positions that came are not believed, and grow old as if they had not come."""
_ASKED = frozenset({Reason.FINISHED, Reason.OPERATOR})
"""Why a run ends that went well."""
_UNHURT = frozenset({Reason.FINISHED, Reason.OPERATOR, Reason.OVERSHOOT, Reason.NO_CONTACT})
"""Why the arm withdraws though no limit was passed."""


def step(now: SafetyState, observed: Observations, waits: Patience) -> SafetyState:
    """The safety state after a cycle.

    Args:
        now: State after the last cycle.
        observed: Observations of this cycle; the gravest decides.
        waits: How long is waited.
    """
    state, reason = _next(now, observed, waits)
    # Undriven so far, the arm is not taken up for the way out.
    let_go = now.let_go or reason.lets_go or observed.abort or (now.state is OperatingState.IDLE and state in _FINAL)
    let_go = let_go or observed.position_age > waits.held
    if state is now.state and reason is now.reason:
        contact_cycles = now.contact_cycles + 1 if observed.touching else 0
        again = observed.hazard is reason is Reason.POSITION_LOST and observed.detail
        detail = observed.detail if again else now.detail  # who else is silent shows only after some cycles
        return now._replace(detail=detail, cycles=now.cycles + 1, contact_cycles=contact_cycles, let_go=let_go)
    detail = now.detail if reason is now.reason else observed.detail
    return SafetyState(state, reason, detail, let_go=let_go, near=now.near or now.state in _NEAR)


def task_of(now: SafetyState, position_age: int, waits: Patience) -> Task:
    """Task in a safety state with positions of this age [cycles]."""
    if now.let_go or position_age > waits.held:
        return Task.OFF
    task = _TASKS[now.state]
    if now.state is OperatingState.FAULT and now.near and now.reason in BRAKES:
        task = Task.RETRACT
    return Task.GRAVITY if position_age > BRIDGED and task is not Task.OFF else task


def _next(now: SafetyState, observed: Observations, waits: Patience) -> tuple[OperatingState, Reason]:
    state, reason = now.state, now.reason
    found = _gravest(observed, waits.held)
    if state is OperatingState.FAULT:
        if reason is Reason.POSITION_LOST:  # what it was shows only now
            if observed.hazard in _SILENCING:
                return state, observed.hazard
            if observed.danger is Reason.LATE:
                return state, Reason.LATE
        if found is Reason.POSITION_LOST and observed.danger is reason and reason in _REFUSED:
            return state, reason  # that encoder goes on, and is why there are no positions to hold the arm by
        # Only what lets the arm go may replace a reason to hold it.
        return (state, found) if found.lets_go and not now.let_go else (state, reason)
    if state is OperatingState.STOPPED and now.let_go:
        return state, reason  # that the arm then idles is what was ordered
    if found is not Reason.NONE:
        return OperatingState.FAULT, found
    if observed.abort and state is not OperatingState.STOPPED:
        return OperatingState.FAULT, Reason.OPERATOR
    leave = observed.doubt if observed.doubt is not Reason.NONE else observed.finish
    if state in (OperatingState.IDLE, OperatingState.ARMED):
        waited = waits.idle if state is OperatingState.IDLE else waits.armed
        if leave is Reason.NONE and now.cycles + 1 >= waited:
            leave = Reason.NOT_STARTED
        if leave is not Reason.NONE:
            return OperatingState.STOPPED, leave
    if state is OperatingState.IDLE:
        ready = observed.armed and observed.position_age == 0
        return (OperatingState.ARMED if ready else state), reason
    if state is OperatingState.ARMED:
        if not (observed.active and observed.start):
            return state, reason
        if not observed.touching:
            return OperatingState.APPROACH, reason
        # Taken for the tissue, a wrong zero would have the law look for it, in the air and as fast as it may.
        return (OperatingState.STOPPED, Reason.TARE) if now.contact_cycles + 1 >= CONTACT_CYCLES else (state, reason)
    if state in (OperatingState.APPROACH, OperatingState.CONTACT) and leave is not Reason.NONE:
        return OperatingState.RETRACT, leave
    if state is OperatingState.APPROACH:
        if observed.touching and now.contact_cycles + 1 >= CONTACT_CYCLES:
            return OperatingState.CONTACT, reason
        return (OperatingState.RETRACT, Reason.NO_CONTACT) if observed.travelled else (state, reason)
    if state is OperatingState.RETRACT and reason in _UNHURT and observed.doubt is Reason.FORCE:
        return state, Reason.FORCE  # a beat met the tip on its way out
    if state is OperatingState.RETRACT and reason in _ASKED and observed.finish is Reason.OVERSHOOT:
        return state, Reason.OVERSHOOT  # the same, below the limit
    if state is OperatingState.RETRACT and observed.travelled:
        return OperatingState.STOPPED, reason
    return state, reason


def _gravest(observed: Observations, held: int) -> Reason:
    """Gravest reason for a fault, NONE if there is none."""
    if observed.hazard is not Reason.NONE:
        return observed.hazard
    if observed.position_age > held:
        return Reason.POSITION_LOST
    if observed.danger is Reason.NONE and observed.position_age > BRIDGED:
        return Reason.POSITION_OLD
    return observed.danger
