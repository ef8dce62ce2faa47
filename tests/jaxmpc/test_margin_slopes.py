"""Slopes of margins against central differences, of batches and of loops that are unstable."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, margins
from jaxmpc.stability import Margins

NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")
MODES = {"forward": jax.jacfwd, "reverse": jax.jacrev}


@partial(jax.jit, static_argnames=("ideal", "modes"))
def judged(x: jax.Array, stiffness: jax.Array, ideal: bool, modes: tuple[str, ...]) -> tuple[jax.Array, ...]:
    """All margins, and their slopes in each mode: one program."""

    def twice(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        params = Params(**dict(zip(NAMES, jnp.exp(x), strict=True)))
        values = jnp.stack(margins(params, stiffness, ideal=ideal)[:6])
        return values, values

    found = [MODES[mode](twice, has_aux=True)(x) for mode in modes]
    return found[0][1], *(slopes for slopes, _ in found)


@pytest.mark.oracle
@pytest.mark.parametrize(("ideal", "modes"), [(False, ("forward", "reverse")), (True, ("reverse",))])
def test_gradient_of_every_margin_is_the_central_difference(ideal: bool, modes: tuple[str, ...]) -> None:
    point = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))

    def at(x: jax.Array) -> list[np.ndarray]:
        return [np.asarray(found) for found in judged(x, 1500.0, ideal, modes)]

    step = 1e-5
    shifts = step * np.eye(len(point))
    difference = np.stack([(at(point + s)[0] - at(point - s)[0]) / (2 * step) for s in shifts], axis=1)
    for jacobian in at(point)[1:]:
        for ours, expected in zip(jacobian, difference, strict=True):
            np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.oracle
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
    soft = Params(Khat_s=200.0)
    point = jnp.log(jnp.array([float(getattr(soft, name)) for name in NAMES]))
    found, slopes = judged(point, 1900.0, True, ("reverse",))
    radius = Margins._fields.index("spectral_radius")
    assert found[radius] > 1.0
    assert np.isfinite(slopes[radius]).all()
    assert slopes[radius, NAMES.index("Khat_s")] < 0.0
