"""Acceleration asked of the robot from frequency responses, and its change per sample.

Oracles: the independent state space of `conftest`, its Lyapunov equation, the linear loop step by step.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.flatten_util
import msgspec
import numpy as np
import pytest
import scipy.linalg

from jaxmpc import Params, design
from jaxmpc.engine.scenario import scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.spectra.effort import chatter_rms, effort_responses, effort_rms
from jaxmpc.spectra.spectrum import spectrum_of
from jaxmpc.stability.loop import contact_of
from tests.jaxmpc.linear_loop import SILENT, TEXT, cases, check_gradient, matrices, settling, step_by_step, world

NERVOUS = Params(K2=28.3, T_cl=1.5e-4, Khat_s=1900.0, Q_p=90.0, Q_x=7.9, lam=2.1, delta=0.9, Hp=19, Hu=13)
CASES = cases(NERVOUS)


def asking(build: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool) -> tuple[Any, ...]:
    """The independent loop from heart, noise and an acceleration that acts at once to what is asked: a = v − K₂ẋ_f.

    Command and filtered velocity of a sample are in the state that it leaves.
    """
    A, B, *_ = matrices(build, params, K_s, delay, ideal)
    B = B[:, [0, 1, 3]]
    a = np.zeros((1, len(A)))
    a[0, 5], a[0, 10] = 1.0, 0.0 if ideal else -float(params.K2)
    return A, B, a @ A, a @ B


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), CASES)
def test_responses_are_those_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    A, B, C, D = asking(independent_loop, params, K_s, delay, ideal)
    theta = np.array([2e-3, 0.02, 0.15, 1.0, 3.0])
    found = effort_responses(design(params), world(params, K_s, delay, ideal), theta)
    for i, angle in enumerate(theta):
        heart, noise, pushed = (C @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(A)) - A, B) + D)[0]
        # The state space loses some five digits at the lowest angle, where it is nearly singular.
        for value, expected in zip(found, (heart, pushed, noise), strict=True):
            assert complex(value[i]) == pytest.approx(complex(expected), rel=1e-7)


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), CASES)
def test_noise_is_summed_like_the_variance_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    A, B, C, D = asking(independent_loop, params, K_s, delay, ideal)
    A, B, C = settling(params, A, B, C)
    B, D = B[:, 1:2], D[:, 1:2]
    # One more state keeps the acceleration of the sample before.
    A, B = np.block([[A, np.zeros((len(A), 1))], [C, np.zeros((1, 1))]]), np.vstack([B, D])
    P = scipy.linalg.solve_discrete_lyapunov(A, B @ B.T)
    for rms, before in ((effort_rms, 0.0), (chatter_rms, -1.0)):
        row = np.append(C, [[before]], axis=1)
        expected = math.sqrt((row @ P @ row.T + D @ D.T).item())
        found = rms(design(params), world(params, K_s, delay, ideal), SILENT)
        np.testing.assert_allclose(found, expected * SILENT.noise, rtol=0.005)


@pytest.mark.oracle
def test_frequency_gives_effort_and_chatter_of_the_linear_loop() -> None:
    """With heart, noise and rounding to the sensor's LSB as an experiment simulates them."""
    experiment = msgspec.structs.replace(Experiment.published("table-1-wam"), physics="linear")
    both, stiffness = Params.stack([TEXT, NERVOUS]), np.array([375.0, 1900.0])
    path = experiment.loop_path()
    contacts = jax.vmap(lambda K2: jax.vmap(lambda K_s: contact_of(K_s, K2, path))(stiffness))(both.K2)
    scene, gains, spectrum = scenario_data(experiment), design(both), spectrum_of(experiment)
    simulated, *_ = step_by_step(gains, contacts, scene.lsb, scene.signals)

    def in_frequency(gains: Any, contact: Any) -> Any:
        return effort_rms(gains, contact, spectrum), chatter_rms(gains, contact, spectrum)

    effort, chatter = jax.jit(jax.vmap(jax.vmap(in_frequency, (None, 0))))(gains, contacts)
    # The text design rings on the hardest tissue: 20 s of noise settle its effort to 1.4 % and its chatter to 0.9 %,
    # one σ. And the window of the spectrum counts the outer ones of 6.8 breaths less.
    np.testing.assert_allclose(effort, simulated.effort, rtol=0.04)
    np.testing.assert_allclose(chatter, simulated.chatter, rtol=0.03)


@pytest.mark.oracle
@pytest.mark.parametrize("rms", [effort_rms, chatter_rms])
def test_gradients_are_those_of_central_differences(rms: Callable[..., Any]) -> None:
    check_gradient(rms, NERVOUS)
