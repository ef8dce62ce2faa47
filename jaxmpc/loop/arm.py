"""One sample of the closed loop on the arm: law, drives, robot and heart, one cell of a batch."""

from collections.abc import Iterable
from math import inf
from typing import Any, NamedTuple

from jaxmpc.law import force_control, identification, torque_limits
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.chain import Chain
from jaxmpc.law.force_control import Controller, ControllerState
from jaxmpc.law.gains import Gains
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import ZERO, Scalar, Vector
from jaxmpc.loop.linear import HIGHEST_ERROR, HIGHEST_FORCE
from jaxmpc.world import drive, robot
from jaxmpc.world.joint_acceleration import Accelerate
from jaxmpc.world.robot import Robot, RobotState, RobotStructure

AT_REST = 0.99
"""Gain from which on a guard counts as at rest [-]."""


class ArmSignals(NamedTuple):
    """What the arm meets, the same for every controller: at one sample, or as arrays (…, steps, …)."""

    heart: Any
    """The heart at the sample: position [m] and velocity [m/s], a `HeartSample` or (…, 2, 3)."""
    between: Any
    """The same where the integrator asks: as many as there are substeps, or (…, substeps, 2, 3)."""
    noise: Any
    """Per axis, or (…, 3) [N]."""
    force_ref: Any
    """Per axis what is wanted ahead, or (…, 3, ahead) [N]."""
    score: Any
    """Per axis, or (…, 3): 1 where a sample counts, else 0."""
    softening: Scalar
    """Factor on the tissue's stiffness [-]."""
    watch: Scalar
    """1 once contact must not be lost, else 0."""
    time: Scalar
    """[s]"""
    late: Any = None
    """Whether the sample is of the end of the run, where swinging is judged; None costs nothing and judges none."""
    wanted: Any = None
    """Wanted force of the sample itself where `force_ref` is of later ones, per axis or (…, 3); None where that is its
    first [N]."""

    @property
    def present(self) -> Any:
        """What is wanted at the sample itself, by which its force is judged, per axis [N]."""
        return tuple(ahead[0] for ahead in self.force_ref) if self.wanted is None else self.wanted


class ArmSample(NamedTuple):
    """What a recorded run keeps of one sample; vectors over X, Y, Z or J1–J4."""

    force: Any
    """Measured force [N]."""
    force_ref: Any
    """[N]"""
    u: Any
    """MPC output [N]."""
    v: Any
    """Command of the cascade [m/s²]."""
    a: Any
    """Acceleration asked of the tip [m/s²]."""
    p_hat: Any
    """Estimated disturbance [m/s²]."""
    tip: Any
    """Displacement of the tip from where it touched [m]."""
    q: Any
    """Joint angles [rad]."""
    torque: Any
    """Torques sent [N m]."""
    gain: Any = (1.0,)
    """Share of the loop's gain that the guard leaves [-]; 1 without one."""
    clamped: Any = (0.0,)
    """1 where a torque limit acted, else 0."""
    true_force: Any = (0.0, 0.0, 0.0)
    """Force on the tissue itself, without noise, rounding and filter of the sensor [N]."""
    wanted: Any = (0.0, 0.0, 0.0, 0.0)
    """Torques that the law wanted, before any limit [N m]."""
    stiffness: Any = (0.0, 0.0, 0.0)
    """K̂, what the tissue's stiffness is believed to be [N/m]; 0 without a schedule."""
    authority: Any = (0.0, 0.0, 0.0)
    """Share of the control that the schedule has [-]; 0 without one."""
    dither: Any = (0.0, 0.0, 0.0)
    """Sine that was added to the wanted force, by which the stiffness is found [N]; 0 without a schedule."""


class Trouble(NamedTuple):
    """When something happened first [s]; ∞ if it did not."""

    diverged: Any
    over_limit: Any
    """The measured force, Euclidean norm, left its limit or the residual of an axis `HIGHEST_ERROR`."""
    lost_contact: Any
    backed_off: Any
    """The guard took gain back, below `AT_REST`."""


class ArmCarry(NamedTuple):
    """State of the whole loop between two samples."""

    controller: ControllerState
    robot: RobotState
    a: Any
    """Accelerations asked at the last sample [m/s²]."""
    wanted: Any
    """Torques wanted there [N m]."""


class Cell(NamedTuple):
    """One controller on one tissue."""

    gains: Gains
    """Taken apart into scalars."""
    K2: Any
    robot: Robot


class ArmLoop(NamedTuple):
    """What the step is built from; hashable."""

    chain: Chain
    structure: RobotStructure
    accelerate: Accelerate
    """Joint accelerations, `jaxmpc.world.joint_acceleration.accelerate` or another way to them."""


def start(loop: ArmLoop, cell: Cell, ops: Ops) -> ArmCarry:
    """The loop at rest: the tip touches without force."""
    zero = 0.0 * cell.K2
    state = robot.init(loop.chain, loop.structure, cell.robot, zero, ops)
    resting = robot.encoders(loop.structure, cell.robot, state, ops)
    controller = force_control.init(controller_of(loop, cell), resting, (zero,) * 3, loop.structure.compensated)
    return ArmCarry(controller, state, (zero, zero, zero), state.pending[0])


def controller_of(loop: ArmLoop, cell: Cell) -> Controller:
    """The law's constants in one cell."""
    arm = cell.robot
    bandwidth = arm.momentum_bandwidth if loop.structure.observed else None
    return Controller(loop.chain, arm.nominal, arm.posture, cell.gains, cell.K2, arm.measurement, bandwidth)


def advance(
    loop: ArmLoop, cell: Cell, carry: ArmCarry, now: ArmSignals, ops: Ops, push: Vector = ZERO
) -> tuple[ArmCarry, ArmSample]:
    """One sample of the closed loop.

    Args:
        loop: Arm and structure.
        cell: Controller and constants.
        carry: State.
        now: What is met at this sample.
        ops: Scalar functions.
        push: See `force_control.step` [m/s²].
    """
    chain, structure = loop.chain, loop.structure
    tissue = cell.robot.tissue
    met = cell.robot._replace(tissue=tissue._replace(stiffness=tissue.stiffness * now.softening))
    force, true, q, tip, state = robot.sense(chain, structure, met, carry.robot, now.heart, now.noise, ops)
    law = controller_of(loop, cell)
    controller, command = force_control.step(law, carry.controller, q, force, now.force_ref, ops, push, now.wanted)
    wanted = command.torque.torque
    passed, clamped = torque_limits.limit(met.limits, wanted, state.pending[0], ops)
    controller = force_control.applied(controller, command, passed)
    sent = drive.send(met.drive, passed, ops)
    following = robot.move(chain, structure, met, state, sent, now.between, loop.accelerate, ops)
    gain = 1.0 + 0.0 * cell.K2 if controller.guard is None else controller.guard.memory.gain
    sample = ArmSample(
        force,
        now.force_ref,
        tuple(axis.u for axis in controller.axes),
        command.v,
        command.a,
        tuple(axis.p_hat for axis in controller.axes),
        tip,
        state.q,
        sent,
        (gain,),
        (clamped,),
        true,
        wanted,
        *_known(cell.gains, controller.axes, 0.0 * cell.K2, ops),
    )
    return ArmCarry(controller, following, command.a, wanted), sample


def _known(gains: Gains, axes: Iterable[AxisState], none: Scalar, ops: Ops) -> tuple[Any, Any, Any]:
    """Believed stiffness, authority of the schedule and its sine, per axis."""
    if gains.schedule is None:
        return (none,) * 3, (none,) * 3, (none,) * 3
    constants = gains.schedule.identification
    tissues = [axis.tissue for axis in axes if axis.tissue is not None]
    return (
        tuple(ops.exp(tissue.log_stiffness) for tissue in tissues),
        tuple(tissue.authority for tissue in tissues),
        tuple(identification.dither(constants, tissue) for tissue in tissues),
    )


def untroubled(like: Scalar) -> Trouble:
    """Nothing has happened yet; in the form of a finite number or batch."""
    never = 0.0 * like + inf
    return Trouble(never, never, never, never)


def noticed(trouble: Trouble, sample: ArmSample, now: ArmSignals, force_limit: Scalar, ops: Ops) -> Trouble:
    """What has happened first, this sample included."""
    x, y, z = sample.force
    error = _largest((y - wanted for y, wanted in zip(sample.force, now.present, strict=True)), ops)
    within = x * x + y * y + z * z < force_limit * force_limit
    over = ops.where(within, ops.where(error < HIGHEST_ERROR, inf, now.time), now.time)
    largest = _largest(sample.force, ops)
    indented = now.heart.position[2] - sample.tip[2]
    lost = ops.where(now.watch > 0.0, now.time, inf)
    return Trouble(
        # A comparison with what is no number is false.
        ops.minimum(trouble.diverged, ops.where(largest < HIGHEST_FORCE, inf, now.time)),
        ops.minimum(trouble.over_limit, over),
        ops.minimum(trouble.lost_contact, ops.where(indented < 0.0, lost, inf)),
        ops.minimum(trouble.backed_off, ops.where(sample.gain[0] < AT_REST, now.time, inf)),
    )


def _largest(values: Iterable[Scalar], ops: Ops) -> Scalar:
    x, y, z = map(abs, values)
    return ops.maximum(ops.maximum(x, y), z)
