"""Shapes in signatures are held while tests run."""

import os

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from jaxmpc.synthesis.kalman import dare
from tests.shapes import with_shapes

Phi, C, Q, R = 0.9 * jnp.eye(2), jnp.ones(2), jnp.eye(2), jnp.asarray(1.0)


def test_right_shapes_pass() -> None:
    assert np.asarray(dare(Phi, C, Q, R)).shape == (2, 2)


@pytest.mark.skipif("SHAPES_UNCHECKED" in os.environ, reason="shapes are not to be checked in this run")
@pytest.mark.parametrize(
    "wrong", [(Phi, C[None], Q, R), (Phi, C, jnp.eye(3), R), (Phi, C, Q, jnp.eye(2)), (Phi[0], C, Q, R)]
)
def test_wrong_ones_are_refused(wrong: tuple[object, ...]) -> None:
    with pytest.raises(TypeCheckError):
        dare(*wrong)  # type: ignore[arg-type]


def test_modules_with_shapes_are_found() -> None:
    found = with_shapes()
    assert {"jaxmpc.metrics", "jaxmpc.synthesis.mpc", "tuning.job.risk"} <= set(found)
    assert "jaxmpc.law.cascade" not in found
