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
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.law.chain import mass_matrix, pose, tip, with_point_mass
from jaxmpc.stability import margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import spring_integrals
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath, loop_path
from jaxmpc.xla.extremes import greatest
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
    from jaxmpc.experiment.build import robot_of
    from jaxmpc.world.arm import chain

    robot = robot_of(experiment)
    truth = with_point_mass(chain(), robot.tool_mass)
    at = pose(truth, tuple(np.asarray(robot.posture)), ARRAYS)
    J = np.array(tip(truth, at).jacobian, float)
    M = np.array(mass_matrix(truth, at), float) + np.diag(truth.armature)
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
    gains, _ = design_one(params, path.T_s, 1.0, path.force_filter)
    path = path.with_cutoff(params.velocity_cutoff)

    def mode(K_s: Any, omega: Any) -> Any:
        return margins_one(gains, on_spring(contact_of(K_s, params.K2, path), omega), ideal=False).M_s

    cells = jax.vmap(jax.vmap(mode, in_axes=(None, 0)), in_axes=(0, None))(stiffness, frequencies)
    worst: Array = greatest(cells)
    return worst


_peaks = JitOnce(_over_cells)


def on_spring(contact: Contact, omega: Any) -> Contact:
    """The same world with its tip on a spring ω² as well; its damping must be a sampled one."""
    # Below it the cosine is 1 to the last bit, and the tip is free.
    omega = jnp.maximum(omega, 1e-6 / contact.T_s)
    first, second = spring_integrals(omega**2, contact.T_s)
    return contact._replace(phi=(first, jnp.cos(omega * contact.T_s)), gamma=(second, first), spring=omega**2)
