"""How much more delay a loop bears: from a crossover to the delay at which 1 + L is 0.

Lag/θ at a crossover leaves out what sampling folds down: some 1e-4 of the delay where the crossover is far below the
Nyquist frequency, and most of it where it is near. Folding also makes |L| depend on the fraction of a sample by which a
command is late, so that beyond every crossover, where |L| is just below 1, a fraction may do what whole samples do not:
that is not looked for.
"""

from collections.abc import Callable
from math import pi
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

Scalar = Float[Array, ""]
Loop = Callable[..., Complex[Array, "..."]]
"""L(θ [rad], added delay [samples]) of the negative feedback 1 + L, elementwise in the angle θ = ω T_s."""
Point = tuple[Scalar, Scalar]
"""Angle θ [rad] and added delay τ [samples]."""

CHORD_STEPS = 12
"""Each gains three digits and more; the start has four."""
NEWTON_STEPS, LONGEST_MOVE, SMALL_MOVE = 20, 0.3, 1e-6
"""Where those do not lead there, as near the Nyquist frequency; how far a step may go, and the move that tells the
slopes [rad] and [samples]."""
REACHED = 1e-6
"""Size of 1 + L at which a point is near enough for one exact step to the limit [-]."""


def lag_of(response: Complex[Array, ""], slope: Complex[Array, ""]) -> Scalar:
    """Lag to −1 from a crossover [rad]."""
    relative = slope / response
    steep = jnp.where(relative.real == 0.0, 1.0, relative.real)
    return jnp.mod(jnp.angle(response) - relative.imag * jnp.log(jnp.abs(response)) / steep + pi, 2.0 * pi)


def added_delay(live: Loop, frozen: Loop, theta: Scalar, response: Any, slope: Any) -> Scalar:
    """Delay [samples] at which 1 + L = 0 at some angle; lag/θ, without a derivative, where no way leads there.

    This is the delay of the held command in continuous time. The search, which starts at a crossover, keeps the
    derivatives of the pure delay, L e^{−jθτ} = −1; the last step, which carries the derivatives, has the exact ones.

    Args:
        live: The loop.
        frozen: The same without derivatives.
        theta: Angle of the crossover [rad].
        response: L there.
        slope: dL/dθ there.
    """
    start = theta, lag_of(response, slope) / theta
    by_chord = 1j * start[1] - slope / response, 1j * theta
    aside, later = SMALL_MOVE * jnp.eye(2)

    def closer(k: Any, search: tuple[Point, Any]) -> tuple[Point, Any]:
        point, _ = search
        miss = 1.0 + frozen(*point)
        reached = (point[1] >= 0.0) & (jnp.abs(miss) < REACHED)
        chord = _step(point, miss, *by_chord)
        slopes = (1.0 + jax.vmap(frozen)(point[0] + aside, point[1] + later) - miss) / SMALL_MOVE
        newton = _shortened(point, _step(point, miss, *slopes))
        following = tuple(
            jnp.where(k < CHORD_STEPS, a, jnp.where(reached, b, jnp.where(k == CHORD_STEPS, begin, c)))
            for a, b, c, begin in zip(chord, point, newton, start, strict=True)
        )
        return (following[0], following[1]), reached

    steps = CHORD_STEPS + 1 + NEWTON_STEPS
    found, reached = jax.lax.fori_loop(0, steps, closer, (start, jnp.isinf(theta)))
    point = jnp.where(reached, found[0], start[0]), jnp.where(reached, found[1], start[1])
    ones = jnp.ones_like(theta)
    exact = [jax.jvp(frozen, point, tangent)[1] for tangent in ((ones, 0.0 * ones), (0.0 * ones, ones))]
    return jnp.where(reached, _step(point, 1.0 + live(*point), *exact)[1], start[1])


def _step(point: Point, miss: Any, by_theta: Any, by_delay: Any) -> Point:
    """A step to where 1 + L, which misses 0, would be 0 if it were straight."""
    area = by_theta.real * by_delay.imag - by_theta.imag * by_delay.real
    to_theta = (miss.real * by_delay.imag - miss.imag * by_delay.real) / area
    to_delay = (by_theta.real * miss.imag - by_theta.imag * miss.real) / area
    return point[0] - to_theta, point[1] - to_delay


def _shortened(begin: Point, end: Point) -> Point:
    theta, delay = (there - here for here, there in zip(begin, end, strict=True))
    less = LONGEST_MOVE / jnp.maximum(jnp.maximum(jnp.abs(theta), jnp.abs(delay)), LONGEST_MOVE)
    return begin[0] + less * theta, jnp.maximum(begin[1] + less * delay, 0.0)
