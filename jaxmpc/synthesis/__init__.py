"""Controller synthesis: parameters in, gains of the law out; differentiable, batched, compiled once.

The public function is `jaxmpc.design`; the package has another name so that importing it does not hide it.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.files.errors import check_type
from jaxmpc.law import gain_backoff
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gains import Gains, GainSchedule, Knot, with_gain
from jaxmpc.quantities import HP_MAX, HU_MAX
from jaxmpc.synthesis.feedback import state_feedback
from jaxmpc.synthesis.force_filter import force_filter as kalman_filter
from jaxmpc.synthesis.kalman import active_observer_gain, input_noise_gain
from jaxmpc.synthesis.learning import repetition
from jaxmpc.synthesis.mpc import first_move
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.plant import closed_loop_model, contact_model
from jaxmpc.synthesis.sampling import check_sampling
from jaxmpc.synthesis.timing import Timing
from jaxmpc.synthesis.values import MAKE_PARAMS, least_horizon
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.rows import reshaped


def design_one(
    params: Params, T_s: Any, mask_width: Any = 1.0, force_filter: ForceFilter | None = None
) -> tuple[Gains, Float[Array, ""]]:
    """Gains of one controller, and how badly its Riccati equation is missed [-]; float64, traceable.

    Args:
        params: One controller, scalars or diagonals of arrays.
        T_s: Sampling time [s].
        mask_width: Softness of the horizons, 1 is exact [samples].
        force_filter: What the measured force passes first, unless the controller brings a filter of its own; the
            design of all else knows of neither.

    Raises:
        InputError: At this sampling time a part of the controller would do nothing (`check_sampling`).
    """
    check_sampling(params, T_s)
    if params.force_cutoff is not None:
        force_filter = kalman_filter(jnp.asarray(params.force_cutoff), jnp.asarray(T_s), ops)
    if params.listening is not None:
        fixed = replace(params, knots=(), listening=None)
        gains, residual = design_one(fixed, T_s, mask_width, force_filter)
        family, missed = design_family(params, T_s, mask_width)
        return gains._replace(schedule=family), jnp.maximum(residual, missed)
    p = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), params)
    lam, delta = jnp.broadcast_to(p.lam, (HU_MAX,)), jnp.broadcast_to(p.delta, (HP_MAX,))
    Phi, Gamma = contact_model(p.Khat_s, p.K2, T_s)
    active = partial(active_observer_gain, order=p.disturbance_order)
    observer = input_noise_gain if p.architecture == "mpc" else active
    K, residual = observer(Phi, Gamma, p.Q_x, p.Q_p, p.R, delay=p.designed_delay)
    K, K_earlier = (K, None) if p.designed_delay == 1 else (jnp.concatenate([K[:2], K[3:]]), K[2])
    # Traced values pass no check; without a sample that a command changes there is no design, whatever the masks do.
    residual = jnp.where((p.Hp >= least_horizon(p.architecture)) & (p.Hu >= 1.0), residual, jnp.inf)
    phi = jnp.stack([Phi[0, 1], Phi[1, 1]])
    zero, one = jnp.zeros_like(p.T_cl), jnp.ones_like(p.T_cl)

    guard = gain_backoff.constants(jnp.asarray(T_s), ops) if p.guarded else None

    if p.architecture == "mpc":
        delayed = jnp.block([[Phi, Gamma[:, None]], [jnp.zeros((1, 3))]])
        mpc_ref, mpc_x, mpc_u = first_move(delayed, jnp.stack([zero, zero, one]), lam, delta, p.Hp, p.Hu, mask_width)
        # The delayed input *is* the previous output here, so its weight moves from mₓ to mᵤ.
        move = mpc_ref, mpc_x[:2], mpc_u + mpc_x[2]
        gains = Gains(phi, Gamma, K, jnp.zeros(3), one, *move, K_earlier, force_filter=force_filter)
        return _looking_ahead(gains), residual

    L = state_feedback(Phi, Gamma, p.T_cl, T_s)
    if p.architecture == "aob":
        # u = F_d: the move cancels the previous output and takes the next reference as it is.
        mpc_ref, mpc_x, mpc_u = jnp.zeros(HP_MAX).at[0].set(1.0), jnp.zeros(2), one
    else:
        A, B = closed_loop_model(p.T_cl, T_s)
        mpc_ref, mpc_x, mpc_u = first_move(A, B, lam, delta, p.Hp, p.Hu, mask_width)
    gains = Gains(phi, Gamma, K, L, L[0], mpc_ref, mpc_x, mpc_u, K_earlier, guard, force_filter)
    return _looking_ahead(gains), residual


def _looking_ahead(gains: Gains) -> Gains:
    """With the weights on the wanted force a sample on, as the estimates are that the law takes for two samples' delay.

    Beyond what is known ahead the wanted force stays what it is there.
    """
    if gains.K_earlier is None:
        return gains
    r = gains.mpc_ref
    return gains._replace(mpc_ref=jnp.concatenate([0.0 * r[:1], r[:-2], r[-2:-1] + r[-1:]]))


def design_family(params: Params, T_s: Any, mask_width: Any = 1.0) -> tuple[GainSchedule, Float[Array, ""]]:
    """Gains over the tissue's stiffness, and how badly the worst Riccati equation is missed; as `design_one`."""
    assert params.listening is not None
    stiffness = jnp.asarray(params.listening.stiffness, jnp.float64)
    # One design over all knots compiles once.
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(_wide(knot) for knot in params.knots))
    gains, residual = jax.vmap(lambda knot: design_one(knot, T_s, mask_width))(stacked)
    unit = jax.vmap(_on_unit_tissue)(gains, stiffness)
    knots = tuple(
        Knot(jnp.log(stiffness[i]), stacked.K2[i], jax.tree.map(lambda leaf, i=i: leaf[i], unit))
        for i in range(len(params.knots))
    )
    learning = repetition(params.listening.harmonics, params.listening.beats, T_s)
    return GainSchedule(knots, params.listening.constants(T_s), learning), jnp.max(residual)


def _wide(params: Params) -> Params:
    """With diagonals for all weights, so that knots with and without are alike."""
    lam, delta = jnp.broadcast_to(params.lam, (HU_MAX,)), jnp.broadcast_to(params.delta, (HP_MAX,))
    leaves: Params = jax.tree.map(jnp.asarray, params)
    return replace(leaves, lam=lam, delta=delta)


def _on_unit_tissue(gains: Gains, stiffness: Any) -> Gains:
    found = with_gain(gains, stiffness)
    vectors: dict[str, Any] = {name: jnp.stack(getattr(found, name)) for name in ("gamma", "K", "L")}
    return found._replace(**vectors)


def _row_by_row(params: Params, T_s: Any, force_filter: ForceFilter | None) -> tuple[Gains, Float[Array, " rows"]]:
    found: tuple[Gains, Any] = jax.vmap(lambda one: design_one(one, T_s, 1.0, force_filter))(params)
    return found


_design = JitOnce(_row_by_row)


def designed(
    params: Params, T_s: Any, force_filter: ForceFilter | None = None
) -> tuple[Gains, Float[Array, " controllers"]]:
    """Gains, and Riccati residuals [-], of a batch of one leading dimension; float64, traceable.

    Whoever calls it gets the same program for the same number of controllers of one structure.

    Args:
        params: The controllers.
        T_s: Sampling time [s].
        force_filter: What the measured force passes first, as for `design_one`.

    Raises:
        InputError: As `design_one`.
    """
    check_sampling(params, T_s)
    arguments = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), (params, T_s, force_filter))
    found: tuple[Gains, Any] = _design(*arguments)
    return found


@in_float64
def design(params: Params, timing: Timing | None = None, force_filter: ForceFilter | None = None) -> Gains:
    """Gains of a controller, or of a batch of them.

    Any mix of parameters and horizons of one batch size runs the same compiled program. Differentiable
    in forward and reverse mode (with 64-bit JAX switched on in the caller).

    Args:
        params: The parameters; leading dimensions are a batch.
        timing: Sampling; which delay the design assumes is a parameter, `designed_delay`.
        force_filter: What the measured force passes first (`Experiment.loop_path().force_filter`), unless the
            parameters say it; none by default.

    Returns:
        L (…, 3), K (…, 3 + N), mpc_ref (…, 64), mpc_x (…, 2), mpc_u (…), … in float64; see `Gains`.

    Raises:
        InputError: At this sampling time a part of the controller would do nothing (`check_sampling`), or an argument
            is of another type.
    """
    check_type("params", params, Params, MAKE_PARAMS)
    check_type("timing", timing, Timing | None, "Write Timing(T_s=1e-3), or leave it out.")
    check_type("force_filter", force_filter, ForceFilter | None, "Take that of experiment.loop_path().")
    batch = params.batch_shape
    gains, _ = designed(reshaped(params, len(batch), -1), (timing or Timing()).T_s, force_filter)
    return reshaped(gains, 1, *batch)
