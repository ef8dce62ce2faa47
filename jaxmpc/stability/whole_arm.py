"""The closed loop of the whole arm as a matrix, cable mode included, by differentiating one sample of the simulation.

Margins see one axis with a rigid arm. Four joints that hang together, masses that are modelled wrong and a spring
between motor and link are in no such loop, but in the derivative of one sample at rest. Left out is what has no slope:
quantisers are off, and every joint slides, so that Coulomb friction is a constant and viscous friction stays. A guard
of the gain has no slope at rest either: the loop is that of the full gain.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_on_its_tissue, structure_of
from jaxmpc.files.errors import InputError
from jaxmpc.law.cascade import Gains
from jaxmpc.law.chain import Chain
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.loop.arm import ArmLoop, ArmSignals, Cell, advance, start
from jaxmpc.stability.loop import transition_matrix
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world import arm, friction
from jaxmpc.world.robot import HeartSample, Robot, RobotStructure, accelerate
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

ROUNDING = 1e-9
"""How far above 1 a spectral radius must lie to count: far more than eigenvalues near 1 are rounded by [-]."""
_NONE = (0.0, 0.0, 0.0, 0.0)


def whole_arm_matrix(chain: Chain, kind: RobotStructure, robot: Robot, gains: Gains, K2: Any) -> Float[Array, "n n"]:
    """Transition matrix of controller and arm together; traceable, and so for batches of robots and controllers.

    Linearised at rest in the posture, touching without force; a tissue is taken to be attached, and has the stiffness
    that its law has there. The state is that of the controller, then that of the arm, raveled.

    Args:
        chain: The arm.
        kind: Structure of its world.
        robot: Its constants, the tissue's stiffness among them.
        gains: One controller.
        K2: Its damping [1/s].
    """
    gains = gains._replace(mpc_ref=gains.mpc_ref[:1])
    program = ArmLoop(chain, kind._replace(attached=True), accelerate)
    cell = Cell(gains, jnp.asarray(K2, float), _smooth(robot))
    begin, quiet = start(program, cell, ops), _quiet(kind.substeps)

    def one_sample(controller: Any, state: Any) -> tuple[Any, Any]:
        after, _ = advance(program, cell, begin._replace(controller=controller, robot=state), quiet, ops)
        # Bristles without force are no mode either.
        bristles = friction.init(0.0 * after.robot.q[0])
        return after.controller, after.robot._replace(bristles=bristles)

    return transition_matrix(gains, one_sample, begin.controller, begin.robot)


def radii(matrices: Float[np.ndarray, "*batch n n"]) -> Float[np.ndarray, "*batch"]:
    """Spectral radius of each matrix [-]; ∞ where it is not finite. By LAPACK, so never inside a compiled program."""
    finite = np.isfinite(matrices).all(axis=(-2, -1))
    eigenvalues = np.linalg.eigvals(np.where(finite[..., None, None], matrices, 0.0))
    found: np.ndarray = np.where(finite, np.abs(eigenvalues).max(axis=-1), np.inf)
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

    Milliseconds each, where a run takes seconds. It knows no friction that holds a joint, no event and no end: a slow
    divergence that a run of some seconds does not show counts.

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
        mine = [i for i, each in enumerate(programs) if each == program]
        matrices = _over_robots(params, robots_of([experiments[i] for i in mine]), T_s, force_filter, kind=kind)
        found[mine] = radii(np.asarray(matrices)) > 1.0 + ROUNDING
    return found


def _matrices(
    params: Params, robots: Robot, T_s: Any, force_filter: ForceFilter | None, kind: RobotStructure
) -> Float[Array, "robots n n"]:
    gains, _ = design_one(params, T_s, force_filter=force_filter)
    return jax.vmap(lambda robot: whole_arm_matrix(arm.chain(), kind, robot, gains, params.K2))(robots)


_over_robots = JitOnce(_matrices, static_argnames=("kind",))


def _smooth(robot: Robot) -> Robot:
    """Without what has no slope: quantisers, and Coulomb friction, that of the arm and that which is cancelled."""
    nominal = robot.nominal.friction._replace(coulomb=_NONE)
    return robot._replace(
        drive=robot.drive._replace(angle_lsb=0.0, torque_lsb=0.0),
        sensor=robot.sensor._replace(lsb=(0.0, 0.0, 0.0)),
        friction=robot.friction._replace(coulomb=_NONE),
        nominal=robot.nominal._replace(friction=nominal),
    )


def _quiet(substeps: int) -> ArmSignals:
    """A sample at which nothing happens."""
    axes = (0.0, 0.0, 0.0)
    still = HeartSample(axes, axes)
    return ArmSignals(still, (still,) * substeps, axes, ((0.0,),) * 3, axes, softening=1.0, watch=0.0, time=0.0)
