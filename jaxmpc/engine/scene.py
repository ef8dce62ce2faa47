"""An experiment as a program: what of it is structure, what is data, and how its cells are run."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from jaxmpc.engine.arm_cells import over_arm_cells
from jaxmpc.engine.arm_rollout import ArmSample, ArmSignals, Program
from jaxmpc.engine.cells import over_cells
from jaxmpc.engine.forward_dynamics import implicit, stock_mjx
from jaxmpc.engine.rollout import HIGHEST_FORCE, AxisSignals, Sample, record, run
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.tables import kind_of, robot_of, softening
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.world.arm import chain
from jaxmpc.world.contact import Contact
from jaxmpc.world.heart.motion import displacement
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.world.robot import Robot, RobotStructure


class ProgramSpec(NamedTuple):
    """What of an experiment needs a program of its own; hashable."""

    physics: str
    preview: bool
    kind: RobotStructure | None
    """Structure of the arm's world."""


class ScenarioData(NamedTuple):
    """What of an experiment is data for the compiled program."""

    stiffness: Any
    signals: AxisSignals | ArmSignals
    """Signals of the linear world with the axes first, of the arm with the motions first."""
    lsb: Any
    robot: Robot | None
    path: LoopPath


class CellResults(NamedTuple):
    """What came out of the cells."""

    metrics: Metrics
    """(controllers, stiffness, 3·motions)"""
    diverged: Any
    """When a run left the finite numbers or `HIGHEST_FORCE`, (controllers, stiffness); ∞ if never [s]."""
    lost_contact: Any
    """When the tip left the tissue; ∞ if never [s]."""
    trace: Sample | ArmSample | None
    """(controllers, stiffness, axes, steps, …)"""


def program_spec(experiment: Experiment) -> ProgramSpec:
    """The structure of an experiment."""
    on_arm = experiment.physics != "linear"
    kind = kind_of(experiment.arm, experiment.tissue, experiment.sensor.kalman > 0.0) if on_arm else None
    if experiment.physics == "mjx" and kind is not None:
        kind = kind._replace(integrator="euler")
    return ProgramSpec(experiment.physics, experiment.reference.preview, kind)


def scenario_data(experiment: Experiment) -> ScenarioData:
    """The arrays of an experiment."""
    on_arm = experiment.physics != "linear"
    return ScenarioData(
        np.asarray(experiment.stiffness),
        _arm_signals(experiment) if on_arm else _axis_signals(experiment),
        np.asarray(experiment.sensor.lsb),
        robot_of(experiment) if on_arm else None,
        experiment.loop_path(),
    )


def side_by_side(scenes: list[ScenarioData]) -> ScenarioData:
    """Scenes of one `ProgramSpec` and stiffness set as one, as if each had axes of its own.

    On the arm they may also differ in the robot; what differs becomes one number per scene.
    """
    first = scenes[0]
    joined = jax.tree.map(lambda *fields: jnp.concatenate(fields), *(scene.signals for scene in scenes))
    if first.robot is None:
        return first._replace(signals=joined, lsb=np.tile(first.lsb, len(scenes)))

    def shared(*values: Any) -> Any:
        return values[0] if len(set(map(float, values))) == 1 else np.array(values, np.float64)

    return first._replace(signals=joined, robot=jax.tree.map(shared, *(scene.robot for scene in scenes)))


def simulate_cells(
    world: ProgramSpec,
    gains: Gains,
    K2: Any,
    contacts: Contact | None,
    scene: ScenarioData,
    dtype: Any,
    traced: bool = False,
) -> CellResults:
    """Every controller on every tissue, axis and motion; traceable.

    Args:
        world: The structure.
        gains: Taken apart into scalars, each (controllers,).
        K2: Damping, (controllers,) [1/s].
        contacts: The linear worlds, (controllers, stiffness); the arm needs none.
        scene: The data.
        dtype: Precision of the time stepping.
        traced: Keep every sample.
    """
    if world.kind is None:
        cells = as_dtype((gains, contacts, scene.lsb, scene.signals), dtype)
        metrics, diverged = over_cells(run, *cells)
        when = jnp.min(diverged, axis=-1)
        return CellResults(metrics, when, when + jnp.inf, over_cells(record, *cells) if traced else None)
    accelerate = stock_mjx() if world.physics == "mjx" else implicit
    program = Program(chain(), world.kind, accelerate, HIGHEST_FORCE)
    gains, K2, robot, stiffness, signals = as_dtype((gains, K2, scene.robot, scene.stiffness, scene.signals), dtype)
    metrics, trouble, samples = over_arm_cells(program, gains, K2, robot, stiffness, signals, traced)
    return CellResults(metrics, trouble.diverged, trouble.lost_contact, samples)


def as_dtype(tree: Any, dtype: Any) -> Any:
    """Floating leaves in another precision; masks stay what they are."""

    def cast(leaf: Any) -> Any:
        leaf = jnp.asarray(leaf)
        return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(cast, tree)


def _axis_signals(experiment: Experiment) -> AxisSignals:
    heart, noise, wanted, score = (np.moveaxis(signal, 1, 0) for signal in experiment.signals)
    return AxisSignals(*map(jnp.asarray, (heart, noise, _ahead(experiment, wanted), score)))


def _arm_signals(experiment: Experiment) -> ArmSignals:
    _, noise, wanted, score = experiment.signals
    t = np.arange(experiment.steps) * experiment.sampling_time
    arm, tissue = experiment.arm, experiment.tissue
    h = experiment.sampling_time / arm.substeps
    # Leapfrog asks for the heart in the middle of a substep, Euler at its start.
    begin = 0.5 * h if arm.integrator == "leapfrog" and experiment.physics == "wam" else 0.0
    asked = (t[:, None] + begin + h * np.arange(arm.substeps)).ravel()
    moving = np.stack(displacement(experiment.motion, t), axis=1)
    between = np.stack(displacement(experiment.motion, asked), axis=1).reshape(len(t), arm.substeps, 2, 3)
    ahead = np.moveaxis(_ahead(experiment, wanted.T), 0, 1)
    signals = (moving, between, noise, ahead, score * 1.0, softening(tissue, t), (t >= experiment.settle) * 1.0, t)
    watched = signals[6] * (not tissue.attached)
    fields: Any = (*signals[:6], watched, t)
    rows: list[Any] = [np.asarray(field)[None] for field in fields]
    return ArmSignals(*rows)


def _ahead(experiment: Experiment, wanted: np.ndarray) -> np.ndarray:
    """Wanted force (3, steps, ahead): the value itself, or with preview those 1 … H_p samples later."""
    if not experiment.reference.preview:
        return wanted[:, :, None]
    windows = np.lib.stride_tricks.sliding_window_view(wanted, wanted.shape[1] - experiment.steps + 1, axis=1)
    return windows[:, :, 1:]


def with_physics(experiment: Experiment, physics: str | None) -> Experiment:
    """The same experiment in another physics."""
    return msgspec.structs.replace(experiment, physics=physics) if physics else experiment
