"""The closed loop as a matrix, built by running the law and the world themselves."""

from collections.abc import Callable
from typing import Any

import jax
import jax.flatten_util
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.law import cascade
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.stability import held_beat
from jaxmpc.stability.held_beat import HeldBeat
from jaxmpc.synthesis.plant import hold_integrals
from jaxmpc.world.contact import Contact, ContactState, init, move, sense
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.once import JitOnce

Scalar = Float[Array, ""]

DOUBLINGS = 44
"""Squarings in `spectral_radius`: a Jordan block of size 3 at ρ then costs 4e-12 of accuracy."""
PARALLEL = 1e-12
"""Squared sine between x and Ax below which the dominant eigenvalue counts as real."""


def contact_of(stiffness: Any, K2: Any, path: LoopPath) -> Contact:
    """World of one axis with the damping of one controller.

    Args:
        stiffness: K_s [N/m].
        K2: Damping [1/s].
        path: Delays and filters; ideal damping is inside the plant.
    """
    K2 = jnp.asarray(K2)
    inside = K2 if path.ideal else jnp.zeros_like(K2)
    first, second = hold_integrals(inside, path.T_s)
    return Contact(
        T_s=jnp.asarray(path.T_s),
        stiffness=jnp.asarray(stiffness),
        phi=(first, 1.0 - inside * first),
        gamma=(second, first),
        K2=K2 - inside,
        velocity_pole=_pole(path.velocity_cutoff, path.T_s),
        sensor_pole=_pole(path.sensor_cutoff, path.T_s),
        extra_delay=jnp.asarray(path.delay - 1.0),
    )


def contacts_of(K2: Any, stiffness: Any, path: LoopPath) -> Contact:
    """Contacts of controllers with tissues, (controllers, stiffness)."""
    over_tissues = jax.vmap(contact_of, in_axes=(0, None, None))
    found: Contact = jax.vmap(over_tissues, in_axes=(None, 0, each_its_own(path)))(stiffness, K2, path)
    return found


def each_its_own(path: LoopPath) -> LoopPath:
    """Dimensions of a path to be mapped over controllers: 0 where each has a number of its own, else None."""
    axes: LoopPath = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, path)
    return axes


contacts_between = JitOnce(contacts_of)


def _pole(cutoff: Any, T_s: Any) -> Any:
    return jnp.where(cutoff > 0.0, jnp.exp(-cutoff * T_s), 0.0)


def closed_loop_matrix(gains: Gains, contact: Contact, held: HeldBeat | None = None) -> Float[Array, "n n"]:
    """Transition matrix of one axis: controller and contact together.

    Args:
        gains: One controller.
        contact: One world; heart, noise and reference are zero.
        held: What is learned of the heart's beat; None learns nothing.
    """
    zero = jnp.zeros_like(gains.mpc_u)
    whole = constant_reference(gains._replace(schedule=None))

    def advance(controller: Any, state: ContactState) -> tuple[Any, ContactState]:
        axis, learned = controller
        force, state = sense(contact, state, zero)
        axis, force = cascade.filter_force(whole, axis, force)
        added = zero
        if held is not None:
            learned, added = held_beat.step(held, learned, force)
        axis, v = cascade.respond(whole, axis, force, (added,))
        return (axis, learned), move(contact, state, v)[0]

    start = cascade.init(whole, zero), None if held is None else held_beat.still(held)
    return transition_matrix(gains, advance, start, init(zero))


def transition_matrix(
    gains: Gains, advance: Callable[[Any, Any], tuple[Any, Any]], controller: Any, state: Any
) -> Float[Array, "n n"]:
    """Derivative of one sample of a closed loop by its state, raveled: the controller's part first.

    Args:
        gains: The controller.
        advance: One sample: the next states of controller and world.
        controller: Where it is taken; holds the `AxisState` of each axis.
        state: Of the world, likewise.
    """
    flat, restore = jax.flatten_util.ravel_pytree((controller, state))

    def active(part: Any) -> Any:
        # An active state without gain (MPC alone) stays at its start, zero: it is no mode of the loop.
        axis = isinstance(part, AxisState)
        return part._replace(p_hat=jnp.where(gains.K[3] == 0.0, 0.0, part.p_hat)) if axis else part

    def following(vector: Array) -> Array:
        controller, state = restore(vector)
        controller = jax.tree.map(active, controller, is_leaf=lambda node: isinstance(node, AxisState))
        return jax.flatten_util.ravel_pytree(advance(controller, state))[0]

    matrix: Array = jax.jacfwd(following)(flat)
    return matrix


@jax.custom_jvp
def spectral_radius(A: Float[Array, "n n"]) -> Scalar:
    """Largest magnitude of an eigenvalue [-].

    ‖A^N‖^(1/N) with N = 2^44 by repeated squaring: array products alone, which batch and run anywhere. The
    derivative is that of the dominant eigenvalues alone: a loop with delays is defective at 0, where
    derivatives of all eigenvalues at once are NaN.
    """
    return _dominant(A)[0]


def _dominant(A: Float[Array, "n n"]) -> tuple[Scalar, Float[Array, "n n"]]:
    """Spectral radius, and a high power of A, which maps everything into the dominant eigenspace."""

    def square(_: Any, state: tuple[Array, Array]) -> tuple[Array, Array]:
        power, log_size = state
        power = power @ power
        size = jnp.max(jnp.abs(power))
        return power / size, 2.0 * log_size + jnp.log(size)

    size = jnp.max(jnp.abs(A))
    power, log_size = jax.lax.fori_loop(0, DOUBLINGS, square, (A / size, jnp.log(size)))
    return jnp.exp(log_size / 2.0**DOUBLINGS), power


@spectral_radius.defjvp
def _spectral_radius_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    r"""dρ/ρ = tr((YᵀAX)⁻¹ Yᵀ dA X)/k for bases X, Y of the dominant right and left eigenspaces.

    k = 1 for a real eigenvalue, where X = x; k = 2 for a complex pair, where X = [x, Ax], Y = [y, Aᵀy].
    """
    (A,), (dA,) = primals, tangents
    radius, power = _dominant(A)
    some = jnp.cos(1.0 + jnp.arange(len(A)))
    x, y = power @ some, power.T @ some[::-1]
    x, y = x / jnp.max(jnp.abs(x)), y / jnp.max(jnp.abs(y))
    X, Y = jnp.stack([x, A @ x], 1), jnp.stack([y, A.T @ y], 1)
    (a, b), (c, d) = Y.T @ A @ X
    aligned = (x @ X[:, 1]) ** 2 / ((x @ x) * (X[:, 1] @ X[:, 1]))
    single = 1.0 - aligned < PARALLEL
    determinant = jnp.where(single, 1.0, a * d - b * c)
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / determinant
    pair = 0.5 * Y @ inverse.T @ X.T
    weights = jnp.where(single, jnp.outer(y, x) / a, pair)
    return radius, radius * jnp.sum(weights * dA)
