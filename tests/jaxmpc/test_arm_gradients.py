"""Gradients through the closed loop on the arm: against central differences, what they cost, and a tuning by them."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.engine.base import ScenarioData, as_dtype, scalars
from jaxmpc.engine.forward_dynamics import implicit
from jaxmpc.engine.registry import choose
from jaxmpc.engine.scenario import program_spec, scenario_data, side_by_side
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmLoop, Cell, start
from jaxmpc.synthesis import design_one
from jaxmpc.world.arm import chain
from jaxmpc.xla import ops
from tests.jaxmpc.arm_tables import NO_COUNTS, TABLE, changed
from tuning import TuneSpec, tune
from tuning.search.mapping import PROPOSED

NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")
POINT = np.log([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0])
SHORT = changed(
    TABLE,
    duration=2.0,
    settle=0.5,
    stiffness=(810.0,),
    reference={"z": -1.0},
    sensor=NO_COUNTS,
    arm={
        "encoder_counts": 0,
        "torque_lsb": 0.0,
        "torque_limit": (200.0,) * 4,
        "joint_torque_limit": (0.0,) * 4,
        "torque_step_limit": (0.0,) * 4,
    },
)
"""No counts, and no saturation in the first step of 1 N: both are straight-through and so no derivative."""


def motions(experiment: Experiment) -> ScenarioData:
    """32 motions and noises side by side: single counts that fall the other way average out."""
    return side_by_side([scenario_data(experiment.with_seed(seed)) for seed in range(32)])


def residuals(points: jax.Array, scene: ScenarioData) -> jax.Array:
    """Mean of the residual RMS over the cells, a row a controller."""

    def gains_of(x: jax.Array) -> Any:
        params = Params(**dict(zip(NAMES, jnp.exp(x), strict=True)))
        return design_one(params, scene.path.T_s)[0], params.K2

    spec = program_spec(SHORT)
    ran = choose(spec, "reverse").simulate(spec, *jax.vmap(gains_of)(points), None, scene, "float64")
    return jnp.mean(ran.metrics.rms, axis=(1, 2))


def summed(x: jax.Array, scene: ScenarioData) -> jax.Array:
    return residuals(x[None], scene)[0]


value = jax.jit(residuals)
reverse = jax.jit(jax.grad(summed))
forward = jax.jit(lambda x, scene: jax.vmap(lambda d: jax.jvp(lambda x: summed(x, scene), (x,), (d,))[1])(jnp.eye(6)))


def central(scene: ScenarioData, step: float) -> np.ndarray:
    shifts = np.concatenate([step * np.eye(6), -step * np.eye(6)])
    high, low = np.split(np.asarray(value(POINT + shifts, scene)), 2)
    return (high - low) / (2.0 * step)


@pytest.mark.oracle
def test_gradient_through_the_arm_is_the_central_difference_in_both_modes() -> None:
    """Of every continuous parameter; δ and R only set scales. 1e-4 of the largest component."""
    scene = motions(SHORT)
    wanted = central(scene, 1e-5)
    back, ahead = reverse(POINT, scene), forward(POINT, scene)
    largest = np.abs(wanted).max()
    assert (np.abs(wanted) > 1e-4 * largest).all()
    np.testing.assert_allclose(back, wanted, rtol=0, atol=1e-4 * largest)
    np.testing.assert_allclose(ahead, back, rtol=0, atol=1e-9 * largest)


@pytest.mark.oracle
def test_gradient_sees_through_counts_and_encoders() -> None:
    """A step of 1e-3 averages over the counts that a plain derivative is blind to, one of 1e-2 does it well.

    With the heart's own motion the residual is some ten counts, and single counts still move a difference at 1e-3
    by a tenth of it; with three times the motion by 1 %.
    """
    arm = {"encoder_counts": 4096, "torque_lsb": 1 / 2700}
    for scale, step, alike in ((1.0, 1e-2, 0.999), (3.0, 1e-3, 0.99)):
        counted = changed(SHORT, sensor={"lsb": TABLE.sensor.lsb}, arm=arm, motion={"scale": scale})
        found, wanted = np.asarray(reverse(POINT, motions(counted))), central(motions(counted), step)
        assert found @ wanted / np.linalg.norm(found) / np.linalg.norm(wanted) > alike
        assert np.linalg.norm(found) / np.linalg.norm(wanted) == pytest.approx(1.0, abs=0.05)


# Cost of the reverse mode.


@pytest.fixture(scope="module")
def descents() -> tuple[Callable[..., Any], Any, Any, int]:
    """Value and gradient of 1000 steps of 64 controllers: both compiled, and bytes of all carries."""
    experiment = changed(TABLE, duration=1.0, settle=0.5, stiffness=(810.0,), reference={"z": -1.0})
    scene = as_dtype(scenario_data(experiment), "float64")
    world = program_spec(experiment)
    assert world.robot is not None
    program = ArmLoop(chain(), world.robot, implicit)
    on_tissue = scene.robot._replace(tissue=scene.robot.tissue._replace(stiffness=scene.stiffness[0]))
    gains = jax.vmap(lambda lam: design_one(Params(lam=lam), 1e-3)[0])(np.geomspace(0.01, 1.0, 64))
    K2 = jnp.full(64, 10.0)

    def loss(gains: Gains) -> jax.Array:
        return jnp.sum(choose(world).simulate(world, gains, K2, None, scene, "float64").metrics.rms)

    carry = jax.eval_shape(lambda gains: start(program, Cell(scalars(gains, False), K2, on_tissue), ops), gains)
    held = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(carry))
    value, both = (jax.jit(f).lower(gains).compile() for f in (loss, jax.value_and_grad(loss)))
    return gains, value, both, held * experiment.steps


@pytest.mark.slow
def test_reverse_mode_holds_the_carries_and_half_as_much_again(descents: Any) -> None:
    _, _, both, carries = descents
    held = both.memory_analysis().temp_size_in_bytes
    assert held <= 1.5 * carries


@pytest.mark.slow
def test_reverse_mode_takes_six_times_the_forward_run_at_most(descents: Any) -> None:
    """The shortest of five runs each: other work on the machine only lengthens them."""
    gains, value, both, _ = descents
    took = []
    for compiled in (value, both):
        times = []
        for _ in range(6):
            began = time.perf_counter()
            jax.block_until_ready(compiled(gains))
            times.append(time.perf_counter() - began)
        took.append(min(times[1:]))
    assert took[1] <= 6.0 * took[0]


# Tuning.


@pytest.mark.slow
def test_tuning_runs_on_the_arm() -> None:
    experiment = {"published": "table-1", "physics": "wam", "duration": 1.5, "settle": 0.5, "stiffness": [810.0]}
    spec = TuneSpec.from_dict(
        {
            "experiment": {**experiment, "reference": {"z": -1.0}},
            "params": {"published": "text"},
            "tune": {
                "starts": 2,
                "steps": 2,
                "train_seeds": [0],
                "heldout_seeds": [1000],
                "duration": 0.6,
                "settle": 0.3,
            },
            "goals": {"M_s": 6.0},
        }
    )
    result = tune(spec)
    assert np.isfinite(result.heldout).all()
    assert np.isfinite(result.state.z).all()
    assert not result.state.skipped.any()
    assert result.state.z.shape[0] == PROPOSED * spec.tune.starts
