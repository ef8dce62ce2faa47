r"""Margins while the joints stick: friction in presliding is a spring, and the tip hangs on it.

Before a joint slides, Dahl's friction is a spring F_c/z (`jaxmpc.world.friction`). Near crossover the null space is
held by its inertia, so what the four springs K do to the tip is, with J̄ = M⁻¹ Jᵀ Λ,

    ẍ = a − Λ⁻¹ J̄ᵀ K J̄ x                       an eigenvalue ω² of which is one mode:   ẍ = a − ω² x

and because the three axes have the same controller, the loop falls apart into these three modes. Sampled, with c and s
the cosine and sine of ω T_s,

    xₖ₊₁ = c xₖ + s/ω ẋₖ + (1 − c)/ω² aₖ,   ẋₖ₊₁ = −ω s xₖ + c ẋₖ + s/ω aₖ

which is the tip of `jaxmpc.world.contact` with φ = (s/ω, c), γ = ((1 − c)/ω², s/ω) and a disturbance −ω² xₖ.
"""

from typing import TYPE_CHECKING, Any

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.law import cascade
from jaxmpc.law import chain as arm
from jaxmpc.law.cascade import Gains
from jaxmpc.stability.crossings import LOWEST, POINTS
from jaxmpc.stability.loop import contact_of, spectral_radius
from jaxmpc.stability.response import controller_response, tip_response
from jaxmpc.stability.search import peak
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world import contact as world
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath, loop_path
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

if TYPE_CHECKING:
    from jaxmpc.experiment import Experiment


def presliding_frequencies(experiment: "Experiment") -> Float[np.ndarray, "3"]:
    """Frequencies ω of the tip on its sticking joints, without tissue and controller, lowest first [rad/s].

    Left out are what the controller compensates of the friction, and a cable mode.

    Args:
        experiment: Its arm, in its resting posture.
    """
    from jaxmpc.experiment.tables import robot_of
    from jaxmpc.world.arm import chain

    robot = robot_of(experiment)
    truth = arm.with_point_mass(chain(), robot.tool_mass)
    at = arm.pose(truth, tuple(np.asarray(robot.posture)), np)
    J = np.array(arm.tip(truth, at).jacobian, float)
    M = np.array(arm.mass_matrix(truth, at), float) + np.diag(truth.armature)
    mobility = J @ np.linalg.solve(M, J.T)
    J_bar = np.linalg.solve(M, J.T) @ np.linalg.inv(mobility)
    springs = np.asarray(robot.friction.coulomb) / np.asarray(robot.friction.presliding)
    squares = np.linalg.eigvals(mobility @ J_bar.T @ (springs[:, None] * J_bar)).real
    frequencies: np.ndarray = np.sqrt(np.sort(np.maximum(squares, 0.0)))
    return frequencies


@in_float64
def presliding_peak(
    params: Params, stiffness: Any, frequencies: Any, path: LoopPath | None = None
) -> Float[Array, " tissues"]:
    """Peak sensitivity M_s of the loop as it runs while the joints stick, the worst of the modes [-].

    Args:
        params: One controller.
        stiffness: K_s, shape (tissues,) [N/m].
        frequencies: Of the modes (`presliding_frequencies`), shape (modes,) [rad/s]; 0 is a joint without friction.
        path: Delay and filters of a loop with sampled damping; None is the default one.

    Returns:
        Shape (tissues,); ∞ where a mode is unstable.
    """
    given = [jnp.asarray(values, jnp.float64) for values in (stiffness, frequencies)]
    worst: Array = _peaks(params, *given, path or loop_path())
    return worst


def _over_cells(params: Params, stiffness: Any, frequencies: Any, path: LoopPath) -> Float[Array, " tissues"]:
    gains, _ = design_one(params, path.T_s)

    def mode(K_s: Any, omega: Any) -> Any:
        return _peak(gains, _on_spring(contact_of(K_s, params.K2, path), omega), omega)

    cells = jax.vmap(jax.vmap(mode, in_axes=(None, 0)), in_axes=(0, None))(stiffness, frequencies)
    return jnp.max(cells, axis=1)


_peaks = JitOnce(_over_cells)


def _on_spring(contact: Contact, omega: Any) -> Contact:
    """The tip of a world on a spring ω², but for the disturbance −ω² x."""
    # Below it the cosine is 1 to the last bit, and the tip is free.
    omega = jnp.maximum(omega, 1e-6 / contact.T_s)
    turned = 0.5 * omega * contact.T_s
    along = jnp.sin(2.0 * turned) / omega
    return contact._replace(phi=(along, jnp.cos(2.0 * turned)), gamma=(2.0 * (jnp.sin(turned) / omega) ** 2, along))


def _peak(gains: Gains, contact: Contact, omega: Any) -> Any:
    """M_s of one mode, the worse of the cuts at v and at a; ∞ if it is unstable."""
    theta = LOWEST * (jnp.pi / LOWEST) ** jnp.linspace(0.0, 1.0, POINTS)

    def at_cut(cut_at_a: bool) -> Any:
        def closeness(at: Any) -> Any:
            return -jnp.abs(1.0 + _response(gains, contact, omega, at, cut_at_a))

        top = jnp.clip(jnp.argmax(closeness(theta)), 1, POINTS - 2)
        highest = jnp.stack([peak(closeness, theta[top - 1], theta[top + 1]), theta[-1]])
        return jnp.max(-1.0 / closeness(highest))

    stable = spectral_radius(_closed_loop_matrix(gains, contact, omega)) < 1.0
    return jnp.where(stable, jnp.maximum(at_cut(False), at_cut(True)), jnp.inf)


def _response(gains: Gains, contact: Contact, omega: Any, theta: Any, cut_at_a: bool) -> Any:
    """Open loop as `response.loop_response` has it, with the spring's force closed about the tip."""
    q = jnp.exp(-1j * theta)
    x, xdot = tip_response(contact, theta)
    held = 1.0 + omega**2 * x / q ** (1.0 + contact.extra_delay)
    sensor = (1.0 - contact.sensor_pole) / (1.0 - contact.sensor_pole * q)
    velocity = (1.0 - contact.velocity_pole) / (1.0 - contact.velocity_pole * q)
    force = -controller_response(gains, q) * sensor * contact.stiffness * x / held
    damping = contact.K2 * velocity * xdot / held
    return force + damping if cut_at_a else force / (1.0 + damping)


def _closed_loop_matrix(gains: Gains, contact: Contact, omega: Any) -> Float[Array, "n n"]:
    """Transition matrix of controller and tip on its spring; as `loop.closed_loop_matrix`."""
    zero = jnp.zeros_like(gains.mpc_u)
    flat, restore = jax.flatten_util.ravel_pytree((cascade.init(zero, cascade.order(gains)), world.init(zero)))
    gains = gains._replace(mpc_ref=gains.mpc_ref[:1])

    def advance(vector: Array) -> Array:
        controller, state = restore(vector)
        controller = controller._replace(p_hat=jnp.where(gains.K[3] == 0.0, 0.0, controller.p_hat))
        force, sensed = world.sense(contact, state, zero)
        controller, v = cascade.step(gains, controller, force, (zero,))
        state, _ = world.move(contact, sensed, v, -(omega**2) * state.x)
        return jax.flatten_util.ravel_pytree((controller, state))[0]

    return jax.vmap(advance, out_axes=1)(jnp.eye(len(flat)))
