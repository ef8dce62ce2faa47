"""What the calls of a program share, on every device, and what one program leaves there for another."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc.xla.blocks import OverDevices, fetched


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


def halved(rows: Any, shared: Any) -> Any:
    return 0.5 * rows, rows > shared


def kept(rows: Any, shared: Any) -> Any:
    values, wanted = rows
    return jnp.where(wanted, values, shared)


@pytest.mark.parametrize("count", [1, 7, 8])  # of which two devices cannot share the first two
def test_rows_that_one_program_leaves_on_the_devices_go_into_another_that_was_compiled_for_numpy(count: int) -> None:
    first, second, rows = OverDevices(halved), OverDevices(kept), np.arange(float(count))
    threshold = second.everywhere(np.float64(2.0))
    second.compile((rows, np.ones(count, bool)), threshold)
    compiled: list[str] = []

    def heard(event: str, *_: Any, **__: Any) -> None:
        compiled.extend([event] if "backend_compile" in event else [])

    there = first.launched(rows, threshold)
    assert all(isinstance(leaf, jax.Array) for leaf in there)
    jax.monitoring.register_event_duration_secs_listener(heard)
    found = second.launched((rows,), threshold, there[1])
    jax.monitoring.unregister_event_duration_listener(heard)
    (half, wanted), values = fetched((there, found), count)
    np.testing.assert_array_equal(half, 0.5 * rows)
    np.testing.assert_array_equal(wanted, rows > 2.0)
    np.testing.assert_array_equal(values, np.where(rows > 2.0, rows, 2.0))
    np.testing.assert_array_equal(second((rows, rows > 2.0), threshold), values)
    assert (second.programs, compiled) == (1, [])
