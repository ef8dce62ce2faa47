"""One sample of the loop on the arm, in plain numpy: what its signals do, when a run is in trouble, and its slopes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.engine.forward_dynamics import implicit
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment.tables import Change
from jaxmpc.loop.arm import ArmLoop, ArmSample, ArmSignals, Cell, advance, noticed, start, untroubled
from jaxmpc.world import robot
from jaxmpc.world.arm import chain
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.joint_acceleration import accelerate
from jaxmpc.world.robot import HeartSample
from jaxmpc.xla import ops
from tests.jaxmpc.arm_tables import NO_COUNTS, TABLE, changed

STILL = HeartSample((0.0,) * 3, (0.0,) * 3)
RISEN = HeartSample((0.0, 0.0, 1e-3), (0.0,) * 3)
NOW = ArmSignals(STILL, (STILL,), (0.0,) * 3, ((0.0,),) * 3, (1.0,) * 3, 1.0, 1.0, 2.0)


def loop_of(experiment: Experiment) -> tuple[ArmLoop, Cell]:
    spec, data = program_spec(experiment), scenario_data(experiment)
    assert spec.robot is not None
    assert data.robot is not None
    gains = jax.tree.map(float, scalars(design(Params()), False))
    on_tissue = data.robot._replace(tissue=data.robot.tissue._replace(stiffness=experiment.stiffness[0]))
    return ArmLoop(chain(), spec.robot, accelerate), Cell(gains, 10.0, on_tissue)


BEGIN = 2000


def forces(experiment: Experiment, samples: int = 40) -> np.ndarray:
    """Measured forces of some samples from `BEGIN` on, where the heart moves; the tip touches it there first."""
    (loop, cell), signals = loop_of(experiment), scenario_data(experiment).signals
    heart, between, noise, wanted, score, softening, watch, time = (np.asarray(field)[0] for field in signals[:8])
    carry, found = start(loop, cell, ARRAYS), []
    rest = np.stack([heart[BEGIN, 0], np.zeros(3)])
    heart, between = heart - rest, between - rest
    for k in range(BEGIN, BEGIN + samples):
        met, asked = HeartSample(*map(tuple, heart[k])), [HeartSample(*map(tuple, each)) for each in between[k]]
        now = ArmSignals(met, asked, noise[k], wanted[k], score[k], softening[k], watch[k], time[k])
        carry, sample = advance(loop, cell, carry, now, ARRAYS)
        found.append(sample.force)
    return np.array(found)


MOVING = changed(TABLE, duration=2.1, settle=0.0, tissue={"kind": "kelvin-voigt"}, reference={"z": -1.0})
LOW = (0.5, 0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def unchanged() -> np.ndarray:
    return forces(MOVING)


@pytest.mark.parametrize(
    "change",
    [
        {"arm": {"coulomb": (1.6, 0.53, 0.35, 0.63)}},
        {"arm": {"viscous": (1.6, 2.4, 0.86, 0.62)}},
        {"arm": {"mass_error": 0.1}},
        {"arm": {"tool_mass_error": 0.1}},
        {"arm": {"encoder_counts": 0}},
        {"arm": {"torque_lsb": 0.0}},
        {"arm": {"torque_limit": LOW}},
        {"arm": {"posture": (0.1, 0.8, 0.2, 2.0)}},
        {"arm": {"presliding": 1e-4}},
        {"delay": 2},
        {"stiffness": (300.0,)},
        {"velocity_lowpass": 300.0},
        {"tissue": {"viscosity": 1.0}},
        {"tissue": {"changes": (Change(2.0, 2.0, 0.05),)}},
        {"sensor": {"lowpass_hz": 250.0}},
        {"sensor": {"lsb": (0.0, 0.0, 0.0)}},
        {"sensor": {"noise": 0.0}},
        {"motion": {"seed": 3, "phases": "random"}},
        {"motion": {"scale": 0.5}},
    ],
    ids=str,
)
def test_every_number_is_felt(unchanged: np.ndarray, change: dict[str, Any]) -> None:
    """Each alone, so that none hides behind another."""
    found = forces(changed(MOVING, **change))
    assert np.isfinite(found).all()
    assert np.abs(found - unchanged).max() > 1e-6


def test_a_tissue_that_softens_pushes_less() -> None:
    softer = {"at": 2.0, "factor": 0.5}
    table = {"physics": "wam", "duration": 4.0, "settle": 1.0, "stiffness": [810.0], "tissue": {"changes": [softer]}}
    experiment = changed(Experiment.from_dict(table), sensor=NO_COUNTS)
    told = np.asarray(scenario_data(experiment).signals.softening)[0]  # type: ignore[union-attr]
    loop, cell = loop_of(experiment)
    forces = []
    for factor in (told[0], told[-1]):
        now = NOW._replace(heart=RISEN, between=(RISEN,), softening=float(factor))
        forces.append(advance(loop, cell, start(loop, cell, ARRAYS), now, ARRAYS)[1].force[2])
    assert abs(forces[0]) > 0.7
    assert forces[1] == pytest.approx(0.5 * forces[0], rel=1e-9)


@pytest.mark.parametrize("delay", [1, 2])
def test_a_torque_acts_after_its_delay(delay: int) -> None:
    """Sent at sample 0, it is the first to move the arm between sample `delay` and the next."""
    loop, cell = loop_of(changed(TABLE, delay=delay))
    begun = start(loop, cell, ARRAYS).robot
    weight = begun.pending[0]

    def moved(first: float) -> list[float]:
        state, angles = begun, []
        for k in range(4):
            push = first if k == 0 else 0.0
            sent = tuple(torque + push for torque in weight)
            state = robot.move(loop.chain, loop.structure, cell.robot, state, sent, [STILL], accelerate, ARRAYS)
            angles.append(state.q[3])
        return angles

    differs = [one != other for one, other in zip(moved(0.0), moved(1.0), strict=True)]
    assert differs == [k >= delay for k in range(4)]


def test_trouble_is_noticed_when_it_begins() -> None:
    sample = ArmSample(*[(0.0, 0.0, 0.0)] * len(ArmSample._fields))

    def after(*steps: tuple[dict[str, Any], dict[str, Any]]) -> tuple[float, float, float]:
        trouble = untroubled(0.0)
        for sampled, met in steps:
            trouble = noticed(trouble, sample._replace(**sampled), NOW._replace(**met), 15.0, ARRAYS)
        return float(trouble.diverged), float(trouble.over_limit), float(trouble.lost_contact)

    above, below = {"tip": (0.0, 0.0, 1e-6)}, {"tip": (0.0, 0.0, -1e-6)}
    # The heart's surface at 0: the tip above it has left.
    assert after((below, {})) == (np.inf, np.inf, np.inf)
    assert after((above, {"time": 2.5}), (above, {"time": 3.0})) == (np.inf, np.inf, 2.5)
    assert after((below, {}), (above, {"time": 3.0}), (below, {"time": 4.0})) == (np.inf, np.inf, 3.0)
    assert after((above, {"watch": 0.0})) == (np.inf, np.inf, np.inf)
    # 15 N of force together on all axes, or 20 N of residual on one.
    assert after(({"force": (8.0, 8.0, 9.0)}, {})) == (np.inf, np.inf, np.inf)
    assert after(({"force": (9.0, 9.0, 9.0)}, {"time": 1.5})) == (np.inf, 1.5, np.inf)
    assert after(({"force": (0.0, 0.0, -5.0)}, {"time": 1.5, "force_ref": ((0.0,), (0.0,), (16.0,))}))[1] == 1.5
    for force in (2e3, -2e3, np.nan, np.inf):
        assert after(({"force": (0.0, force, 0.0)}, {"time": 1.5}))[:2] == (1.5, 1.5)


def test_derivative_of_forward_dynamics_is_the_central_difference() -> None:
    draw = np.random.default_rng(3)
    q, qd, torque = (tuple(draw.normal(0.0, scale, 4).tolist()) for scale in (0.5, 1.0, 5.0))
    point: Any = (q, qd, torque, 0.3, (1.5, 0.9, 0.5, 0.25), 5e-4)
    tangent = jax.tree.map(lambda _: float(draw.normal()), point)
    step = 1e-6

    def shifted(sign: float) -> np.ndarray:
        return np.array(accelerate(chain(), *jax.tree.map(lambda x, d: x + sign * step * d, point, tangent), ARRAYS))

    as_arrays = (jax.tree.map(jnp.asarray, tree) for tree in (point, tangent))
    value, slope = jax.jit(lambda p, d: jax.jvp(lambda *p: implicit(chain(), *p, ops), p, d))(*as_arrays)
    np.testing.assert_allclose(value, shifted(0.0), rtol=1e-10)
    np.testing.assert_allclose(slope, (shifted(1.0) - shifted(-1.0)) / (2.0 * step), rtol=1e-5)
