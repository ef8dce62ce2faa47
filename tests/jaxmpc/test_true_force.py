"""The force on the tissue itself from frequency responses. Oracles: the independent loop, the linear one in time."""

from collections.abc import Callable
from typing import Any

import jax
import msgspec
import numpy as np
import pytest

from jaxmpc import Params, design, swing
from jaxmpc.engine.scenario import scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.spectra.spectrum import spectrum_of
from jaxmpc.spectra.true_force import swing_responses, swing_rms, true_responses, true_rms
from jaxmpc.stability.loop import contact_of
from tests.jaxmpc.linear_loop import DAMPED, TEXT, cases, check_gradient, matrices, step_by_step, world

TIP = 6
"""State of the independent loop in which the tip's position is kept."""


@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), cases(DAMPED))
def test_responses_are_those_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    """K_s (x − x_heart) of the sample, straight from its state."""
    A, B, *_ = matrices(independent_loop, params, K_s, delay, ideal)
    C, D = K_s * np.eye(len(A))[TIP], np.array([-K_s, 0.0, 0.0])
    theta = np.array([2e-3, 0.02, 0.15, 1.0, 3.0])
    contact, gains = world(params, K_s, delay, ideal), design(params)
    found, above = true_responses(gains, contact, theta), swing_responses(gains, contact, theta)
    passed = swing.gain(theta, 1e-3, np)
    for i, angle in enumerate(theta):
        heart, noise, pushed = C @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(A)) - A, B[:, [0, 1, 3]]) + D
        for value, over, expected in zip(found, above, (heart, pushed, noise), strict=True):
            # The state space loses some five digits at the lowest angle, where it is nearly singular.
            assert complex(value[i]) == pytest.approx(complex(expected), rel=1e-7)
            assert complex(over[i]) == pytest.approx(passed[i] * complex(expected), rel=1e-7)


@pytest.mark.oracle
def test_frequency_gives_true_force_and_swinging_of_the_linear_loop() -> None:
    """With heart, noise and rounding to the sensor's LSB as an experiment simulates them."""
    experiment = msgspec.structs.replace(Experiment.published("table-1-wam"), physics="linear")
    both, stiffness = Params.stack([TEXT, DAMPED]), np.array([375.0, 1900.0])
    path = experiment.loop_path()
    contacts = jax.vmap(lambda K2: jax.vmap(lambda K_s: contact_of(K_s, K2, path))(stiffness))(both.K2)
    scene, gains, spectrum = scenario_data(experiment, swinging=True), design(both), spectrum_of(experiment)
    simulated, *_ = step_by_step(gains, contacts, scene.lsb, scene.signals)

    def in_frequency(gains: Any, contact: Any) -> Any:
        return true_rms(gains, contact, spectrum), swing_rms(gains, contact, spectrum)

    true, swinging = jax.jit(jax.vmap(jax.vmap(in_frequency, (None, 0))))(gains, contacts)
    # The record has 6.8 breaths, and its window counts the ends less, as for the measured residual.
    np.testing.assert_allclose(true, simulated.true_rms, rtol=0.03)
    # 10 s of noise through a loop that rings at 24 Hz, ζ of some 0.1, settle to 4 %, one σ.
    np.testing.assert_allclose(swinging, simulated.swing, rtol=0.1)


@pytest.mark.oracle
@pytest.mark.parametrize("rms", [true_rms, swing_rms])
def test_gradients_are_those_of_central_differences(rms: Callable[..., Any]) -> None:
    check_gradient(rms, DAMPED)
