"""The loop's response in closed form, and that of the filter of the force, against independent models."""

from collections.abc import Callable
from typing import Any

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, design, margins
from jaxmpc.law import cascade
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.stability.controller import filter_response
from jaxmpc.stability.crossings import loop_margins
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, transition_matrix
from jaxmpc.stability.response import loop_response
from jaxmpc.world.contact import init as begin_contact
from jaxmpc.world.contact import move, sense
from jaxmpc.world.loop_path import loop_path
from tests.jaxmpc.judged_loops import CASES, LATE, PARABOLIC, SENSOR, T_S, radius

FILTERED = loop_path(force_filter=ForceFilter(T_S, 0.3, 40.0))


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES[:7], PARABOLIC, *LATE])
def test_closed_form_response_is_that_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    """1/(1 + L) is also the response of the running loop, from noise added before the cut to behind it.

    Noise on the sensor sees the force loop alone: y/noise = 1/(1 + L_v) when cut at v.
    """
    gains = design(params)
    sensor = 0.0 if ideal else SENSOR
    A, B, C, D = independent_loop(gains, K_s, float(params.K2), delay, ideal, sensor)
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    for omega in 2 * np.pi * np.array([0.7, 5.0, 30.0, 120.0, 450.0]):
        z = np.exp(1j * omega * T_S)
        expected = (C @ np.linalg.solve(z * np.eye(len(A)) - A, B[:, 1]) + D[:, 1])[0]
        ours = 1.0 / (1.0 + loop_response(gains, contact, jnp.float64(omega * T_S), 0.0))
        np.testing.assert_allclose(complex(ours), expected, rtol=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES, *LATE])
def test_the_cut_at_the_force_is_the_cut_at_v(params: Params, K_s: float, delay: int, ideal: bool) -> None:
    """What comes back of a force added to the measured one, from one sample of law and world, differentiated."""
    gains = design(params)
    gains = gains._replace(mpc_ref=gains.mpc_ref[:1])
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))

    def one_sample(controller: Any, world: Any) -> Any:
        state, added, _ = world
        force, state = sense(contact, state, jnp.zeros(()))
        controller, v = cascade.step(gains, controller, force + added, (jnp.zeros(()),))
        return controller, (move(contact, state, v)[0], jnp.zeros(()), force + added)

    begin = cascade.init(gains, jnp.zeros(())), (begin_contact(jnp.zeros(())), jnp.zeros(()), jnp.zeros(()))
    whole = np.asarray(transition_matrix(gains, one_sample, *begin))
    A, B, C = whole[:-2, :-2], whole[:-2, -2], whole[-1, :-2]
    for theta in np.geomspace(1e-2, 3.1, 40):
        S = 1.0 + C @ np.linalg.solve(np.exp(1j * theta) * np.eye(len(A)) - A, B)
        expected = 1.0 / (1.0 + complex(loop_response(gains, contact, theta, 0.0)))
        # Both lose digits near the loops' poles, which lie at 1 within some 1e-3.
        assert abs(S - expected) < 1e-8 * abs(expected)


def test_filter_of_the_force_is_that_of_python_control() -> None:
    """Constant rate, corrected by the innovation; at once, so the output is that after the correction."""
    T_s, K_y, K_r = FILTERED.force_filter
    predict, K = np.array([[1.0, T_s], [0.0, 1.0]]), np.array([[K_y], [K_r]])
    A = (np.eye(2) - K @ [[1.0, 0.0]]) @ predict
    system = control.ss(A, K, A[:1], K[:1], T_s)
    theta = np.array([1e-3, 0.03, 0.4, 3.0])
    found = filter_response(FILTERED.force_filter, jnp.exp(-1j * theta))
    np.testing.assert_allclose(found, system(np.exp(1j * theta)), rtol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("K_s", [375.0, 1900.0])
def test_margins_with_a_filter_of_the_force_are_the_gains_that_the_law_bears(K_s: float) -> None:
    """Cut at a, the gain of both hold integrals is that of the whole loop; the matrix is the running law's own."""
    params = Params.published("cautious")
    gains = design(params, force_filter=FILTERED.force_filter)
    contact = contact_of(K_s, params.K2, FILTERED)

    @jax.jit
    def found(cut: float) -> Any:
        return loop_margins(*[lambda theta, late=None: loop_response(gains, contact, theta, cut, late)] * 2, T_S)

    at_a = found(1.0)
    for decibels in (float(at_a.gain_margin_db), -float(at_a.gain_reduction_db)):
        scaled = contact._replace(gamma=tuple(10.0 ** (decibels / 20.0) * each for each in contact.gamma))
        assert radius(np.asarray(closed_loop_matrix(gains, scaled))) == pytest.approx(1.0, abs=1e-6)
    judged = margins(params, K_s, path=FILTERED)
    assert float(judged.M_s) == pytest.approx(max(float(at_a.M_s), float(found(0.0).M_s)), rel=1e-9)
    assert float(judged.M_s) > 1.05 * float(margins(params, K_s).M_s)
