"""The closed loop of the whole arm as a matrix, cable mode included, by differentiating one sample of the simulation.

Margins see one axis with a rigid arm. Four joints that hang together, masses that are modelled wrong, a spring between
motor and link and an observer of the joints' momentum are in no such loop, but in the derivative of one sample at rest.
Left out is what has no slope: quantisers are off, and every joint slides, so that Coulomb friction is a constant and
viscous friction stays; or every joint sticks, and friction and what is cancelled of it are the springs F_c/z. There a
model of it that is cancelled creeps apart from the arm's, which forgets within z/ε: slowly unstable. A guard
of the gain has no slope at rest either: the loop is that of the full gain.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_on_its_tissue, structure_of
from jaxmpc.files.errors import InputError
from jaxmpc.law.chain import Chain
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmLoop, ArmSignals, Cell, advance, start
from jaxmpc.stability.family import held
from jaxmpc.stability.loop import transition_matrix
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from jaxmpc.world import arm, friction
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.joint_acceleration import accelerate
from jaxmpc.world.robot import HeartSample, Robot, RobotStructure, with_cutoff
from jaxmpc.xla import ops
from jaxmpc.xla.blocks import padded
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import on_cpu
from jaxmpc.xla.precision import in_float64

ROUNDING = 1e-9
"""How far above 1 a spectral radius must lie to count: far more than eigenvalues near 1 are rounded by [-]."""
MANY, AT_A_TIME = 500, 256
"""From how many robots on a program is compiled, and how many it takes at a time: some 20 s of two cores once, and a
second for a thousand robots; operation by operation any number takes 3 s of Python, and 9 s the first time."""
OF_A_THREAD = 64
"""Matrices of which a thread finds the eigenvalues, a tenth of a second's work: fewer are not worth one."""
_NONE = (0.0, 0.0, 0.0, 0.0)


class System(NamedTuple):
    """The loop from sample to sample, x⁺ = A x + B w, s = C x + D w, with what is added to it and what it shows.

    The state is that of the controller, then that of the arm, raveled. w is added to a before the computed torque, and
    the cascades do not know of it, then to the measured force: X, Y, Z each. s is v, a and the measured force.
    """

    A: Float[Array, "n n"]
    B: Float[Array, "n 6"]
    C: Float[Array, "9 n"]
    D: Float[Array, "9 6"]


def whole_arm_matrix(
    chain: Chain, kind: RobotStructure, robot: Robot, gains: Gains, K2: Any, sticking: bool = False
) -> Float[Array, "n n"]:
    """Transition matrix of controller and arm together; as `whole_arm_system`, which has it."""
    return whole_arm_system(chain, kind, robot, gains, K2, sticking).A


def whole_arm_system(
    chain: Chain, kind: RobotStructure, robot: Robot, gains: Gains, K2: Any, sticking: bool = False
) -> System:
    """Controller and arm together; traceable, and so for batches of robots and controllers.

    Linearised at rest in the posture, touching without force; a tissue is taken to be attached, and has the stiffness
    that its law has there.

    Args:
        chain: The arm.
        kind: Structure of its world.
        robot: Its constants, the tissue's stiffness among them.
        gains: One controller; a schedule is left out, the loop is that of the fixed gains.
        K2: Its damping [1/s].
        sticking: Whether the joints stick, else they slide.
    """
    gains = gains._replace(mpc_ref=gains.mpc_ref[:1], schedule=None)
    program = ArmLoop(chain, kind._replace(attached=True), accelerate)
    cell = Cell(gains, jnp.asarray(K2, float), _smooth(robot, sticking))
    begin, quiet = start(program, cell, ops), _quiet(kind.substeps)
    three = (jnp.zeros(()),) * 3

    def one_sample(controller: Any, world: Any) -> tuple[Any, Any]:
        state, (push, noise), _ = world
        now = quiet._replace(noise=noise)
        after, sample = advance(program, cell, begin._replace(controller=controller, robot=state), now, ops, push)
        following = after.robot
        if not sticking:  # bristles without force are no mode either
            following = following._replace(bristles=friction.init(0.0 * following.q[0]))
        # What is added and what is seen are states too: the one is gone, the other new at every sample.
        return after.controller, (following, (three, three), (sample.v, sample.a, sample.force))

    world = begin.robot, (three, three), (three, three, three)
    whole = transition_matrix(gains, one_sample, begin.controller, world)
    added, seen = slice(-15, -9), slice(-9, None)
    n = slice(None, -15)
    return System(whole[n, n], whole[n, added], whole[seen, n], whole[seen, added])


def radii(matrices: Float[np.ndarray, "*batch n n"]) -> Float[np.ndarray, "*batch"]:
    """Spectral radius of each matrix [-]; ∞ where it is not finite. By LAPACK, so never inside a compiled program."""
    finite = np.isfinite(matrices).all(axis=(-2, -1))
    usable = np.where(finite[..., None, None], matrices, 0.0)
    flat = usable.reshape(-1, *usable.shape[-2:])
    parts = np.array_split(flat, max(1, min(len(flat) // OF_A_THREAD, len(os.sched_getaffinity(0)))))
    with ThreadPoolExecutor(len(parts)) as threads:  # LAPACK lets go of Python
        eigenvalues = np.concatenate(list(threads.map(np.linalg.eigvals, parts)))
    found: np.ndarray = np.where(finite, np.abs(eigenvalues).max(axis=-1).reshape(finite.shape), np.inf)
    return found


def robots_of(experiments: Sequence[Experiment]) -> Robot:
    """Robots and tissues of experiments as one batch, every leaf (experiments, …).

    Raises:
        InputError: An experiment has several stiffnesses.
    """
    robots = map(robot_on_its_tissue, experiments)
    batch: Robot = jax.tree.map(lambda *values: np.array(values, np.float64), *robots)
    return batch


@in_float64
def lost(params: Params, experiments: Sequence[Experiment]) -> Bool[np.ndarray, " experiments"]:
    """Whether the linear loop of the whole arm is unstable, per experiment.

    A family's is, if it is with its fixed gains or with those for the tissue's stiffness. Seconds for any number of
    experiments of one structure. It knows no friction that holds a joint, no event and no end: a slow divergence that a
    run of some seconds does not show counts.

    Args:
        params: One controller.
        experiments: On the arm, each with one stiffness.

    Raises:
        InputError: The controller is a batch, or an experiment has several stiffnesses.
    """
    if params.batch_shape:
        raise InputError("params", f"a batch {params.batch_shape}", "one controller", "Ask for one after another.")
    programs = [(structure_of(e.arm, e.tissue), e.sampling_time, e.loop_path().force_filter) for e in experiments]
    found = np.zeros(len(experiments), bool)
    for program in dict.fromkeys(programs):
        kind, T_s, force_filter = program
        check_sampling(params, T_s)
        mine = [i for i, each in enumerate(programs) if each == program]
        robots = with_cutoff(robots_of([experiments[i] for i in mine]), params.velocity_cutoff, ARRAYS)
        for gains, K2 in _controllers(params, [experiments[i].stiffness[0] for i in mine], T_s, force_filter):
            found[mine] |= radii(np.asarray(_matrices(gains, K2, robots, kind))) > 1.0 + ROUNDING
    return found


def _controllers(
    params: Params, stiffness: Sequence[float], T_s: float, force_filter: ForceFilter | None
) -> list[tuple[Gains, Any]]:
    """Gains and damping [1/s], tissues (stiffness,) [N/m] as leading dimension: fixed ones, then those of each."""
    count = len(stiffness)
    with on_cpu():
        gains, _ = jax.device_get(_designed(params, T_s, force_filter=force_filter))
        if params.listening is None:
            return [jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), (gains, params.K2))]
        # Each number of tissues is another program.
        known = padded(np.array(stiffness, float), 1 << max(6, (count - 1).bit_length()))
        each = [_held(gains, params.K2, K_hat) for K_hat in (np.full(len(known), np.nan), known)]
        return [jax.tree.map(lambda leaf: np.asarray(leaf)[:count], one) for one in each]


def _matrices(gains: Gains, K2: Any, robots: Robot, kind: RobotStructure) -> Float[Array | np.ndarray, "robots n n"]:
    """One matrix per robot and its gains: of a few operation by operation, of many in a program that is compiled."""
    count = len(robots.extra_delay)
    with on_cpu():
        whole = gains, K2, robots
        if count < MANY:
            # Each operation is compiled for a number of robots.
            whole = jax.tree.map(jnp.asarray, padded(whole, 1 << max(6, (count - 1).bit_length())))
            return _of_robots(*whole, kind=kind)[:count]
        whole = jax.tree.map(lambda leaf: leaf.reshape(-1, AT_A_TIME, *leaf.shape[1:]), padded(whole, AT_A_TIME))
        blocks = len(whole[2].extra_delay)
        found = [_compiled(*jax.tree.map(lambda leaf, i=i: leaf[i], whole), kind=kind) for i in range(blocks)]
        return np.concatenate(found)[:count]


def _of_robots(gains: Gains, K2: Any, robots: Robot, *, kind: RobotStructure) -> Float[Array, "robots n n"]:
    return jax.vmap(lambda gains, K2, robot: whole_arm_matrix(arm.chain(), kind, robot, gains, K2))(gains, K2, robots)


_designed, _held = JitOnce(design_one), JitOnce(held)
_compiled = JitOnce(_of_robots, static_argnames=("kind",))


def _smooth(robot: Robot, sticking: bool) -> Robot:
    """Without what has no slope: quantisers and, while joints slide, Coulomb friction, true and cancelled."""
    robot = robot._replace(
        drive=robot.drive._replace(angle_lsb=0.0, torque_lsb=0.0),
        sensor=robot.sensor._replace(lsb=(0.0, 0.0, 0.0)),
    )
    if sticking:
        return robot
    nominal = robot.nominal.friction._replace(coulomb=_NONE)
    return robot._replace(
        friction=robot.friction._replace(coulomb=_NONE), nominal=robot.nominal._replace(friction=nominal)
    )


def _quiet(substeps: int) -> ArmSignals:
    """A sample at which nothing happens."""
    axes = (0.0, 0.0, 0.0)
    still = HeartSample(axes, axes)
    return ArmSignals(still, (still,) * substeps, axes, ((0.0,),) * 3, axes, softening=1.0, watch=0.0, time=0.0)
