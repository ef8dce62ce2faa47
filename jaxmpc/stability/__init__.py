"""Stability margins over stiffness and delay, of the loop as it runs and of the ideal one.

The public function is `jaxmpc.margins`; stability comes first in it: an unstable loop has M_s = ∞, NaN
margins and the status UNSTABLE, since its peak over frequency can look fine.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmpc import described
from jaxmpc.files.errors import InputError, check_type
from jaxmpc.law.gains import Gains
from jaxmpc.stability.added_delay import Loop
from jaxmpc.stability.controller import TransferFunction, controller_of
from jaxmpc.stability.crossings import LoopMargins, loop_margins
from jaxmpc.stability.held_beat import HeldBeat, poles
from jaxmpc.stability.loop import closed_loop_matrix, contacts_between, spectral_radius
from jaxmpc.stability.response import loop_around
from jaxmpc.status import Status
from jaxmpc.synthesis import designed
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.values import MAKE_PARAMS, check_filled
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath, loop_path
from jaxmpc.xla.blocks import padded
from jaxmpc.xla.extremes import greatest, least
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import placed
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.rows import repeated, reshaped, traced

CELLS = 64
"""Loops that are judged at a time; the last of them are filled up."""
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


class Cells(NamedTuple):
    """Controllers, each on one tissue; every leaf has the cells as leading dimension."""

    gains: Gains
    contacts: Contact
    residual: Any
    """Riccati residual of the design [-]."""
    held: HeldBeat | None = None
    """What is learned of the heart's beat; None learns nothing."""


def cells_of(gains: Gains, contacts: Contact, residual: Any) -> Cells:
    """Every controller (controllers,) on every tissue, the tissues of one after another.

    Args:
        gains: The controllers; what margins do not ask for is left out.
        contacts: Each (controllers, tissues).
        residual: Riccati residuals of the designs, (controllers,) [-].
    """
    summed = jnp.sum(gains.mpc_ref, axis=1, keepdims=True)
    plain = gains._replace(mpc_ref=summed, guard=None, schedule=None)
    tissues = contacts.stiffness.shape[1]
    # One dimension of cells is traced twice as fast as two nested ones.
    return Cells(repeated(plain, tissues), reshaped(contacts, 2, -1), repeated(residual, tissues))


def margins_one(
    gains: Gains, contact: Contact, ideal: bool, residual: Any = 0.0, beats: HeldBeat | None = None
) -> Margins:
    """Margins of one controller on one tissue; float64, traceable, differentiable.

    Args:
        gains: The controller.
        contact: The world (see `contact_of`).
        ideal: Whether the damping is ideal: then both cuts are the same one.
        residual: Riccati residual of the design [-].
        beats: What is learned of the heart's beat at several rates, of which the worst counts; None learns nothing.
    """
    # With ideal damping both cuts are the same one.
    if beats is None:
        return _margins_cut(Cells(gains, contact, residual), _cuts(ideal))
    return worst_of(jax.vmap(lambda beat: _margins_cut(Cells(gains, contact, residual, beat), _cuts(ideal)))(beats))


def worst_of(margins: Margins) -> Margins:
    """Over the last dimension, beats as `held_beat.at_rates` has them; what is not a number stays so.

    The spectral radius is that of the loop that learns nothing, unless one that learns is unstable: a harmonic that is
    hardly learned has a pole as near to 1 as one likes, and says nothing of the loop.
    """
    largest = {name: greatest(getattr(margins, name)) for name in ("M_s", "status")}
    radius, at_most = margins.spectral_radius[..., 0], greatest(margins.spectral_radius)
    smallest: Margins = jax.tree.map(least, margins)
    return smallest._replace(**largest, spectral_radius=jnp.where(at_most < 1.0, radius, at_most))


def _cuts(ideal: bool) -> Array:
    return jnp.zeros(1) if ideal else jnp.array([0.0, 1.0])


def _margins_cut(cell: Cells, cuts_at_a: Any) -> Margins:
    """Margins of one cell at the worst of the cuts, (cuts,): 1 at a, 0 at v."""
    gains, contact, residual, held = cell
    radius = spectral_radius(closed_loop_matrix(gains, contact, held))
    controller = controller_of(gains, held is not None)

    def margins_at(cut: Any) -> LoopMargins:
        def loop(one: TransferFunction, c: Contact, h: HeldBeat | None) -> Loop:
            return lambda theta, late=None: loop_around(one, c, theta, cut, late, h)

        parts = controller, contact, held
        frozen = jax.lax.stop_gradient(parts)
        torn = None if held is None else poles(jax.lax.stop_gradient(held))
        return loop_margins(loop(*parts), loop(*frozen), contact.T_s, torn)

    cuts = jax.vmap(margins_at)(cuts_at_a)
    worst = LoopMargins(greatest(cuts.M_s), *map(least, cuts[1:]))
    stable = radius < 1.0
    up, down, phase, delay = (jnp.where(stable, value, jnp.nan) for value in worst[1:])
    return Margins(
        jnp.where(stable, worst.M_s, jnp.inf), up, down, phase, delay, radius, stability_status(radius, residual)
    )


def _margins_of_block(cells: Cells, cuts_at_a: Any) -> Margins:
    found: Margins = jax.vmap(_margins_cut, in_axes=(0, None))(cells, cuts_at_a)
    return found


_block = JitOnce(_margins_of_block)


def margins_of_cells(cells: Cells, *, ideal: bool) -> Margins:
    """Margins of every cell, (cells,); float64, traceable, differentiable.

    Unless traced, all loops of controllers of one disturbance order, as they run and ideal, are judged by one program.
    """
    if traced(cells):
        found: Margins = jax.vmap(lambda cell: _margins_cut(cell, _cuts(ideal)))(cells)
        return found
    count, whole = len(cells.residual), padded(cells, CELLS)
    cuts = np.array([0.0, 0.0 if ideal else 1.0])
    # Rows of numpy's arrays: each of JAX's would be an operation of its own, more than judging them takes.
    blocks = [jax.tree.map(lambda leaf, i=i: leaf[i : i + CELLS], whole) for i in range(0, count, CELLS)]
    parts = [_block(block, cuts) for block in blocks]
    joined: Margins = placed(jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *parts))
    return joined


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
        path: Delay, sampling and filters of another loop, instead of `delay` and `ideal`, never beside them: that of
            an experiment is `Experiment.loop_path`. Filters that the parameters have take the place of its own.

    Returns:
        Margins, each of the batch's shape followed by that of `stiffness`.

    Raises:
        InputError: A stiffness is not positive, the delay is not 1 or 2 or beside a path, the batch is empty, or an
            argument of another type.
    """
    check_type("params", params, Params, MAKE_PARAMS)
    check_type("path", path, LoopPath | None, "Take it of an experiment: experiment.loop_path().")
    values = _real(stiffness)
    if not isinstance(values, jax.core.Tracer) and not np.all((np.asarray(values) > 0.0) & np.isfinite(values)):
        raise InputError("stiffness", stiffness, "positive [N/m]", "Tissue has 300 to 1900.")
    if not values.size:
        raise InputError("stiffness", "none", "at least one [N/m]", "Tissue has 300 to 1900.")
    if path is None:
        path = loop_path(delay=delay, ideal=ideal)
    elif delay != 1 or ideal:
        given = f"{delay} beside a path" if delay != 1 else "True beside a path"
        remedy = "The path has its own: take `Experiment.loop_path(ideal)` of an experiment with that delay."
        raise InputError("delay" if delay != 1 else "ideal", given, "left out", remedy)
    check_filled(params.batch_shape)
    flat = reshaped(params, len(params.batch_shape), -1)
    gains, residual = designed(flat, path.T_s, path.force_filter)
    path = path.with_cutoff(flat.velocity_cutoff)
    contacts = contacts_between(flat.K2, reshaped(values, values.ndim, -1), path)
    found = margins_of_cells(cells_of(gains, contacts, residual), ideal=path.ideal)
    return reshaped(found, 1, *params.batch_shape, *values.shape)


def _real(stiffness: Any) -> Float[Array, "..."]:
    """Stiffnesses as an array; words, truth values and complex numbers are none."""
    try:
        values = jnp.asarray(stiffness)
    except (TypeError, ValueError, OverflowError):
        values = jnp.asarray(False)
    if not any(jnp.issubdtype(values.dtype, kind) for kind in (jnp.floating, jnp.integer)):
        raise InputError("stiffness", stiffness, "a number, or an array of them [N/m]", "Tissue has 300 to 1900.")
    return values.astype(jnp.float64)
