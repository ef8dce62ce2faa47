"""Unconstrained transforms: round trip, derivative, bounds, horizons."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params
from jaxmpc.quantities import HP_MAX, HU_MAX, PARAMETERS
from tuning.job.space import FREE, SearchSpace, axis_of


@pytest.mark.parametrize("name", PARAMETERS)
def test_round_trip_inside_the_bounds(name: str) -> None:
    axis = axis_of(name, None, False)
    middle = np.sqrt(axis.low * axis.high) if axis.log else 0.5 * (axis.low + axis.high)
    for value in (middle, 0.7 * middle + 0.3 * axis.high):
        assert float(axis.value(jnp.asarray(axis.unconstrained(value)))) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("name", PARAMETERS)
def test_one_unit_in_the_middle_is_one_scale(name: str) -> None:
    axis = axis_of(name, None, False)
    slope = jax.grad(lambda z: jnp.log(axis.value(z)) if axis.log else axis.value(z))(0.0)
    assert float(slope) == pytest.approx(axis.scale, rel=1e-12)


@pytest.mark.parametrize("name", PARAMETERS)
def test_derivative_against_central_differences(name: str) -> None:
    axis = axis_of(name, None, False)
    for z in (-1.3, 0.4, 2.0):
        step = 1e-4
        difference = (axis.value(jnp.asarray(z + step)) - axis.value(jnp.asarray(z - step))) / (2 * step)
        assert float(jax.grad(axis.value)(z)) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.parametrize("name", PARAMETERS)
def test_bounds_are_never_left(name: str) -> None:
    axis = axis_of(name, None, False)
    ends = axis.value(jnp.asarray([-1e6, 1e6]))
    np.testing.assert_allclose(ends, [axis.low, axis.high], rtol=1e-12)
    at_bounds = axis.unconstrained(np.asarray([axis.low, axis.high]))
    assert np.isfinite(at_bounds).all()


@pytest.mark.parametrize("name", PARAMETERS)
def test_plain_numbers_have_the_values_of_traced_ones(name: str) -> None:
    axis, z = axis_of(name, None, False), np.linspace(-40.0, 40.0, 81)
    plain = axis.value(z)
    assert isinstance(plain, np.ndarray)
    np.testing.assert_allclose(plain, axis.value(jnp.asarray(z)), rtol=1e-14)  # two libraries' exponentials


def test_a_bound_of_zero_makes_the_axis_linear() -> None:
    axis = axis_of("K2", (0.0, 100.0), False)
    assert float(axis.value(jnp.asarray(axis.unconstrained(40.0)))) == pytest.approx(40.0)
    assert float(axis.value(jnp.asarray(-1e6))) == 0.0


def test_space_encodes_what_is_free_and_keeps_the_rest() -> None:
    text = Params.published("text")
    space = SearchSpace(text, [axis_of(name, None, False) for name in ("Khat_s", "Hp", "Hu")])
    found = space.exact(space.encode(text))
    assert float(found.Khat_s) == pytest.approx(900.0)
    assert (float(found.Hp), float(found.Hu), float(found.Q_p)) == (30.0, 5.0, 0.5)


def test_horizons_are_rounded_at_width_one_only_and_stay_ordered() -> None:
    space = SearchSpace(Params.published("text"), [axis_of("Hp", (2, 20), False), axis_of("Hu", (1, 16), False)])
    z = np.concatenate([axis.unconstrained(value)[None] for axis, value in zip(space.axes, (4.4, 9.7), strict=True)])
    soft, hard = (jax.jit(space.decode)(z, width) for width in (2.0, 1.0))  # no controller yet where it is soft
    assert float(soft.Hp) == pytest.approx(4.4)
    assert (float(hard.Hp), float(hard.Hu)) == (4.0, 4.0)


def test_a_guard_is_left_out_while_tuning_and_comes_back_with_the_result() -> None:
    space = SearchSpace(Params(guarded=True), [axis_of("Khat_s", None, False)])
    z = space.encode(space.base)
    assert (space.decode(jnp.asarray(z), 1.0).guarded, space.exact(z).guarded) == (False, True)


def test_diagonals_have_one_number_per_entry() -> None:
    lam = np.geomspace(0.01, 1.0, HU_MAX)
    params = Params(lam=lam)
    space = SearchSpace(params, [axis_of("lam", None, True), axis_of("delta", None, True), axis_of("Q_p", None, False)])
    assert space.size == HU_MAX + HP_MAX + 1
    found = space.exact(space.encode(params))
    np.testing.assert_allclose(found.lam, lam, rtol=1e-12)
    np.testing.assert_allclose(found.delta, np.full(HP_MAX, 0.9), rtol=1e-12)
    assert space.names[HU_MAX] == "delta[1]"


def test_draws_are_inside_the_bounds_and_repeat() -> None:
    space = SearchSpace(Params.published("text"), [axis_of(name, None, False) for name in FREE])
    drawn = space.draw(50, seed=3)
    np.testing.assert_array_equal(drawn, space.draw(50, seed=3))
    assert not np.array_equal(drawn, space.draw(50, seed=4))
    values = space.values(drawn)
    for column, axis in zip(values.T, space.axes, strict=True):
        assert (column > axis.low).all()
        assert (column < axis.high).all()
