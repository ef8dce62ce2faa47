"""The linear loop as the tests of residual and chatter take it, the independent one with one more input."""

from collections.abc import Callable
from typing import Any

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxmpc import Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.engine.linear_scan import over_cells, run
from jaxmpc.experiment import Experiment
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of
from jaxmpc.stability.loop import contact_of
from jaxmpc.world.contact import hertz
from jaxmpc.world.loop_path import loop_path

T_S = 1e-3
SENSOR = hertz(500.0)
TEXT = Params()
DAMPED = Params(K2=40.0, T_cl=2e-4, Khat_s=800.0, Q_p=1.5)
SILENT = Spectrum(np.ones(2), np.zeros((3, 2), complex), np.zeros((3, 2), complex), np.array([0.5, 1.0, 2.0]))
"""Noise of the sensor alone."""
REFERENCE = 4
"""State of the independent loop in which the MPC's output is kept."""


def cases(other: Params) -> list[tuple[Params, float, int, bool]]:
    """Controllers on tissues, with their delay, on a perfect robot or not."""
    return [
        (TEXT, 375.0, 1, True),
        (TEXT, 810.0, 2, False),
        (other, 1900.0, 1, False),
        (DAMPED, 810.0, 2, True),
        (Params(architecture="aob"), 810.0, 1, False),
    ]


def world(params: Params, K_s: Any, delay: int, ideal: bool) -> Any:
    return contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))


def matrices(build: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool) -> tuple[Any, ...]:
    """The independent loop with a fourth input: the acceleration that acts on the tip at once."""
    A, B, C, D = build(design(params), K_s, float(params.K2), delay, ideal, 0.0 if ideal else SENSOR)
    block = np.zeros((3, 3))
    block[:2] = [[0.0, 1.0, 0.0], [0.0, -float(params.K2) if ideal else 0.0, 1.0]]
    pushed = np.zeros((len(A), 1))
    pushed[6:8, 0] = scipy.linalg.expm(block * T_S)[:2, 2]
    return A, np.hstack([B, pushed]), C, np.append(D, [[0.0]], axis=1)


def settling(params: Params, A: Any, B: Any, C: Any) -> tuple[Any, Any, Any]:
    """What decays of it: the unused reference generator of the observer alone sums up nothing for ever."""
    keep = (np.arange(len(A)) != REFERENCE) | (params.architecture != "aob")
    return A[keep][:, keep], B[keep], C[:, keep]


@jax.jit
def step_by_step(gains: Any, *cells: Any) -> Any:
    return over_cells(run, scalars(gains, False), *cells)


def check_gradient(rms: Callable[..., Any], params: Params) -> None:
    """Of log(rms) by the logarithm of each gain, against central differences."""
    spectrum = spectrum_of(Experiment.published("table-1-wam"))
    contact = world(params, 810.0, 1, False)
    flat, restore = jax.flatten_util.ravel_pytree(design(params))

    @jax.jit
    @jax.value_and_grad
    def loss(logs: Any) -> Any:
        return jnp.sum(jnp.log(rms(restore(flat * jnp.exp(logs)), contact, spectrum)))

    zero, step = np.zeros(len(flat)), 1e-5
    differences = [(loss(step * row)[0] - loss(-step * row)[0]) / (2.0 * step) for row in np.eye(len(flat))]
    gradient = loss(zero)[1]
    # Both are good to 1e-9 of the largest component: step² of the third derivative.
    np.testing.assert_allclose(gradient, differences, atol=1e-7 * float(jnp.max(jnp.abs(gradient))))
