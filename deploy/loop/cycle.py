"""One control cycle: from the measurements on the bus to the one torque frame that may be sent.

    reading ─► angles, force ─► plausible? ─► machine ─► task ─► torque ─► clamp ─► frame ─► checker ─► bus

Nothing here waits, and nothing raises for what a robot may do. What the checker refuses is a reason like any other: the
machine takes it, and the cycle ends with the frame of the task that is then allowed.
"""

from collections.abc import Callable
from math import dist, inf, isfinite
from typing import NamedTuple

from deploy.controller.limits import Limits
from deploy.force.sensor import BAD_DATA, SATURATED
from deploy.loop.control import TaskController
from deploy.loop.force_watch import ForceSample, ForceWatch
from deploy.loop.hazards import CycleTiming, Hazards
from deploy.loop.positions import Positions
from deploy.puck.frame import Frame
from deploy.safety import machine
from deploy.safety.checker import Checker, Strictness
from deploy.safety.clamp import NOTHING, Clamp, bounds, clamp
from deploy.safety.force_estimate import ForceEstimate
from deploy.safety.machine import Observations, OperatingState, SafetyState, Task
from deploy.safety.overshoot import Pushes, pushed
from deploy.safety.plausible import ForceState, force_step
from deploy.safety.posture import displaced
from deploy.safety.reasons import Reason
from deploy.safety.swing import FAST, SwingState, swing_step
from deploy.wam.arm import WamArm
from deploy.wam.reading import Reading
from deploy.wam.tip_pose import TipKinematics
from jaxmpc.law.vectors import Vector3, Vector4

ZERO: Vector4 = (0.0, 0.0, 0.0, 0.0)
SETTLED = 0.5
"""Time in contact [s] after which the observers' innovation judges the sensor, and the push an end by the operator."""
ASTRAY = 2.0
"""How far the force in contact never is from that which is wanted [N]: premature beats bring it to 1.4 N, a sensor with
a wrong sign passes it within some milliseconds."""
JOINTS = ("J1", "J2 and J3 (motor 2)", "J2 and J3 (motor 3)", "J4")
_SERVED = (Task.APPROACH, Task.RETRACT, Task.HOLD)
_WAY_OUT = (OperatingState.RETRACT, OperatingState.STOPPED)
_WELL = (Reason.FINISHED, Reason.OPERATOR)
_STRICTNESS = {task: Strictness.SAFE for task in Task} | {
    Task.OFF: Strictness.OFF,
    Task.APPROACH: Strictness.CONTROL,
    Task.CONTROL: Strictness.CONTROL,
}


class OperatorCommand(NamedTuple):
    """Command of the operator in a cycle."""

    armed: bool = False
    start: bool = False
    finish: Reason = Reason.NONE
    abort: bool = False
    """Let go at once, wherever the arm is."""


class CycleResult(NamedTuple):
    """Result of a control cycle; angles and forces are those that were used."""

    frame: Frame
    safety_state: SafetyState
    task: Task
    clamp: Clamp
    q: Vector4
    qd: Vector4
    kinematics: TipKinematics
    force: Vector3 | None
    """Measured force on the tissue, in the world's axes [N]."""
    wanted: Vector4
    """Joint torques before the clamp [N m]."""
    applied: Vector4
    """Joint torques after the clamp [N m]."""


class Cycle:
    """Runs the control cycle of the robot, apart from its timing.

    Attributes:
        positions: What is believed of the encoders.
        watch: What is known of the force sensor's truth.
        pushes: The largest in contact and on the way out.
    """

    def __init__(
        self,
        arm: WamArm,
        controller: TaskController,
        limits: Limits,
        T_s: float,
        tool_length: float,
        tip_kinematics: Callable[[Vector4, Vector4], TipKinematics],
        turns: bool = True,
        hook: Callable[[Vector3], Vector3] | None = None,
        estimate: ForceEstimate | None = None,
        deepest: float = inf,
        posture: Vector4 | None = None,
    ) -> None:
        """Assemble the cycle before motion.

        Args:
            arm: Started.
            controller: Not yet in contact.
            limits: What may not be exceeded.
            T_s: Sampling time [s].
            tool_length: From the elbow's frame to the tip [m].
            tip_kinematics: Motion of tip and tool, as `deploy.wam.tip_pose.tip_kinematics` makes it.
            turns: Whether the force sensor turns with the tool; else it keeps its direction in the world.
            hook: What becomes of a measured force on its way, to inject faults that no CAN frame can hold.
            estimate: The force as the motors tell it; None leaves the sensor's scale and sign unchecked.
            deepest: Travel in contact beyond which the softest promised tissue gives more than the limit [m].
            posture: Joint angles that the controller was made for [rad]; None lets the approach begin anywhere.

        Raises:
            InputError: The pucks, or the limits, are not fit for this.
        """
        pucks = arm.pucks
        self.arm, self.controller, self.limits = arm, controller, limits
        self.safety_state, self._waits = SafetyState(), machine.patience(T_s)
        self.checker = Checker(limits, T_s, pucks.ipnm, (1, 2, 3, 4), tool_length, pucks.number("T"))
        self._bounds = bounds(limits, T_s, pucks.ipnm)
        self._turns, self._hook, self._tip_kinematics, self._posture = turns, hook, tip_kinematics, posture
        self._task, self._force_state = Task.OFF, ForceState()
        self._saturated: int | None = None  # flags of gauges stay set: those of the first reading are of the past
        self.watch = ForceWatch(controller, estimate, deepest, T_s)
        self.positions = Positions(arm, T_s, controller.runtime.velocity)
        self._hazards, self.pushes = Hazards(arm, T_s), Pushes()
        self._swing, self._speeding, self._T_s, self._lied = SwingState(), SwingState(), T_s, False
        controller.runtime.start(self.positions.q)

    def step(self, reading: Reading, timing: CycleTiming, command: OperatorCommand) -> CycleResult:
        """Decide the frame of a cycle.

        Args:
            reading: Measurements of this cycle.
            timing: Timing of this cycle.
            command: Command of the operator.
        """
        runtime = self.controller.runtime
        danger, age, oldest = self.positions.take(reading, timing.missed)
        q = self.positions.q
        qd = runtime.velocity(q) if age <= machine.BRIDGED else ZERO
        kinematics = self._tip_kinematics(q, qd)
        force, doubt = self._force(reading, kinematics)
        driven = self._hazards.active and age <= machine.BRIDGED
        sample = ForceSample(q, qd, kinematics, force, self.checker.torque)
        lying = self.watch.judge(self.safety_state.state, sample, driven, timing.missed > 0)
        if doubt is Reason.NONE:
            doubt = lying
        self.positions.weigh(self.safety_state, self._task, self.watch, None if self._lied else force)
        hazard, detail = self._hazards.judge(reading, timing, min(self.positions.age))
        if timing.missed > machine.BRIDGED or (age > machine.BRIDGED and self._hazards.lately):
            danger = Reason.LATE
        if timing.late:
            doubt = Reason.LATE
        if hazard is Reason.NONE and (age > machine.BRIDGED or danger is not Reason.NONE):
            detail = JOINTS[oldest]
        state = self.safety_state.state
        task, T_s = machine.task_of(self.safety_state, 0, self._waits), self._T_s
        served, held = task in _SERVED, task is Task.HOLD
        self._swing, swings = swing_step(self._swing, served, driven, qd, FAST, T_s, held)
        watched, most = served and state is not OperatingState.ARMED, self.limits.joint_velocity
        self._speeding, speeding = swing_step(self._speeding, watched, driven, qd, most, T_s, held=False)
        if swings:
            self.controller.soften()  # who is but beyond a low limit needs the bandwidth, to lift the tip
        # Of an arm that withdraws for another reason, that one stays told.
        told = state not in _WAY_OUT or self.safety_state.reason in _WELL
        if (swings or speeding) and told and hazard is Reason.NONE and danger is Reason.NONE:
            fastest = max(range(4), key=lambda i: abs(qd[i]))
            danger, detail = Reason.JOINT_VELOCITY, f"J{1 + fastest}{' swings' if swings else ''}"
        if state is OperatingState.ARMED and self._posture is not None and (where := displaced(q, self._posture)):
            doubt, detail = Reason.POSTURE, detail or where
        if state in (OperatingState.CONTACT, OperatingState.RETRACT) and force is not None:
            push = self.controller.push
            asked = push(self.controller.force_ref) + push(runtime.dither)
            self.pushes = pushed(self.pushes, asked, push(force))
        # Who ends it says nothing of how hard the tip has pressed; a contact that was hardly made, neither.
        ended = command.finish is Reason.FINISHED
        ended = ended or (command.finish is Reason.OPERATOR and self.controller.contact_time > SETTLED)
        if ended and self.pushes.beyond(self.limits.overshoot):
            command = command._replace(finish=Reason.OVERSHOOT)
        observed = Observations(
            hazard,
            age,
            danger,
            doubt,
            detail,
            self._hazards.active,
            self.controller.touching(force),
            self.controller.travelled(kinematics.tip),
            *command,
        )
        self.safety_state = machine.step(self.safety_state, observed, self._waits)
        return self._send(q, qd, kinematics, force, age)

    def _send(self, q: Vector4, qd: Vector4, kinematics: TipKinematics, force: Vector3 | None, age: int) -> CycleResult:
        """Result with the frame of the task, or of the lesser task that a refusal leads to."""
        while True:
            task = machine.task_of(self.safety_state, age, self._waits)
            self._lied = self._lied or self.safety_state.reason is Reason.FORCE_MODEL
            if self._lied:
                force = None  # what was found to lie must not be made good by torque, whatever comes after
            wanted = self.controller.torque(
                task, q, qd, kinematics.tip, kinematics.velocity, force, self._hazards.active
            )
            applied, acted = (ZERO, NOTHING) if task is Task.OFF else clamp(wanted, self.checker.torque, self._bounds)
            frame = self.arm.torque_frame(applied)
            drive = task is not Task.OFF
            refusal = self.checker.check(frame, drive, _STRICTNESS[task], q, qd, force, age)
            if refusal is None or not drive:
                break
            refused = Observations(hazard=refusal) if refusal.lets_go else Observations(danger=refusal)
            self.safety_state = machine.step(self.safety_state, refused, self._waits)
            if machine.task_of(self.safety_state, age, self._waits) is task:
                self.safety_state = SafetyState(
                    OperatingState.FAULT, Reason.STATE, f"{task} was refused: {refusal}", let_go=True
                )
        if task is Task.CONTROL:
            self.controller.runtime.applied(applied)
        self._task = task
        return CycleResult(frame, self.safety_state, task, acted, q, qd, kinematics, force, wanted, applied)

    def _force(self, reading: Reading, kinematics: TipKinematics) -> tuple[Vector3 | None, Reason]:
        """Force on the tissue in the world's axes [N], and the reason to distrust it."""
        raw, flags = reading.force, reading.force_flags
        if raw is not None and self._saturated is None:
            self._saturated = flags & SATURATED
        if flags & BAD_DATA:
            raw = None
        if raw is not None and self._hook is not None:
            raw = self._hook(raw)
        controller, innovation = self.controller, None
        contact = self.safety_state.state is OperatingState.CONTACT and controller.contact_time > SETTLED
        turned = kinematics.turned(raw) if raw is not None and self._turns else raw
        if contact and turned is not None and isfinite(sum(turned)):
            x, y, z = controller.runtime.prediction
            innovation = turned[0] - x, turned[1] - y, turned[2] - z
        self._force_state, reason = force_step(self._force_state, raw, innovation)
        if reason is not None:
            return None, reason
        if flags & SATURATED & ~(self._saturated or 0):
            return None, Reason.FORCE_RANGE
        if turned is None:
            return None, Reason.NONE
        x, y, z = turned
        if x * x + y * y + z * z > self.limits.force**2:
            return turned, Reason.FORCE
        astray = self.safety_state.state is OperatingState.CONTACT and dist(turned, controller.force_ref) > ASTRAY
        return turned, Reason.FORCE_MODEL if astray else Reason.NONE
