"""Slopes of margins against central differences, of batches and of loops that are unstable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, margins

NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")


@pytest.mark.parametrize(
    ("ideal", "mode"),
    [
        pytest.param(False, "reverse", marks=pytest.mark.oracle),
        pytest.param(True, "reverse", marks=pytest.mark.oracle),
        pytest.param(False, "forward", marks=pytest.mark.oracle),
    ],
)
def test_gradient_of_every_margin_is_the_central_difference(ideal: bool, mode: str) -> None:
    point = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))

    @jax.jit
    def values(x: jax.Array) -> jax.Array:
        params = Params(**dict(zip(NAMES, jnp.exp(x), strict=True)))
        return jnp.stack(margins(params, 1500.0, ideal=ideal)[:6])

    jacobian = np.asarray({"forward": jax.jacfwd, "reverse": jax.jacrev}[mode](values)(point))
    step = 1e-5
    shifts = step * np.eye(len(point))
    difference = np.stack([(values(point + s) - values(point - s)) / (2 * step) for s in shifts], axis=1)
    for ours, expected in zip(jacobian, difference, strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())


def test_slopes_of_a_batch_of_loops_are_numbers() -> None:
    """Of all loops that are stable: programs of jax 0.10 and 0.11 lost half of them to a derivative of `jnp.min`."""
    point = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))
    points = point + 0.3 * np.random.default_rng(0).standard_normal((32, len(point)))

    def worst(x: jax.Array) -> jax.Array:
        return margins(Params(**dict(zip(NAMES, jnp.exp(x), strict=True))), np.array([375.0, 810.0, 1900.0])).M_s

    assert np.isfinite(jax.jit(jax.vmap(jax.jacfwd(worst)))(points)).all()


@pytest.mark.oracle
def test_unstable_loops_have_a_radius_with_a_gradient() -> None:
    """A tuner that starts there must be able to walk to stability."""
    slope = jax.grad(lambda k: margins(Params(Khat_s=k), 1900.0, ideal=True).spectral_radius)(200.0)
    assert np.isfinite(slope)
    assert slope < 0.0
