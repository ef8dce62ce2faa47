"""The rivals of `benchmarks.rivals`: the PI controller against one by hand, the objective against the tuner's."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.rivals import pi
from benchmarks.rivals.objective import evaluator, mpc_aob, pi_control
from benchmarks.rivals.room import shares, vectors
from jaxmpc.experiment import Experiment
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.stability.controller import controller_response
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.world.loop_path import loop_path
from tuning import TuneSpec
from tuning.objective.loss import value_alone
from tuning.objective.problem import Problem, problem_of, training

pytestmark = pytest.mark.slow

T_s = 1e-3
CONTROLLER = pi.Pi(K_p=0.8, T_i=0.05, K2=40.0)


@pytest.fixture(scope="module")
def gains() -> Gains:
    found: Gains = jax.tree.map(np.asarray, pi.gains(CONTROLLER, T_s))
    return found


def by_hand(wanted: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """v = K_p (u − y) with u the integral of the error over T_i, sample by sample."""
    u, commands = forces[0], []
    for F_d, y in zip(wanted, forces, strict=True):
        u += T_s / CONTROLLER.T_i * (F_d - y)
        commands.append(CONTROLLER.K_p * (u - y))
    return np.array(commands)


def test_pi_gains_are_a_pi_controller(gains: Gains) -> None:
    random = np.random.default_rng(0)
    wanted, forces = random.normal(size=(2, 200))
    told = constant_reference(gains)
    state, commands = cascade.init(gains, forces[0]), []
    for F_d, y in zip(wanted, forces, strict=True):
        state, v = cascade.step(told, state, y, (F_d,))
        commands.append(v)
    # Both add up the same terms, in another order.
    np.testing.assert_allclose(commands, by_hand(wanted, forces), rtol=0, atol=1e-13)
    assert float(state.p_hat) == 0.0


def test_its_frequency_response_is_that_of_a_pi_controller(gains: Gains) -> None:
    q = np.exp(-1j * np.geomspace(1e-4, np.pi, 50))
    expected = -CONTROLLER.K_p * (1.0 + T_s / CONTROLLER.T_i / (1.0 - q))
    np.testing.assert_allclose(controller_response(gains, jnp.asarray(q)), expected, rtol=1e-12)


@pytest.mark.parametrize("K_p", [0.8, 8.0])
def test_its_loop_is_as_stable_as_one_written_by_hand(K_p: float) -> None:
    """x, ẋ, the last command, û, the filtered velocity and the last x by hand: a stable loop and an unstable one."""
    controller = CONTROLLER._replace(K_p=K_p)
    K_s, cutoff = 1900.0, 180.0
    contact = contact_of(K_s, controller.K2, loop_path(T_s, velocity_cutoff=cutoff, lowpass_hz=0.0))
    found = spectral_radius(closed_loop_matrix(pi.gains(controller, T_s), contact))
    pole, share = np.exp(-cutoff * T_s), T_s / controller.T_i
    x, _, _, integral, filtered, before = np.eye(6)
    y = K_s * x
    velocity = (1.0 - pole) * (x - before) / T_s + pole * filtered
    u = integral - share * y
    loop = np.stack(
        [
            np.array([1.0, T_s, 0.5 * T_s**2, 0.0, 0.0, 0.0]),
            np.array([0.0, 1.0, T_s, 0.0, 0.0, 0.0]),
            K_p * (u - y) - controller.K2 * velocity,
            u,
            velocity,
            x,
        ]
    )
    expected = np.abs(np.linalg.eigvals(loop)).max()
    # The closed loop's dominant eigenvalue is simple, so numpy has it to its last digits.
    assert float(found) == pytest.approx(expected, rel=1e-9)
    assert (expected < 1.0) == (K_p == 0.8)


def test_the_textbook_rule_by_hand() -> None:
    found = pi.textbook(Experiment.published("table-1-wam"))
    delay, filtered = 1.5e-3, 1.0 / 180.0
    K2 = 1.0 / (2.0 * (delay + filtered / 2.0))
    theta = delay + 1.0 / K2 / 2.0
    assert found == pytest.approx((1.0 / (1900.0 / K2 * 2.0 * theta), 8.0 * theta, K2))
    np.testing.assert_allclose(pi.decode(jnp.asarray(pi.encode(found))), found, rtol=1e-12)


@pytest.fixture(scope="module")
def brief() -> tuple[TuneSpec, Problem]:
    experiment = {"stiffness": [810.0], "reference": {"z": []}}
    goals: Any = {"M_s": 2.0, "rms": 0.06, "soft": {"rms": 0.05, "peak_to_peak": 0.3}}
    tune = {"train_seeds": [0, 1], "duration": 1.0, "settle": 0.5, "margin_points": 0, "starts": 8}
    spec = TuneSpec.from_dict({"experiment": experiment, "tune": tune, "goals": goals})
    return spec, problem_of(spec, training(spec, spec.tune.train_seeds))


def test_everybody_is_given_the_tuners_objective(brief: tuple[TuneSpec, Problem]) -> None:
    spec, problem = brief
    z = spec.space.draw(8, 3)
    z[0] = spec.space.encode(spec.params)
    found = evaluator(problem, mpc_aob, 8)(z)
    limits = {name: jnp.full(8, limit) for name, limit in problem.data.margins.items()}
    data = problem.data._replace(margins=limits)
    # The gradient's program would take three times as long to compile; the benchmark itself compares with that.
    seen = jax.jit(lambda rows: value_alone(rows, data, 1.0, problem.structure))(z)
    stable = np.isfinite(seen.score)
    assert stable.any()
    assert not stable.all()
    # The same terms by another program.
    np.testing.assert_allclose(found.loss, seen.loss, rtol=1e-9)
    np.testing.assert_allclose(found.score, seen.score, rtol=1e-9)
    np.testing.assert_allclose(found.hard, seen.hard.max(axis=1), rtol=1e-9)


def test_pi_is_judged_in_the_same_world(brief: tuple[TuneSpec, Problem]) -> None:
    _, problem = brief
    evaluate = evaluator(problem, pi_control)
    calm, wild = (pi.encode(CONTROLLER._replace(K_p=K_p)) for K_p in (0.8, 80.0))
    found = evaluate(np.stack([calm, wild]))
    assert np.isfinite(found.score[0])
    assert np.isnan(found.score[1])
    assert np.isposinf(found.hard[1])


def test_room_and_its_inverse(small: Callable[..., dict[str, Any]]) -> None:
    axes = TuneSpec.from_dict(small(tune={"free": {"lam": True, "Hp": True}, "diagonals": ["lam"]})).space.axes
    points = np.random.default_rng(0).uniform(0.01, 0.99, (4, 17))
    np.testing.assert_allclose(shares(axes, vectors(axes, points)), points, rtol=1e-9)
