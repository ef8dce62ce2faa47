"""The golden trace: forces (and angles) of a simulated run, and what the JAX-traced law answered to them."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.closed_loops import evaluate_block
from jaxmpc.engine.base import ProgramSpec, ScenarioData, scalars
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.law import cascade, entry, force_control, torque_limits
from jaxmpc.law.force_control import Controller
from jaxmpc.law.gains import Gains
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.reference import split, told
from jaxmpc.law.torque_limits import TorqueLimits
from jaxmpc.synthesis.params import Params
from jaxmpc.world.arm import chain
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.drive import read as drive_read
from jaxmpc.world.robot import with_cutoff
from jaxmpc.xla import ops
from jaxmpc.xla.cse import sharing
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

LIMITED_ABOVE = 0.99
"""Quantile of a joint's torques above which the golden trace limits them [-]."""


class ArmRun(NamedTuple):
    """What a controller on the arm reads, sample by sample."""

    q: np.ndarray
    """Measured joint angles, shape (steps, 4) [rad]."""
    force: np.ndarray
    """Measured force, shape (steps, 3) [N]."""
    force_ref: np.ndarray
    """Wanted force, shape (steps, 3), with preview (steps, 3, H_p max) [N]."""


class ArmAnswer(NamedTuple):
    """What the law answers to it."""

    v: np.ndarray
    """Commands of the cascades, shape (steps, 3) [m/s²]."""
    torque: np.ndarray
    """Joint torques wanted, shape (steps, 4) [N m]."""
    applied: np.ndarray
    """Those that the limits let pass, of which the observers are told, shape (steps, 4) [N m]."""


@in_float64
def simulated_run(params: Params, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Measured and wanted force of one controller at the experiment's middle stiffness.

    Returns:
        Force (steps, 3) [N], and wanted force (steps, 3), with preview (steps, 3, H_p max) [N].
    """
    middle = len(experiment.stiffness) // 2
    trace = _simulated(params, experiment, experiment.stiffness[middle : middle + 1])
    wanted = np.moveaxis(trace["force_ref"][0], 0, 1)
    return trace["force"][0].T, wanted if experiment.reference.preview else wanted[:, :, 0]


@in_float64
def simulated_arm_runs(params: Params, experiment: Experiment, stiffness: tuple[float, ...]) -> list[ArmRun]:
    """What one controller reads on the experiment's arm, at each stiffness [N/m]."""
    return read_in(experiment, _simulated(params, experiment, stiffness))


def read_in(experiment: Experiment, trace: Mapping[str, Any]) -> list[ArmRun]:
    """What a controller read in each run of a trace, whose signals are (stiffness, axes or joints, steps, …)."""
    drive, runs = robot_of(experiment).drive, []
    signals = (np.asarray(trace[name]) for name in ("q", "force", "force_ref"))
    for q, force, force_ref in zip(*signals, strict=True):
        # The encoders are read as the arm reads them, but for the cable, which the trace does not tell.
        measured = np.stack(drive_read(drive, tuple(q), ARRAYS), axis=1)
        wanted = np.moveaxis(force_ref, 0, 1)
        runs.append(ArmRun(measured, force.T, wanted if experiment.reference.preview else wanted[:, :, 0]))
    return runs


def _simulated(params: Params, experiment: Experiment, stiffness: tuple[float, ...]) -> dict[str, np.ndarray]:
    """Signals of one controller by name, each (stiffness, axes or joints, steps, …)."""
    scene, world = scenario_data(experiment)._replace(stiffness=np.asarray(stiffness)), program_spec(experiment)
    batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], params)
    signals = _run(batch, scene, world=world)
    return {name: np.asarray(signal) for name, signal in signals._asdict().items() if signal is not None}


class _Signals(NamedTuple):
    force: Any
    force_ref: Any
    q: Any
    """None of the linear loop."""


@partial(JitOnce, static_argnames=("world",))
def _run(batch: Params, scene: ScenarioData, world: ProgramSpec) -> _Signals:
    # Of the outcome only parts of the trace are returned, so nothing else is compiled.
    trace: Any = evaluate_block(batch, scene, world=world, dtype="float64", traced=True).trace
    return _Signals(trace.force[0], trace.force_ref[0], None if world.robot is None else trace.q[0])


@in_float64
def law_trace(gains: Gains, force: np.ndarray, force_ref: np.ndarray, preview: bool) -> np.ndarray:
    """Commands of the JAX-traced law to a recorded run, after a reset to its first force.

    Args:
        gains: One controller.
        force: Measured force, shape (steps, 3) [N].
        force_ref: Wanted force, shape (steps, 3), with preview (steps, 3, H_p max) [N].
        preview: Whether the reference is known along H_p.

    Returns:
        Accelerations v, shape (steps, 3) [m/s²].
    """

    def one(state: cascade.AxisState, now: tuple[Any, Any]) -> tuple[cascade.AxisState, Any]:
        return cascade.step(apart, state, now[0], tuple(now[1]))

    def axis(force: Any, ref: Any) -> Any:
        return jax.lax.scan(one, cascade.init(apart, force[0]), (force, ref))[1]

    apart = scalars(jax.tree.map(jnp.asarray, gains), preview)
    wanted = force_ref if preview else force_ref[:, :, None]
    return np.asarray(jax.jit(jax.vmap(axis, in_axes=1, out_axes=1))(jnp.asarray(force), jnp.asarray(wanted)))


@in_float64
def arm_law_trace(
    gains: Gains, K2: float, experiment: Experiment, run: ArmRun, velocity_cutoff: float | None = None
) -> ArmAnswer:
    """Answers of the JAX-traced law of the whole tick to a recorded run, entered in contact at its first sample.

    So that the trace tells what the observers are told, the limits are so tight that they act now and then.

    Args:
        gains: One controller.
        K2: Damping [1/s].
        experiment: Its arm is the controller's nominal one.
        run: What was read.
        velocity_cutoff: Low-pass of the velocity [rad/s]; None is the experiment's.
    """
    preview = experiment.reference.preview
    controller, compensated = _nominal(gains, K2, experiment, velocity_cutoff)
    limits = robot_of(experiment).limits
    wanted = np.array(told(run.force_ref.tolist())) if preview else run.force_ref[:, :, None]
    inputs = run.q, run.force, wanted
    free = _arm_law(controller, limits, inputs, compensated=compensated)
    most = np.quantile(np.abs(free.torque), LIMITED_ABOVE, axis=0)
    tight = limits._replace(torque=tuple(most.tolist()))
    return ArmAnswer(*map(np.asarray, _arm_law(controller, tight, inputs, compensated=compensated)))


@in_float64
def nominal_controller(
    gains: Gains, K2: float, experiment: Experiment, velocity_cutoff: float | None = None
) -> tuple[Controller, bool]:
    """The controller that `arm_law_trace` runs, of floats, and whether it cancels friction."""
    controller, compensated = _nominal(gains, K2, experiment, velocity_cutoff)
    return jax.tree.map(float, controller), compensated


def _nominal(gains: Gains, K2: float, experiment: Experiment, velocity_cutoff: float | None) -> tuple[Controller, bool]:
    robot = with_cutoff(robot_of(experiment), velocity_cutoff, FLOATS)
    apart = scalars(jax.tree.map(jnp.asarray, gains), experiment.reference.preview)
    bandwidth = experiment.arm.momentum_observer or None
    controller = Controller(chain(), robot.nominal, robot.posture, apart, K2, robot.measurement, bandwidth)
    return controller, experiment.arm.compensation > 0.0


def _arm_law_trace(controller: Controller, limits: TorqueLimits, inputs: Any, compensated: bool) -> ArmAnswer:
    def sample(carry: Any, now: Any) -> tuple[Any, Any]:
        (state, last, begun), (q, force, wanted) = carry, now
        present, ahead = split(tuple(map(tuple, wanted)), len(controller.gains.mpc_ref))
        met, command = force_control.step(controller, state, tuple(q), tuple(force), ahead, ops, present=present)
        torque = command.torque.torque
        # The first sample is met twice: before it the arm got what it wants there.
        before = _where(begun, last, torque)
        passed, _ = torque_limits.limit(limits, torque, before, ops)
        following = force_control.applied(met, command, passed), passed
        return (*_where(begun, following, (state, torque)), jnp.ones_like(begun)), (command.v, torque, passed)

    def one(carry: Any, now: Any) -> tuple[Any, ArmAnswer]:
        # XLA takes long for what it copies.
        carry, answer = sharing(sample, 1.0 + 0.0 * now[0][0])(carry, now)
        stacked: Any = map(jnp.stack, answer)
        return carry, ArmAnswer(*stacked)

    met = jax.tree.map(lambda signal: jnp.concatenate([signal[:1], signal]), inputs)
    q, force, _ = (tuple(signal[0]) for signal in inputs)
    at_rest = force_control.init(controller, q, force, compensated)
    start = entry.enter(controller, at_rest, force, (0.0, 0.0, 0.0), ops)
    carry = jax.tree.map(jnp.asarray, (start, (0.0,) * len(q), False))
    answer: ArmAnswer = jax.lax.scan(one, carry, met)[1]
    return ArmAnswer(*(signal[1:] for signal in answer))


def _where(chosen: Any, there: Any, otherwise: Any) -> Any:
    return jax.tree.map(partial(jnp.where, chosen), there, otherwise)


_arm_law = JitOnce(_arm_law_trace, static_argnames=("compensated",))
