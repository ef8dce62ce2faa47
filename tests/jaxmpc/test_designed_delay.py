"""Designs for two samples of delay: their gains, poles and answers on their own plant, their slopes and their worth."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import scipy.linalg

from deploy.controller import frozen_gains
from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.engine.base import scalars
from jaxmpc.law import cascade, schedule
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.stability.family import family_margins
from jaxmpc.synthesis.plant import contact_model
from jaxmpc.world.loop_path import loop_path
from jaxmpc.xla import ops

pytestmark = pytest.mark.once

T_S = 1e-3
TWO = Params(designed_delay=2)
ONE = Params()


def plain(gains: Gains) -> Gains:
    """The law on Python floats."""
    found: Gains = jax.tree.map(lambda field: np.asarray(field).tolist(), gains)
    return found


def plant(params: Params) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of force, force rate and the inputs on the way, the one that acts first in front."""
    Phi, Gamma = contact_model(jnp.asarray(params.Khat_s), jnp.asarray(params.K2), T_S)
    known = 2 + params.designed_delay
    whole = np.eye(known, k=1)
    whole[:2] = 0.0
    whole[:2, :2], whole[:2, 2] = Phi, Gamma
    return whole, np.eye(known)[-1]


@pytest.mark.oracle
@pytest.mark.parametrize(
    "params",
    [
        TWO,
        replace(TWO, Q_p=100.0, Q_x=1e-2, K2=100.0),
        replace(TWO, Q_p=1e-6, K2=40.0, disturbance_order=2),
        replace(TWO, Q_p=1e-9, K2=40.0, disturbance_order=3),
    ],
)
def test_the_observers_gain_is_scipys(params: Params) -> None:
    """On the paper's augmented system, written out with both inputs that are on the way."""
    Phi, Gamma = plant(params)
    order = params.disturbance_order
    Phi_a = scipy.linalg.block_diag(Phi, np.eye(order) + np.eye(order, k=1))
    Phi_a[:4, 4] = Gamma
    c, Q = np.eye(4 + order)[0], np.diag([float(params.Q_x)] * 4 + [0.0] * (order - 1) + [float(params.Q_p)])
    P = scipy.linalg.solve_discrete_are(Phi_a.T, c[:, None], Q, np.eye(1))
    K = P @ c / (c @ P @ c + 1.0)
    gains = design(params)
    np.testing.assert_allclose(np.insert(gains.K, 2, gains.K_earlier), K, rtol=1e-8)


def test_an_observer_whose_input_is_known_does_not_correct_it() -> None:
    gains = design(replace(TWO, architecture="mpc"))
    assert [float(gains.K_earlier), *np.asarray(gains.K[2:]).tolist()] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("K2", "Khat_s", "T_cl"), [(10.0, 900.0, 3e-3), (100.0, 300.0, 2e-4), (0.0, 1900.0, 2e-2)])
def test_the_law_places_the_wanted_poles_and_two_at_zero(K2: float, Khat_s: float, T_cl: float) -> None:
    """Its feedback is read from what it commands, state by state: with the estimates at the plant's states."""
    params = Params(K2=K2, Khat_s=Khat_s, T_cl=T_cl, designed_delay=2, architecture="aob")
    gains = plain(constant_reference(design(params)))
    gains = gains._replace(K=(0.0,) * 4, K_earlier=0.0)
    Phi, Gamma = plant(params)
    rest, feedback = cascade.init(gains), []
    for y, ydot, earlier, last in np.eye(4).tolist():
        # A sample ago, without correction, so that what is predicted is the unit vector.
        y, ydot = np.linalg.solve(Phi[:2, :2], [y, ydot]).tolist()
        state = rest._replace(x_hat=(y, ydot, earlier), earlier=0.0, v=last)
        feedback.append(-cascade.step(gains, state, 0.0, (0.0,))[1])
    pole = np.exp(-T_S / T_cl)
    closed = np.poly(Phi - np.outer(Gamma, feedback))
    np.testing.assert_allclose(closed, np.poly([pole, pole, 0.0, 0.0]), atol=1e-9)


def answer(params: Params, preview: bool, samples: int = 400) -> np.ndarray:
    """Force on the plant of the design, from rest, where 1 N is wanted from sample 100 on [N]."""
    whole = plain(design(params))
    gains, ahead = (whole, 64) if preview else (constant_reference(whole), 1)
    Phi, Gamma = plant(params)
    wanted = (np.arange(samples + 64) >= 100).astype(float)
    state, x, force = cascade.init(gains), np.zeros(len(Phi)), []
    for k in range(samples):
        force.append(x[0])
        state, v = cascade.step(gains, state, float(x[0]), wanted[k + 1 : k + 1 + ahead].tolist())
        x = Phi @ x + Gamma * v
    return np.array(force)


@pytest.mark.parametrize("architecture", ["mpc-aob", "aob", "mpc"])
@pytest.mark.parametrize(("preview", "Hp"), [(False, 30), (True, 30), (False, 64)])
def test_it_answers_as_one_sample_does_a_sample_later(architecture: Any, preview: bool, Hp: int) -> None:
    """All poles of the nominal loop are those of the design for one sample, and one more at 0.

    What is known ahead comes in time. A classical estimate of one sample and of two is the same where nothing disturbs.
    At the longest horizon the last two weights are one: all of them count still.
    """
    one = answer(Params(architecture=architecture, K2=10.0, Hp=Hp), preview)
    two = answer(Params(architecture=architecture, K2=10.0, Hp=Hp, designed_delay=2), preview)
    assert one[-1] == pytest.approx(1.0, abs=1e-2)
    expected = one if preview else np.concatenate([[0.0], one[:-1]])
    np.testing.assert_allclose(two, expected, atol=1e-9)


def test_poles_of_the_nominal_loop(independent_loop: Any) -> None:
    """Those of state feedback, MPC and observer, each from its own small matrix, and no others but at zero."""
    A, *_ = independent_loop(design(TWO), 900.0, 10.0, 2)
    gains = design(TWO)
    Phi, Gamma = plant(TWO)
    # Control: plant, and the MPC's output.
    ahead = np.vstack([Phi[:2], np.eye(4)[3]])
    x_part, u_part = -np.asarray(gains.mpc_x) @ ahead[:2], 1.0 - float(gains.mpc_u)
    g = float(gains.input_gain)
    control = np.block(
        [
            [Phi + np.outer(Gamma, g * x_part - np.asarray(gains.L) @ ahead), (Gamma * g * u_part)[:, None]],
            [x_part[None], np.array([[u_part]])],
        ]
    )
    Phi_a = scipy.linalg.block_diag(Phi, np.eye(1))
    Phi_a[:4, 4] = Gamma
    K = np.insert(np.asarray(gains.K), 2, float(gains.K_earlier))
    observer = Phi_a - np.outer(Phi_a @ K, np.eye(5)[0])
    expected = np.concatenate([np.linalg.eigvals(control), np.linalg.eigvals(observer)])

    def away(poles: np.ndarray) -> np.ndarray:
        far = poles[np.abs(poles) > 0.1]
        return np.sort_complex(far)

    # The velocity's filter of the independent loop is not in it with ideal damping, but is a state.
    found = away(np.linalg.eigvals(A))
    idle = np.argmin(np.abs(found - np.exp(-180.0 * T_S)))
    np.testing.assert_allclose(np.delete(found, idle), away(expected), atol=1e-5)


@pytest.mark.oracle
def test_slopes_of_margins_and_residual_are_central_differences() -> None:
    """In the logarithms, relative to the largest, in both modes."""
    table = Experiment.published("table-1")
    exact = msgspec.structs.replace(table.sensor, lsb=(0.0, 0.0, 0.0))
    changes = {"duration": 3.0, "settle": 1.0, "stiffness": (810.0,), "delay": 2, "sensor": exact}
    experiment = msgspec.structs.replace(table, **changes)
    names = ("lam", "Q_p", "T_cl", "K2", "Khat_s")
    at = jnp.log(jnp.array([0.2, 0.3, 2e-3, 30.0, 1100.0]))

    def twice(logs: jax.Array) -> tuple[jax.Array, jax.Array]:
        params = Params(**dict(zip(names, jnp.exp(logs), strict=True)), Q_x=1e-6, designed_delay=2)
        found = evaluate(params, experiment)
        both = jnp.stack([found.margins.M_s[0], 10.0 * found.metrics.rms[0, 2]])
        return both, both

    # One program for slopes in either mode, and for the values.
    run = jax.jit(lambda logs: [mode(twice, has_aux=True)(logs) for mode in (jax.jacfwd, jax.jacrev)])
    step = 1e-5
    ends = [(run(at.at[i].add(step))[0][1], run(at.at[i].add(-step))[0][1]) for i in range(len(at))]
    difference = np.stack([(high - low) / (2.0 * step) for high, low in ends], axis=1)
    for found, _ in run(at):
        np.testing.assert_allclose(found, difference, atol=1e-6 * np.abs(difference).max())
    assert np.abs(difference).max() > 0.1


def test_two_samples_cost_nine_operations_an_axis() -> None:
    """Two correct the earlier input, seven are force and rate ahead; what one sample costs is counted elsewhere."""

    def operations(params: Params) -> int:
        gains = jax.tree.map(jnp.asarray, plain(constant_reference(design(params))))
        state = cascade.init(gains, jnp.asarray(0.0))
        return len(jax.make_jaxpr(lambda g, s: cascade.step(g, s, 1.0, (1.0,)))(gains, state).eqns)

    assert operations(TWO) - operations(ONE) == 9


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "before", "after"), [("text", 11.97, 7.24), ("cautious", 3.06, 2.60)])
def test_where_there_are_two_samples_it_leaves_more_margin(name: str, before: float, after: float) -> None:
    """The peaks are those of docs/arm.md."""
    stiffness = np.geomspace(375.0, 1900.0, 33)
    one = margins(Params.published(name), stiffness, delay=2)
    two = margins(replace(Params.published(name), designed_delay=2), stiffness, delay=2)
    assert float(np.max(one.M_s)) == pytest.approx(before, abs=0.006)
    assert float(np.max(two.M_s)) == pytest.approx(after, abs=0.006)
    assert float(np.min(two.delay_margin_s)) > float(np.min(one.delay_margin_s)) + 0.3e-3


def late_family() -> Params:
    values = Params.published("family").to_dict()
    return Params.from_dict({**values, "designed_delay": 2})


@pytest.mark.oracle
def test_a_family_shares_its_delay() -> None:
    params = late_family()
    assert all(knot.designed_delay == 2 for knot in params.knots)
    gains = scalars(design(params), preview=False)
    found, _ = schedule.at(gains.schedule, np.log(810.0), ops)
    own = scalars(design(params.knots[2]), preview=False)
    np.testing.assert_allclose([found.K_earlier, *found.K], [own.K_earlier, *own.K], rtol=1e-12)
    nothing_learned = replace(params, listening=replace(params.listening, harmonics=0))
    known = family_margins(nothing_learned, np.array([810.0]), np.array([1.0]), loop_path(delay=2))
    alone = margins(params.knots[2], 810.0, delay=2)
    assert float(known.M_s[0, 0]) == pytest.approx(float(alone.M_s), rel=1e-9)
    axis = cascade.init(gains, 0.0)
    axis = axis._replace(tissue=axis.tissue._replace(log_stiffness=np.log(810.0), authority=0.5))
    half, _ = schedule.now(gains, 10.0, axis, ops)
    assert float(half.K_earlier) == pytest.approx(0.5 * float(gains.K_earlier + own.K_earlier), rel=1e-12)
    with pytest.raises(InputError, match="knots = of another structure"):
        replace(params, designed_delay=1)


def test_a_frozen_family_is_of_one_structure() -> None:
    gains = jax.tree.map(np.asarray, design(late_family()))
    checked = frozen_gains.checked(gains)
    again = frozen_gains.checked(frozen_gains.plain(checked))
    assert again == checked
    first, *others = gains.schedule.knots
    mixed = first._replace(gains=first.gains._replace(K_earlier=None))
    with pytest.raises(InputError, match=r"schedule\.knots = of another structure"):
        frozen_gains.checked(gains._replace(schedule=gains.schedule._replace(knots=(mixed, *others))))


def test_a_lost_force_is_what_the_observer_expects() -> None:
    """So that nothing is corrected: the states are those of the prediction."""
    gains = plain(constant_reference(design(TWO)))
    state = cascade.init(gains, -5.0)
    for wanted in (-5.0, -4.0, -3.0):
        state, _ = cascade.step(gains, state, -5.0, (wanted,))
    expected = cascade.expected_force(gains, state)
    after = cascade.estimate(gains, state, expected)
    assert after.x_hat[2] == state.v + state.p_hat
    assert after.earlier == state.x_hat[2]
    assert after.p_hat == state.p_hat


@pytest.mark.parametrize("delay", [0, 3, 1.0, True, "2", None])
def test_a_delay_that_no_design_has_is_refused(delay: Any) -> None:
    with pytest.raises(InputError, match=r"designed_delay = .*must be 1 or 2"):
        Params.from_dict({"designed_delay": delay})


def test_the_delay_is_structure_and_one_goes_without_saying() -> None:
    assert Params.from_dict(TWO.to_dict()).designed_delay == 2
    assert "designed_delay" not in ONE.to_dict()
    assert TWO.with_columns({"K2": [1.0, 2.0]})[1].designed_delay == 2
    assert "2 samples of delay" in repr(TWO)
    with pytest.raises(InputError, match="designed_delay = 1, 2: must be one for the whole batch"):
        Params.stack([ONE, TWO])
