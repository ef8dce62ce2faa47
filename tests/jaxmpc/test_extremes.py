"""The least and the greatest of a few numbers, and their slopes."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.xla.extremes import greatest, least
from tuning.job.risk import Risk


def test_what_is_not_a_number_stays_so() -> None:
    assert least(jnp.array([2.0, 1.0, 3.0])) == 1.0
    assert greatest(jnp.array([2.0, 1.0, 3.0])) == 3.0
    for one in least, greatest:
        assert np.isnan(one(jnp.array([2.0, np.nan, 1.0])))


def test_where_two_are_equal_one_has_the_slope() -> None:
    """That of `jnp.min` and `jnp.max` is shared, by a comparison that may find none equal."""
    np.testing.assert_array_equal(jax.grad(least)(jnp.array([1.0, 2.0, 1.0])), [1.0, 0.0, 0.0])
    for one in greatest, Risk("worst").over:
        np.testing.assert_array_equal(jax.grad(one)(jnp.array([1.0, 2.0, 2.0])), [0.0, 1.0, 0.0])


def test_all_dimensions_but_the_last_stay() -> None:
    values = jnp.array(np.random.default_rng(0).standard_normal((2, 3, 4)))
    np.testing.assert_array_equal(least(values), jnp.min(values, axis=-1))
    np.testing.assert_array_equal(greatest(values), jnp.max(values, axis=-1))
