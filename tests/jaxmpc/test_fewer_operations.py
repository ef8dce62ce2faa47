"""A step taken apart and put together again: its numbers stay, what it takes becomes less."""

from collections import Counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc.engine.fewer_operations import Instructions, lean
from jaxmpc.engine.lane_ops import lane_ops, plainly_fused, sines, turned
from jaxmpc.engine.tangents import pushed

EXACT = Instructions(lambda value: 1.0 / value, jnp.sqrt, plainly_fused)
OPS = lane_ops(jnp.float32)
C, X, Y = (jnp.linspace(low, 3.0, 7, dtype=jnp.float32) for low in (1.0, -2.0, 0.5))


def operations(function: Any, *arguments: Any) -> Counter[str]:
    """How many of each kind are left."""
    jaxpr = jax.make_jaxpr(lambda *each: lean(function, EXACT, *each))(*arguments).jaxpr
    return Counter(equation.primitive.name for equation in jaxpr.eqns)


def check_same(function: Any, *arguments: Any) -> None:
    found, expected = lean(function, EXACT, *arguments), function(*arguments)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6), found, expected)


def test_quotients_become_products() -> None:
    """A denominator is inverted once, and 1 is multiplied by nothing."""
    asked = []

    def reciprocal(value: Any) -> Any:
        asked.append(value)
        return 1.0 / value

    def function(c: Any, x: Any, y: Any) -> Any:
        return {"a": x / y + 2.0 / y, "b": jnp.where(x > 0.0, x / 3.0, -x), "c": 1.0 / y}

    found = lean(function, Instructions(reciprocal, jnp.sqrt, plainly_fused), C, X, Y)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-6), found, function(C, X, Y))
    assert len(asked) == 2


def test_slopes_of_quotients_become_products_too() -> None:
    """The slope of 1/x asks for x⁻², and what has a rule of its own is seen into."""
    asked = []

    def reciprocal(value: Any) -> Any:
        asked.append(value)
        return 1.0 / value

    @jax.custom_jvp
    def ruled(x: Any) -> Any:
        return 1.0 / x

    ruled.defjvp(lambda at, along: (ruled(*at), along[0]))

    def function(x: Any) -> Any:
        return jax.jvp(lambda x: 2.0 / x, (x,), (jnp.ones_like(x),)), ruled(x + 1.0), x**-3, x**5, x**0

    found, wanted = lean(function, Instructions(reciprocal, jnp.sqrt, plainly_fused), Y), function(Y)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-6), found, wanted)
    assert len(asked) == 2


def test_a_product_is_added_in_one_instruction() -> None:
    """Unless something else needs it too, or it is of whole numbers."""
    asked = []

    def fused(*each: Any) -> Any:
        asked.append(each)
        return plainly_fused(*each)

    def function(c: Any, x: Any, y: Any) -> Any:
        once = x * y + c, c - x * c, y * c - x, (x * x + y * y) + c, c * c - 2.0, c - 3.0 * y
        twice, wanted, whole = jnp.exp(x) * y, y * y * c, jnp.int32(2) * jnp.arange(7) + 1
        return *once, twice + c, twice - x, wanted, wanted + x, whole

    processor = Instructions(lambda value: 1.0 / value, jnp.sqrt, fused)
    jax.tree.map(
        lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6),
        lean(function, processor, C, X, Y),
        function(C, X, Y),
    )
    assert len(asked) == 6


def test_sums_of_products_take_one_instruction_a_product() -> None:
    """But the first; whatever is added or taken away, in whichever order, and numbers with it."""
    made = []

    def fused(one: Any, other: Any, rest: Any) -> Any:
        made.append(1)
        return plainly_fused(one, other, rest)

    def function(c: Any, x: Any, y: Any) -> Any:
        return (c * x + x * y) - ((c * c - y * y) - (x + 2.0)) - (y - c * (x * x))

    counting = EXACT._replace(fused=fused)
    jaxpr = jax.make_jaxpr(lambda *each: lean(function, counting, *each))(C, X, Y).jaxpr
    kinds = Counter(equation.primitive.name for equation in jaxpr.eqns)
    # Five products go into a sum of eight terms, one of them taking the first term with it; x² has to be there before.
    assert len(made) == 5
    assert kinds["mul"] == 5 + 1
    assert kinds["add"] + kinds["sub"] == 7
    check_same(function, C, X, Y)


@pytest.mark.parametrize("seed", range(40))
def test_random_sums_stay_what_they_are(seed: int) -> None:
    """With terms that something else needs too, or that are wanted themselves, and along a direction."""
    random = np.random.default_rng(seed)
    drawn = [(*random.integers(3 + i, size=2), random.integers(5)) for i in range(25)]

    def function(*given: Any) -> Any:
        there = list(given)
        for i, j, kind in drawn:
            one, other = there[i], there[j]
            there.append([one * other, one * other, one + other, one - other, one + 0.5][kind])
        return there[-6:]

    def pushed_on(*given: Any) -> Any:
        found, slopes = jax.jvp(function, given, given[::-1])
        return [*found, *slopes]

    wide = [each.astype(jnp.float64) for each in (C, X, Y)]
    for found, wanted in zip(lean(pushed_on, EXACT, *wide, values=6), pushed_on(*wide), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_what_is_linearised_stays_what_it_is() -> None:
    """Along two directions, with ties of the extremes, a choice, a sign, a root, sines and tangents that are added."""

    def function(c: Any, x: Any, y: Any) -> Any:
        extremes = OPS.maximum(x, c) * OPS.minimum(y, x + y - x) - OPS.clip(x * y, -c, c)
        chosen = OPS.where(x > 0.0, x / (y + c), abs(x)) + OPS.sqrt(x * x + y) * jnp.sign(x) * y**-2
        turned = OPS.sin(OPS.near(x + 0.01 * y, x)) * OPS.cos(x) + OPS.exp(x) * OPS.log(y)
        return extremes, chosen, turned, OPS.floor(x * y), OPS.replaced(x, y)

    along = [[1.0 * X, 2.0 * Y], [C, X]]

    def linearised(c: Any, along: Any, x: Any, y: Any) -> Any:
        return pushed(function, (c, x, y), (False, True, True), along)

    for x, y in ((X, Y), (C, C), (-C, Y)):
        check_same(linearised, C, along, x, y)
    left = operations(linearised, C, along, X, Y)
    assert not left.keys() & {"add_any", "integer_pow", "custom_jvp_call", "jit", "pjit"}
    assert left["shift_left"] == 1


def test_an_angle_near_another_has_its_own_slope() -> None:
    for dtype in (jnp.float32, jnp.float64):
        near = lane_ops(dtype).near
        for function in (near, lambda *each, near=near: lean(near, EXACT, *each)):
            x, y = X.astype(dtype), Y.astype(dtype)
            np.testing.assert_array_equal(function(x, y), x)
        np.testing.assert_array_equal(jax.jvp(near, (x, y), (y, x))[1], y)


def test_an_angle_is_not_turned_from_itself() -> None:
    check_same(lambda c, x, y: OPS.sin(OPS.near(x, x)) + OPS.cos(x), C, X, Y)


def test_products_with_nothing_and_with_one_are_what_they_are() -> None:
    zero, one = jnp.zeros(7, jnp.float32), jnp.ones(7, jnp.float32)
    check_same(lambda c, x, y: (x * zero, zero * x, x * one, one * x, x * 0.0, y / one), C, X, Y)
    assert "mul" not in operations(lambda x: (x * 1.0, 1.0 * x), X)
    # What is nothing is a number then, which a choice, an extreme and another product have to stand.
    check_same(lambda c, x, y: (jnp.where(c > y, 0.0 * x, y), jnp.maximum(x * 0.0, y), c * -(0.0 * x)), C, X, Y)
    assert set(operations(lambda x, y: x - y * (0.0 * x) * y, X, Y)) <= {"copy"}


def test_slopes_of_the_extremes_are_those_of_what_they_take() -> None:
    """Where both are equal, of either."""
    for dtype in (jnp.float32, jnp.float64):
        lane = lane_ops(dtype)
        for one, other in ((2.0, 1.0), (1.0, 2.0)):
            at, along = (dtype(one), dtype(other)), (dtype(3.0), dtype(5.0))
            high, low = (3.0, 5.0) if one > other else (5.0, 3.0)
            assert jax.jvp(lane.maximum, at, along)[1] == high
            assert jax.jvp(lane.minimum, at, along)[1] == low
        for value, slope in ((0.5, 3.0), (-2.0, 5.0), (2.0, 7.0)):
            at, along = (dtype(value), dtype(-1.0), dtype(1.0)), (dtype(3.0), dtype(5.0), dtype(7.0))
            assert jax.jvp(lane.clip, at, along)[1] == slope
        for extreme in (lane.maximum, lane.minimum):
            assert jax.jvp(extreme, (dtype(1.0), dtype(1.0)), (dtype(3.0), dtype(5.0)))[1] in (3.0, 5.0)


def test_a_choice_between_something_and_one_is_made_once() -> None:
    def function(c: Any, x: Any, y: Any) -> Any:
        return jnp.where(x > c, c, 1.0) / jnp.where(x > c, x, 1.0)

    check_same(function, C, X * 2.0, Y)
    check_same(function, C, 0.0 * X, Y)
    assert operations(function, C, X, Y)["select_n"] == 1


def test_what_is_equal_is_computed_once() -> None:
    def function(c: Any, x: Any, y: Any) -> Any:
        return x * y + c, jnp.maximum(y * x, c), jnp.maximum(c, x * y)

    check_same(function, C, X, Y)
    assert operations(function, C, X, Y) == {"mul": 1, "add": 1, "max": 1}


def test_nothing_is_added_where_it_is_zero() -> None:
    def function(c: Any, x: Any, y: Any) -> Any:
        return 0.0 + x * y - 0.0, y + 0.0 * jnp.ones(7, jnp.float32)

    check_same(function, C, X, Y)
    assert operations(lambda x: 0.0 + x - 0.0 + 0.0, X) == {}


def test_a_tangent_comes_as_soon_as_it_can() -> None:
    """JAX traces it after all values: here x² and its slope come before what is made of x²."""

    def function(x: Any, along: Any) -> Any:
        value, slope = jax.linearize(lambda x: jnp.exp(x * x + 1.0), x)
        return value, slope(along)

    def order(values: int | None) -> list[str]:
        jaxpr = jax.make_jaxpr(lambda *each: lean(function, EXACT, *each, values=values))(X, Y).jaxpr
        return [equation.primitive.name for equation in jaxpr.eqns]

    check_same(function, X, Y)
    assert order(1).index("exp") > order(None).index("exp")
    assert sorted(order(1)) == sorted(order(None))


def test_sines_of_near_angles_are_turned() -> None:
    """To the last digits of float32, 0.1 rad away, and with a slope."""
    angle = np.linspace(-7.0, 7.0, 20_001).astype(np.float32)
    for apart in (1e-4, 0.01, -0.1):
        other = angle + np.float32(apart)
        found = turned(*sines(jnp.asarray(angle)), jnp.asarray(other - angle))
        for one, exact in zip(found, (np.sin, np.cos), strict=True):
            np.testing.assert_allclose(one, exact(other.astype(np.float64)), rtol=0, atol=3.6e-7)

    def function(c: Any, x: Any, y: Any) -> Any:
        close = OPS.near(x + 0.01 * y, x)
        return OPS.sin(x), OPS.cos(close), OPS.sin(close)

    check_same(function, C, X, Y)
    assert operations(function, C, X, Y)["shift_left"] == 1

    def slopes(c: Any, x: Any, y: Any) -> Any:
        return jax.jvp(lambda x: function(c, x, y), (x,), (jnp.ones_like(x),))

    check_same(slopes, C, X, Y)
    np.testing.assert_allclose(lean(slopes, EXACT, C, X, Y)[1][2], np.cos(X + 0.01 * Y), atol=1e-6)
    assert operations(slopes, C, X, Y)["shift_left"] == 1


def test_programs_within_stay_what_they_are() -> None:
    def function(c: Any, x: Any, y: Any) -> Any:
        low, high = jax.lax.cond(x[0] > 0.0, lambda: (x, y), lambda: (y, x))
        return jax.lax.fori_loop(0, 3, lambda i, total: total + low, y) + high

    check_same(function, C, X, Y)
