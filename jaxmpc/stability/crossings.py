"""Margins of one loop, from where its frequency response passes the point −1.

All searching is done on a *frozen* copy of the loop, whose parameters carry no derivatives. The live loop
is evaluated once, at the places found, with one Newton step towards each: that step is zero in value, and
its derivative is exactly the one by which the place moves.
"""

from math import pi
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from jaxmpc.stability.added_delay import Loop, added_delay, lag_of
from jaxmpc.stability.search import peak, root
from jaxmpc.xla.extremes import least

Scalar = Float[Array, ""]

SLOW, POINTS = 12, 252
"""Angles searched, the first so many below `CLOSELY`; above it they are 3.9 % apart up to the Nyquist frequency. What
they show is refined to the last bit."""
BENDS, PARTS = 4, 16
"""Places looked at more closely, where the curve bends most, and in how many parts each: a resonance may be narrower
than the angles are apart, and rise and fall between two of them."""
LOWEST, CLOSELY = 1e-6, 2.0 * pi * 5e-5
"""Lowest angle searched, and from which on closely [rad]: 0.16 mHz and 0.05 Hz at 1 kHz. Between them the slowest
observers alone turn a loop, without resonance: with the least `Q_p` at 0.1 ms it crosses the real axis at 7e-5 rad."""
BESIDE = (-8.0, -1.0, -0.125, 0.125, 1.0, 8.0)
"""Where a loop is looked at beside a pole on the unit circle, over the distance at which its part of L has a size of
about 1 [-]: from there to the pole the curve is nearly straight, and crosses the real axis on one side of the two."""


class LoopMargins(NamedTuple):
    """Margins at one place of cutting the loop; units as in `Margins`."""

    M_s: Scalar
    gain_margin_db: Scalar
    gain_reduction_db: Scalar
    phase_margin_deg: Scalar
    delay_margin_s: Scalar


class Places(NamedTuple):
    """Angles of interest [rad], and whether there is such a place at all."""

    peak: Scalar
    gain: Float[Array, "2"]
    """Crossings of the negative real axis nearest to −1: inside and outside the unit circle."""
    lag: Float[Array, "2"]
    """Crossovers with the smallest lag, and with the smallest lag/θ."""
    has_gain: Bool[Array, "2"]
    has_lag: Bool[Array, ""]


class Poles(NamedTuple):
    """Poles of L on the unit circle, each (poles,)."""

    angle: Any
    """[rad]"""
    size: Any
    """At which distance its part of L has a size of about 1 [rad]; 0 where there is none after all."""


def loop_margins(live: Loop, frozen: Loop, T_s: Any, poles: Poles | None = None) -> LoopMargins:
    """All margins of a stable loop.

    Args:
        live: The loop.
        frozen: The same loop with its parameters behind `stop_gradient`.
        T_s: Sampling time [s].
        poles: Its poles on the unit circle, likewise; None where it has none.
    """
    places = _places(frozen, poles)
    at = jnp.concatenate([places.peak[None], jnp.full(1, pi), places.gain, places.lag])
    response = live(at)
    slope = jax.jvp(frozen, (at,), (jnp.ones_like(at),))[1]

    M_s = 1.0 / least(jnp.abs(1.0 + response[:2]))
    gain, phase = _gain(response[2:4], slope[2:4]), lag_of(response[4], slope[4])
    delay = added_delay(live, frozen, *jax.lax.stop_gradient((at[5], response[5], slope[5])))
    up, down = jnp.where(places.has_gain, gain, jnp.inf)
    lag, late = jnp.where(places.has_lag, jnp.stack([jnp.rad2deg(phase), delay * T_s]), jnp.inf)
    return LoopMargins(M_s, up, down, lag, late)


class Curve(NamedTuple):
    """The loop at rising angles up to the Nyquist frequency."""

    theta: Float[Array, " points"]
    response: Complex[Array, " points"]
    piece: Bool[Array, " points-1"]
    """Whether a point and the next enclose a piece of the curve: it is torn at a pole."""


def search_angles() -> Float[Array, " angles"]:
    """Angles at which every loop is looked at [rad]."""
    slow = LOWEST * (CLOSELY / LOWEST) ** jnp.linspace(0.0, 1.0, SLOW, endpoint=False)
    return jnp.append(slow, CLOSELY * (pi / CLOSELY) ** jnp.linspace(0.0, 1.0, POINTS - SLOW))


def _curve(loop: Loop, poles: Poles | None) -> Curve:
    """The loop over all angles, and more closely where it bends most near the unit circle, and beside its poles."""
    theta = search_angles()
    response = loop(theta)
    ratio, size = response[1:] / response[:-1], jnp.abs(response[1:-1])
    bend = jnp.abs(ratio[1:] - ratio[:-1]) * size / (1.0 + size**2)
    # Where wide steps meet narrow ones ratios of any curve change.
    bend = jnp.where(jnp.arange(1, POINTS - 1) > SLOW, bend, -1.0)
    sharpest = []
    for _ in range(BENDS):
        sharpest.append(1 + jnp.argmax(bend))
        bend = jnp.where(jnp.abs(jnp.arange(1, POINTS - 1) - sharpest[-1]) < 2, -1.0, bend)
    middle = jnp.stack(sharpest)
    low, high = theta[middle - 1, None], theta[middle + 1, None]
    closely = jnp.ravel(low + (high - low) * jnp.arange(1, PARTS) / PARTS)
    if poles is not None:
        closely = jnp.append(closely, _beside(poles))
    theta, response = jnp.append(theta, closely), jnp.append(response, loop(closely))
    order = jnp.argsort(theta)
    theta, response = theta[order], response[order]
    whole = jnp.ones(len(theta) - 1, bool)
    if poles is not None:
        torn = (theta[:-1, None] < poles.angle) & (poles.angle < theta[1:, None]) & (poles.size > 0.0)
        whole = ~jnp.any(torn, axis=1)
    return Curve(theta, response, whole)


def _beside(poles: Poles) -> Float[Array, " angles"]:
    """Angles beside each pole; where there is none they are no harm."""
    size = jnp.maximum(poles.size, 1e-9 * poles.angle)
    angles = jnp.ravel(poles.angle[:, None] + size[:, None] * jnp.array(BESIDE))
    return jnp.clip(angles, LOWEST, (1.0 - 1e-6) * pi)


def _places(loop: Loop, poles: Poles | None) -> Places:
    theta, response, piece = _curve(loop, poles)
    top = 1 + jnp.argmin(jnp.abs(1.0 + response[1:-1]))
    highest = peak(lambda at: -jnp.abs(1.0 + loop(at)), theta[top - 1], theta[top + 1])

    imaginary, real = response.imag, response.real
    # The sampled loop ends on the real axis: its last point is a crossing too, and no change of sign.
    changes = piece & (imaginary[:-1] * imaginary[1:] < 0.0) & (jnp.arange(len(piece)) < len(piece) - 1)
    level = real[:-1] + _share(imaginary, changes) * (real[1:] - real[:-1])
    level = jnp.where(_resonates(response), _through_resonance(response, changes), level)
    level = jnp.append(jnp.where(changes, level, 0.0), real[-1])
    inside, outside = (level < 0.0) & (level > -1.0), level <= -1.0
    away = jnp.abs(jnp.log(jnp.maximum(-level, 1e-300)))
    chosen = jnp.argmin(jnp.where(jnp.stack([inside, outside]), away, jnp.inf), axis=1)
    low = jnp.minimum(chosen, len(piece) - 1)
    crossing = root(lambda at: loop(at).imag, theta[low], theta[low + 1], imaginary[low] < 0.0)
    crossing = jnp.where(chosen == len(piece), theta[-1], crossing)

    size = jnp.log(jnp.abs(response))
    changes = piece & (size[:-1] * size[1:] < 0.0)
    # From one point to the next the angle turns by less than half a circle: no need to unwrap them all.
    angle = jnp.angle(response[:-1])
    turned = angle + _share(size, changes) * jnp.angle(response[1:] / response[:-1])
    lag = jnp.mod(turned + pi, 2.0 * pi)
    wanted = jnp.stack([lag, lag / theta[:-1]])
    low = jnp.argmin(jnp.where(changes, wanted, jnp.inf), axis=1)
    crossover = root(lambda at: jnp.log(jnp.abs(loop(at))), theta[low], theta[low + 1], size[low] < 0.0)
    return Places(highest, crossing, crossover, jnp.stack([inside.any(), outside.any()]), changes.any())


def _share(crosses: Float[Array, " n"], changes: Bool[Array, " m"]) -> Float[Array, " m"]:
    """Where between two points a curve crosses zero, by linear interpolation, 0 to 1."""
    share: Array = crosses[:-1] / jnp.where(changes, crosses[:-1] - crosses[1:], 1.0)
    return share


def _resonates(response: Complex[Array, " n"]) -> Bool[Array, " m"]:
    """Whether a curve is largest between two points."""
    rises = jnp.diff(jnp.abs(response)) > 0.0
    return jnp.append(True, rises[:-1]) & jnp.append(~rises[1:], True)


def _through_resonance(response: Complex[Array, " n"], changes: Bool[Array, " m"]) -> Float[Array, " m"]:
    """Real part where a curve crosses the real axis between two points; by its inverse, nearly straight at a resonance.

    A straight line between the points would take a crossing at −100 for one inside the unit circle.
    """
    inverse = 1.0 / response
    real = inverse.real[:-1] + _share(inverse.imag, changes) * jnp.diff(inverse.real)
    return 1.0 / jnp.where(real == 0.0, 1.0, real)


def _gain(response: Complex[Array, "2"], slope: Complex[Array, "2"]) -> Float[Array, "2"]:
    """Gain change to −1 from a crossing of the negative real axis, in the direction that has it [dB]."""
    steep = jnp.where(slope.imag == 0.0, 1.0, slope.imag)
    real = response.real - slope.real * response.imag / steep
    return jnp.abs(20.0 * jnp.log10(jnp.where(real < 0.0, -real, 1.0)))
