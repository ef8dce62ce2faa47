"""What is worked out of plain arrays needs no program."""

import jax.numpy as jnp
import numpy as np

from jaxmpc.xla.plain import library


def test_one_array_of_jax_anywhere_asks_for_it() -> None:
    assert library(1.0, {"a": np.ones(2)}, [None]) is np
    assert library(1.0, {"a": jnp.ones(2)}) is jnp
