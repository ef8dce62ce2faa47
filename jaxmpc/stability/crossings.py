"""Gain, phase and delay margin of one loop, from where it passes the point −1."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jaxmpc.stability.search import peak, root

Scalar = Float[Array, ""]
Loop = Callable[[Float[Array, "..."], Scalar], Complex[Array, "..."]]
"""L(ω [rad/s], added delay [samples])."""

POINTS = 400
"""Frequencies searched, 0.05 Hz to the Nyquist frequency: 2.3 % apart, then refined to the last bit."""
LOWEST = 0.05 * 2.0 * jnp.pi
NEWTON_STEPS = 6


class LoopMargins(NamedTuple):
    """Margins at one place of cutting the loop."""

    M_s: Scalar
    gain_margin_db: Scalar
    gain_reduction_db: Scalar
    phase_margin_deg: Scalar
    delay_margin_s: Scalar


def loop_margins(loop: Loop, T_s: float) -> LoopMargins:
    """All margins of a stable loop.

    Args:
        loop: L(ω, added delay) of the negative feedback 1 + L.
        T_s: Sampling time [s].
    """
    nyquist = jnp.pi / T_s
    omega = LOWEST * (nyquist / LOWEST) ** jnp.linspace(0.0, 1.0, POINTS)
    zero = jnp.zeros(())
    response = loop(omega, zero)

    def distance(at: Scalar) -> Scalar:
        return -jnp.log(jnp.abs(1.0 + loop(at, zero)))

    top = jnp.clip(jnp.argmin(jnp.abs(1.0 + response)), 1, POINTS - 2)
    log_peak = jnp.maximum(peak(distance, omega[top - 1], omega[top + 1]), distance(omega[-1]))
    up, down = _gain_margins(loop, omega, response)
    phase, delay = _lag_margins(loop, omega, response, T_s)
    return LoopMargins(jnp.exp(log_peak), up, down, phase, delay)


def _gain_margins(loop: Loop, omega: Float[Array, " n"], response: Complex[Array, " n"]) -> tuple[Scalar, Scalar]:
    """Gain factors up and down to the nearest crossings of the negative real axis [dB], ∞ where there is none."""
    imaginary, real = response.imag, response.real
    # The sampled loop ends on the real axis, so its last point is a crossing of its own.
    changes = (imaginary[:-1] * imaginary[1:] < 0.0) & (omega[1:] < omega[-1])
    share = imaginary[:-1] / jnp.where(changes, imaginary[:-1] - imaginary[1:], 1.0)
    level = jnp.where(changes, real[:-1] + share * (real[1:] - real[:-1]), 0.0)
    level = jnp.append(level, real[-1])
    ends = jnp.append(jnp.stack([omega[:-1], omega[1:]], 1), jnp.stack([omega[-1], omega[-1]])[None], 0)

    def nearest(wanted: Float[Array, " n"], sign: float) -> Scalar:
        decibels = jnp.where(wanted, -20.0 * sign * jnp.log10(jnp.maximum(-level, 1e-300)), jnp.inf)
        chosen = jnp.argmin(decibels)
        bracket = ends[chosen]
        at = root(lambda w: loop(w, jnp.zeros(())).imag, bracket[0], bracket[1])
        at = jnp.where(chosen == len(level) - 1, omega[-1], at)
        found = loop(at, jnp.zeros(())).real
        exact = -20.0 * sign * jnp.log10(jnp.where(found < 0.0, -found, 1.0))
        return jnp.where(jnp.any(wanted), exact, jnp.inf)

    crosses = level < 0.0
    return nearest(crosses & (level > -1.0), 1.0), nearest(crosses & (level <= -1.0), -1.0)


def _lag_margins(
    loop: Loop, omega: Float[Array, " n"], response: Complex[Array, " n"], T_s: float
) -> tuple[Scalar, Scalar]:
    """Smallest lag [deg] and smallest added delay [s] over all crossovers, ∞ where there is none.

    The delay is that of the held command in continuous time. At its limit the loop passes −1 exactly;
    lag/ω only starts the search, since it leaves out what sampling folds down (some 1e-4 of it).
    """
    size = jnp.log(jnp.abs(response))
    changes = size[:-1] * size[1:] < 0.0
    share = size[:-1] / jnp.where(changes, size[:-1] - size[1:], 1.0)
    crossover = omega[:-1] + share * (omega[1:] - omega[:-1])
    angle = jnp.unwrap(jnp.angle(response))
    lag = jnp.mod(angle[:-1] + share * (angle[1:] - angle[:-1]) + jnp.pi, 2.0 * jnp.pi)
    zero = jnp.zeros(())

    def refined(chosen: Scalar) -> Scalar:
        return root(lambda w: jnp.log(jnp.abs(loop(w, zero))), omega[chosen], omega[chosen + 1])

    phase_at = refined(jnp.argmin(jnp.where(changes, lag, jnp.inf)))
    phase = jnp.mod(jnp.angle(loop(phase_at, zero)) + jnp.pi, 2.0 * jnp.pi)

    delay_at = refined(jnp.argmin(jnp.where(changes, lag / crossover, jnp.inf)))
    guess = jnp.mod(jnp.angle(loop(delay_at, zero)) + jnp.pi, 2.0 * jnp.pi) / delay_at
    delay = _added_delay(loop, delay_at * T_s, guess / T_s, T_s)
    found = jnp.any(changes)
    return jnp.where(found, jnp.rad2deg(phase), jnp.inf), jnp.where(found, delay * T_s, jnp.inf)


def _added_delay(loop: Loop, theta: Scalar, delay: Scalar, T_s: float) -> Scalar:
    """Delay [samples] at which 1 + L = 0 at some angle θ = ω T_s, by Newton's method in both."""

    def miss(point: Float[Array, "2"]) -> Float[Array, "2"]:
        value = 1.0 + loop(point[0] / T_s, point[1])
        return jnp.stack([value.real, value.imag])

    def newton(point: Float[Array, "2"]) -> Float[Array, "2"]:
        (a, b), (c, d) = jax.lax.stop_gradient(jax.jacfwd(miss)(point))
        real, imaginary = miss(point)
        return point - jnp.stack([d * real - b * imaginary, a * imaginary - c * real]) / (a * d - b * c)

    start = jax.lax.stop_gradient(jnp.stack([theta, delay]))
    point = jax.lax.fori_loop(0, NEWTON_STEPS, lambda _, at: jax.lax.stop_gradient(newton(at)), start)
    point = newton(jax.lax.stop_gradient(point))
    # A margin below one step of the search would otherwise be allowed to leave the positive side.
    return jnp.where(jnp.isfinite(point[1]) & (point[1] >= 0.0), point[1], start[1])
