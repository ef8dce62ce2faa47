"""What the calls of a program share, on every device."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc.xla.blocks import OverDevices


def scaled(rows: Any, shared: Any) -> Any:
    by, plus, width = shared
    return rows * by[0] + plus[0] * width


def test_arrays_of_the_call_before_are_there_and_what_may_have_changed_is_put_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program, rows, put, device_put = OverDevices(scaled), np.arange(4.0), [], jax.device_put

    def noted(arrays: Any, where: Any) -> Any:
        put.append(len(jax.tree.leaves(arrays)))
        return device_put(arrays, where)

    monkeypatch.setattr(jax, "device_put", noted)
    by, plus = jnp.array([2.0]), np.array([1.0])
    np.testing.assert_array_equal(program(rows, (by, plus, 1.0)), 2.0 * rows + 1.0)
    plus[0] = 5.0
    np.testing.assert_array_equal(program(rows, (by, plus, 3.0)), 2.0 * rows + 15.0)
    np.testing.assert_array_equal(program(rows, (jnp.array([7.0]), plus, 1.0)), 7.0 * rows + 5.0)
    there = program.everywhere((by, plus, 1.0))
    np.testing.assert_array_equal(program(rows, there), 2.0 * rows + 5.0)
    np.testing.assert_array_equal(program(rows, there), 2.0 * rows + 5.0)
    assert put == [3, 2, 3, 3, 3, 0]
