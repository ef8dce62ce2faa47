"""The arm in contact with the heart: what it senses at a sample, and how it moves until the next.

Scalar arithmetic like the law, so that simulation, oracle and twin run one source. Between two samples the torque
is held while friction, tissue and heart go on, in `substeps` equal steps h of

    leapfrog   q½ = q + h/2 q̇,  (M + h/2 D) q̈ = τ − f − Jᵀy − c − D q̇  at q½,  q̇' = q̇ + h q̈,  q' = q½ + h/2 q̇'
    Euler      the same with q½ = q and h D, q' = q + h q̇'   (MuJoCo's semi-implicit Euler, for parity)

with friction f, tissue force y, bias c, viscous friction D. With a cable mode the motors are bodies of their own,
tied to the links by a spring and a damper per joint; the encoders then see the motors.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxmpc.law import measurement
from jaxmpc.law.chain import Chain, inverse_dynamics, pose, with_point_mass
from jaxmpc.law.chain import tip as chain_tip
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.measurement import Measurement
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, add, apply, apply_transposed, scale, sub, times
from jaxmpc.law.torque_limits import TorqueLimits
from jaxmpc.world import drive, friction, sensor, tissue
from jaxmpc.world.drive import Drive
from jaxmpc.world.friction import Friction
from jaxmpc.world.joint_acceleration import Accelerate
from jaxmpc.world.sensor import SensorModel, SensorState
from jaxmpc.world.tissue import Tissue

_NONE = (0.0, 0.0, 0.0, 0.0)


class RobotStructure(NamedTuple):
    """What changes the program and not only its data."""

    tissue: str = "elastic"
    attached: bool = True
    """Whether the tip cannot leave the tissue, as in the paper."""
    cable: bool = False
    tool_inertia: bool = False
    """Whether the force sensor reads the inertia of a tool beyond it."""
    integrator: str = "leapfrog"
    substeps: int = 1
    compensated: bool = False
    """Whether the controller cancels friction from a model of it."""
    observed: bool = False
    """Whether it cancels what disturbs the joints' momentum."""


class Cable(NamedTuple):
    """Spring and damper between motor and link of each joint."""

    stiffness: Vector
    """[N m/rad]"""
    damping: Vector
    """[N m s/rad]"""


class Robot(NamedTuple):
    """The arm and what it touches; each scalar may be a batch."""

    measurement: Measurement
    """How the controller makes velocities of the encoders' angles."""
    drive: Drive
    limits: TorqueLimits
    """What of the wanted torques reaches the drives."""
    friction: Friction
    viscous: Vector
    """Viscous friction of the joints [N m s/rad]."""
    cable: Cable
    tool_mass: Scalar
    """Point mass at the tip beyond the MJCF's tool [kg]."""
    sensor: SensorModel
    tissue: Tissue
    nominal: Nominal
    momentum_bandwidth: Scalar
    """Bandwidth of the controller's observer of the joints' momentum, where there is one [rad/s]."""
    posture: Vector
    """Joint angles at the start and of the null space [rad]."""
    touch: Vector
    """Tip position there: where the heart's surface lies when it rests [m]."""
    extra_delay: Scalar
    """0 for a delay of one sample, 1 for two."""


class HeartSample(NamedTuple):
    """The heart's surface at an instant."""

    position: Vector
    """Displacement [m]."""
    velocity: Vector
    """[m/s]"""


class RobotState(NamedTuple):
    """What the world remembers between two samples."""

    q: Vector
    """Joint angles of the links [rad]."""
    qd: Vector
    """[rad/s]"""
    motor: Any
    """Angles and velocities of the motors, in joint coordinates, with a cable mode; else ()."""
    bristles: Vector
    """Presliding of the joint friction, normalised [-]."""
    tissue: Any
    sensor: SensorState
    pending: tuple[Vector, Vector]
    """Torques of the last two samples, newest first [N m]."""


def with_cutoff(robot: Robot, cutoff: Scalar | None, ops: Ops) -> Robot:
    """The same under a controller with its own low-pass of the velocity [rad/s]; None leaves it as it is."""
    return robot._replace(measurement=measurement.with_cutoff(robot.measurement, cutoff, ops))


def init(chain: Chain, kind: RobotStructure, robot: Robot, like: Scalar, ops: Ops) -> RobotState:
    """The arm at rest in its posture, held against gravity, touching without force; numbers in the form of `like`."""
    zero = 0.0 * like
    four = (zero,) * 4
    loaded = with_point_mass(chain, robot.tool_mass)
    held = add(inverse_dynamics(loaded, pose(loaded, robot.posture, ops), _NONE, _NONE), four)
    motor: Any = ()
    if kind.cable:
        wound = tuple(torque / spring for torque, spring in zip(held, robot.cable.stiffness, strict=True))
        motor = (add(robot.posture, wound), four)
    return RobotState(
        add(robot.posture, four),
        four,
        motor,
        friction.init(zero),
        tissue.init(kind.tissue, kind.attached, zero),
        sensor.init(kind.tool_inertia, zero),
        (held, held),
    )


def sense(
    chain: Chain, kind: RobotStructure, robot: Robot, state: RobotState, heart: HeartSample, noise: Vector, ops: Ops
) -> tuple[Vector, Vector, Vector, Vector, RobotState]:
    """What the controller reads at a sample.

    Args:
        chain: The arm.
        kind: Structure of the world.
        robot: Its constants.
        state: At the sample.
        heart: At the sample.
        noise: Of the force sensor [N].
        ops: Scalar functions.

    Returns:
        Measured force on the tissue [N], the true one [N], joint angles that the encoders read [rad], tip displacement
        from where it touched [m], and the state with the sensor's filter moved on.
    """
    at_tip = chain_tip(chain, pose(chain, state.q, ops))
    tip, velocity = sub(at_tip.position, robot.touch), apply(at_tip.jacobian, state.qd)
    true = tissue.force(
        kind.tissue,
        kind.attached,
        robot.tissue,
        state.tissue,
        sub(tip, heart.position),
        sub(velocity, heart.velocity),
        ops,
    )
    measured, moved_on = sensor.read(robot.sensor, state.sensor, true, velocity, noise, robot.measurement.T_s, ops)
    return measured, true, encoders(kind, robot, state, ops), tip, state._replace(sensor=moved_on)


def encoders(kind: RobotStructure, robot: Robot, state: RobotState, ops: Ops) -> Vector:
    """Joint angles that the encoders read, at the motors [rad]."""
    read = drive.read(robot.drive, state.motor[0] if kind.cable else state.q, ops)
    return tuple(map(ops.near, read, state.q))


def move(
    chain: Chain,
    kind: RobotStructure,
    robot: Robot,
    state: RobotState,
    torque: Vector,
    hearts: Sequence[HeartSample],
    advance: Accelerate,
    ops: Ops,
) -> RobotState:
    """Take torques sent at this sample and advance to the next.

    Args:
        chain: The arm.
        kind: Structure of the world.
        robot: Its constants.
        state: That `sense` returned.
        torque: Joint torques sent now; they act one or two samples later [N m].
        hearts: The heart where each substep asks for it: its middle with leapfrog, its start with Euler.
        advance: Joint accelerations, `joint_acceleration.accelerate` or another way to them.
        ops: Scalar functions.
    """
    newest, older = state.pending
    acting = tuple(new + robot.extra_delay * (old - new) for new, old in zip(newest, older, strict=True))
    for heart in hearts:
        state = _substep(chain, kind, robot, state, acting, heart, advance, ops)
    return state._replace(pending=(torque, newest))


def _substep(
    chain: Chain,
    kind: RobotStructure,
    robot: Robot,
    state: RobotState,
    torque: Vector,
    heart: HeartSample,
    advance: Accelerate,
    ops: Ops,
) -> RobotState:
    h = robot.measurement.T_s / kind.substeps
    leapfrog = kind.integrator == "leapfrog"
    lead = 0.5 * h if leapfrog else 0.0
    share = 0.5 * h if leapfrog else h
    q, qd = state.q, state.qd
    at = tuple(map(ops.near, add(q, scale(lead, qd)), q))
    at_tip = chain_tip(chain, pose(chain, at, ops))
    d = sub(sub(at_tip.position, robot.touch), heart.position)
    ddot = sub(apply(at_tip.jacobian, qd), heart.velocity)
    y = tissue.force(kind.tissue, kind.attached, robot.tissue, state.tissue, d, ddot, ops)
    relaxed = tissue.relax(kind.tissue, kind.attached, robot.tissue, state.tissue, d, ddot, h, ops)
    loaded = sub(_NONE, apply_transposed(at_tip.jacobian, y))

    moving = state.motor[1] if kind.cable else qd
    bristles, rubbing = friction.step(robot.friction, state.bristles, moving, h, ops)
    driven = sub(torque, rubbing)
    motor: Any = ()
    if kind.cable:
        theta, thetad = state.motor
        wound = add(theta, scale(lead, thetad))
        spring = add(
            tuple(map(times, robot.cable.stiffness, sub(wound, at))),
            tuple(map(times, robot.cable.damping, sub(thetad, qd))),
        )
        links = chain._replace(armature=_NONE)
        qdd = advance(links, at, qd, add(loaded, spring), robot.tool_mass, _NONE, share, ops)
        rest = sub(sub(driven, spring), tuple(map(times, robot.viscous, thetad)))
        inertia = add(chain.armature, scale(share, robot.viscous))
        thetad = add(thetad, scale(h, tuple(x / A for x, A in zip(rest, inertia, strict=True))))
        motor = (add(wound, scale(h - lead, thetad)), thetad)
    else:
        qdd = advance(chain, at, qd, add(driven, loaded), robot.tool_mass, robot.viscous, share, ops)
    qd = add(qd, scale(h, qdd))
    return state._replace(q=add(at, scale(h - lead, qd)), qd=qd, motor=motor, bristles=bristles, tissue=relaxed)
