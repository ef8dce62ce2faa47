"""An experiment as a program: what of it is structure, what is data."""

from typing import Any

import jax
import msgspec
import numpy as np

from jaxmpc import swing
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of, structure_of
from jaxmpc.experiment.tables import softening
from jaxmpc.loop.arm import ArmSignals
from jaxmpc.loop.linear import AxisSignals
from jaxmpc.world.heart.motion import displacement
from jaxmpc.xla.place import placed
from jaxmpc.xla.plain import library


def program_spec(experiment: Experiment) -> ProgramSpec:
    """The structure of an experiment."""
    on_arm = experiment.physics != "linear"
    robot = structure_of(experiment.arm, experiment.tissue) if on_arm else None
    engine = "mjx" if experiment.physics == "mjx" else "scan"
    return ProgramSpec(engine, experiment.reference.preview, robot)


def scenario_data(experiment: Experiment, swinging: bool = False) -> ScenarioData:
    """The arrays of an experiment.

    Args:
        experiment: What is met.
        swinging: Whether to ask how the force swings (`Metrics.swing`, else NaN): it costs the linear loop 40 % of its
            time, the arm 1 %.

    Raises:
        InputError: A value of the experiment is out of bounds, or a recording unusable.
    """
    _ = experiment.within_bounds
    on_arm = experiment.physics != "linear"
    return ScenarioData(
        np.asarray(experiment.stiffness),
        _arm_signals(experiment, swinging) if on_arm else _axis_signals(experiment, swinging),
        np.asarray(experiment.sensor.lsb),
        experiment.force_limit,
        robot_of(experiment) if on_arm else None,
        experiment.loop_path(),
    )


def side_by_side(scenes: list[ScenarioData]) -> ScenarioData:
    """Scenes of one `ProgramSpec` and stiffness set as one, as if each had axes of its own.

    On the arm they may also differ in the robot; what differs becomes one number per scene.
    """

    def one_after_another(*fields: Any) -> Any:
        # On a GPU JAX would compile that anew for every number of scenes.
        return library(*fields).concatenate(fields)

    first = scenes[0]
    joined = jax.tree.map(one_after_another, *(scene.signals for scene in scenes))
    if first.robot is None:
        return first._replace(signals=joined, lsb=np.tile(first.lsb, len(scenes)))

    def shared(*values: Any) -> Any:
        return values[0] if len(set(map(float, values))) == 1 else np.array(values, np.float64)

    return first._replace(signals=joined, robot=jax.tree.map(shared, *(scene.robot for scene in scenes)))


def _axis_signals(experiment: Experiment, swinging: bool) -> AxisSignals:
    heart, noise, wanted, score = (np.moveaxis(signal, 1, 0) for signal in experiment.signals)
    late = np.broadcast_to(_late(experiment), score.shape) if swinging else None
    present = wanted[:, : experiment.steps] if experiment.reference.preview else None
    met: Any = AxisSignals(heart, noise, _ahead(experiment, wanted), score, late=late, wanted=present)
    found: AxisSignals = placed(met)
    return found


def _late(experiment: Experiment) -> np.ndarray:
    """Whether each sample is of the end of the run, (steps,): of its last 10 s what comes after settling."""
    sample = np.arange(experiment.steps)
    last = round(swing.WINDOW / experiment.sampling_time)
    return (sample >= experiment.steps - last) & (sample * experiment.sampling_time >= experiment.settle)


def _arm_signals(experiment: Experiment, swinging: bool) -> ArmSignals:
    _, noise, wanted, score = experiment.signals
    t = np.arange(experiment.steps) * experiment.sampling_time
    arm, tissue = experiment.arm, experiment.tissue
    h = experiment.sampling_time / arm.substeps
    # Leapfrog asks for the heart in the middle of a substep, Euler at its start.
    begin = 0.5 * h if arm.integrator == "leapfrog" else 0.0
    asked = (t[:, None] + begin + h * np.arange(arm.substeps)).ravel()
    moving = np.stack(experiment.heart, axis=1)
    between = np.stack(displacement(experiment.motion, asked), axis=1).reshape(len(t), arm.substeps, 2, 3)
    ahead = np.moveaxis(_ahead(experiment, wanted.T), 0, 1)
    signals = (moving, between, noise, ahead, score * 1.0, softening(tissue, t), (t >= experiment.settle) * 1.0, t)
    watched = signals[6] * (not tissue.attached)
    present = wanted[: experiment.steps] if experiment.reference.preview else None
    met = ArmSignals(*signals[:6], watched, t, _late(experiment) * 1.0 if swinging else None, present)
    found: ArmSignals = jax.tree.map(lambda field: np.asarray(field)[None], met)
    return found


def _ahead(experiment: Experiment, wanted: np.ndarray) -> np.ndarray:
    """Wanted force (3, steps, ahead): the value itself, or with preview those 1 … H_p samples later."""
    if not experiment.reference.preview:
        return wanted[:, :, None]
    windows = np.lib.stride_tricks.sliding_window_view(wanted, wanted.shape[1] - experiment.steps + 1, axis=1)
    return windows[:, :, 1:]


def with_physics(experiment: Experiment, physics: str | None) -> Experiment:
    """The same experiment in another physics; stock MJX brings its own integrator."""
    if physics is None:
        experiment.check_world()
        return experiment
    changed: dict[str, Any] = {"physics": physics}
    if physics == "mjx":
        changed["arm"] = msgspec.structs.replace(experiment.arm, integrator="euler")
    found = msgspec.structs.replace(experiment, **changed)
    found.check_world()
    return found
