"""Stability margins over stiffness and delay, of the loop as it runs and of the ideal one.

The public function is `jaxmpc.margins`; stability comes first in it: an unstable loop has M_s = ∞, NaN
margins and the status UNSTABLE, since its peak over frequency can look fine.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmpc import described
from jaxmpc.files.errors import InputError
from jaxmpc.law.gains import Gains
from jaxmpc.stability.crossings import Loop, LoopMargins, loop_margins
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.stability.response import loop_response
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one, over_batch
from jaxmpc.synthesis.params import Params
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath, loop_path
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

ILL_POSED_ABOVE = 1e-6
"""Relative Riccati residual beyond which a design does not count; a good one has 1e-15."""


class Margins(NamedTuple):
    """Margins of the closed loop, the worse of its two cuts (at v and at a = v − K₂ẋ)."""

    M_s: Float[Array, "..."]
    """Peak sensitivity max|1/(1 + L)| [-]; ∞ when unstable."""
    gain_margin_db: Float[Array, "..."]
    """Gain increase to instability, positive [dB]; ∞ when there is none, NaN when unstable."""
    gain_reduction_db: Float[Array, "..."]
    """Gain decrease to instability, positive [dB]."""
    phase_margin_deg: Float[Array, "..."]
    """Smallest lag to instability over all crossovers [deg]."""
    delay_margin_s: Float[Array, "..."]
    """Smallest added delay to instability over all crossovers [s]."""
    spectral_radius: Float[Array, "..."]
    """Largest |eigenvalue| of the closed loop [-]; stable below 1."""
    status: Int[Array, "..."]
    """A `Status`."""

    def __repr__(self) -> str:
        return described.as_text(*described.margins(self))

    def _repr_html_(self) -> str:
        return described.as_html(*described.margins(self))


def stability_status(radius: Any, residual: Any) -> Any:
    """The `Status` that a linear loop has: OK, UNSTABLE, or ILL_POSED.

    Args:
        radius: Spectral radius of the loop [-].
        residual: Riccati residual of the design [-].
    """
    stable = jnp.where(radius < 1.0, Status.OK, Status.UNSTABLE)
    return jnp.where((residual < ILL_POSED_ABOVE) & jnp.isfinite(radius), stable, Status.ILL_POSED)


def margins_one(gains: Gains, contact: Contact, ideal: bool, residual: Any = 0.0) -> Margins:
    """Margins of one controller on one tissue; float64, traceable, differentiable.

    Args:
        gains: The controller.
        contact: The world (see `contact_of`).
        ideal: Whether the damping is ideal: then both cuts are the same one.
        residual: Riccati residual of the design [-].
    """
    radius = spectral_radius(closed_loop_matrix(gains, contact))
    # With ideal damping both cuts are the same one.
    cut_at_a = jnp.zeros(1) if ideal else jnp.array([0.0, 1.0])

    def margins_at(cut: Any) -> LoopMargins:
        def loop(g: Gains, c: Contact) -> Loop:
            return lambda theta, late=None: loop_response(g, c, theta, cut, late)

        return loop_margins(loop(gains, contact), loop(*jax.lax.stop_gradient((gains, contact))), contact.T_s)

    cuts = jax.vmap(margins_at)(cut_at_a)
    worst = LoopMargins(jnp.max(cuts.M_s), *(jnp.min(cut) for cut in cuts[1:]))
    stable = radius < 1.0
    up, down, phase, delay = (jnp.where(stable, value, jnp.nan) for value in worst[1:])
    return Margins(
        jnp.where(stable, worst.M_s, jnp.inf), up, down, phase, delay, radius, stability_status(radius, residual)
    )


@JitOnce
def _margins(params: Params, stiffness: Any, path: LoopPath) -> Margins:
    def one(p: Params, K_s: Any) -> Margins:
        gains, residual = design_one(p, path.T_s, 1.0, path.force_filter)
        return margins_one(gains, contact_of(K_s, p.K2, path), path.ideal, residual)

    over_stiffness = one
    for _ in range(jnp.ndim(stiffness)):
        over_stiffness = jax.vmap(over_stiffness, in_axes=(None, 0))
    result: Margins = over_batch(lambda p: over_stiffness(p, stiffness), params.batch_shape)(params)
    return result


@in_float64
def margins(
    params: Params, stiffness: Any, delay: int = 1, ideal: bool = False, *, path: LoopPath | None = None
) -> Margins:
    """Stability margins of controllers on tissues.

    Args:
        params: One controller or a batch.
        stiffness: K_s, one or an array of them [N/m].
        delay: Samples between command and effect, 1 or 2 [samples].
        ideal: False: the loop as it runs (K₂ẋ sampled, delayed and low-passed at 180 rad/s, force
            low-passed at 500 Hz), cut at v and at a, the worse counts. True: the paper's (6), ideal
            damping, cut at v.
        path: Delay, sampling and filters of another loop, instead of `delay` and `ideal`: that of an experiment is
            `Experiment.loop_path`.

    Returns:
        Margins, each of the batch's shape followed by that of `stiffness`.

    Raises:
        InputError: A stiffness is not positive, or the delay is not 1 or 2.
    """
    values = jnp.asarray(stiffness, jnp.float64)
    if not isinstance(values, jax.core.Tracer) and not bool(jnp.all((values > 0.0) & jnp.isfinite(values))):
        raise InputError("stiffness", stiffness, "positive [N/m]", "Tissue has 300 to 1900.")
    if path is None:
        path = loop_path(delay=delay, ideal=ideal)
    result: Margins = _margins(params, values, path)
    return result
