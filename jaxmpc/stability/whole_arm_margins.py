r"""Margins of the whole arm, axis by axis, cut at v, at a = v − K₂ẋ and at the measured force.

Where w is added to a signal, what comes back of it is S w: the sensitivity S = 1/(1 + L) of the loop that is cut there,
with all other axes and cuts closed. From x⁺ = A x + B w, s = C x + D w (`whole_arm.System`)

    S = 1 + C (z 1 − A)⁻¹ B + D   at v and at a,   S = C (z 1 − A)⁻¹ B + D   at the force, which s holds with w in it

at z = e^{jθ}. On one rigid axis whose model holds, the cut at the force is the cut at v: the law has one input and one
output, C from y to v, and what is between v and y is the other half of the same loop (`stability.response`). On the
whole arm it is not: computed torque uses the force too, late by a sample, and where masses are wrong the axes are tied.
An observer of the joints' momentum is inside every cut; like the cascades it is told what was asked for.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_on_its_tissue, structure_of
from jaxmpc.files.errors import InputError
from jaxmpc.stability.crossings import LoopMargins, loop_margins
from jaxmpc.stability.loop import spectral_radius
from jaxmpc.stability.whole_arm import ROUNDING, System, whole_arm_system
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from jaxmpc.world import arm
from jaxmpc.world.robot import with_cutoff
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64


class WholeArmMargins(NamedTuple):
    """Margins per axis X, Y, Z, each shape (3,): M_s = ∞ and the others NaN where the loop is unstable."""

    at_v: LoopMargins
    at_a: LoopMargins
    at_force: LoopMargins
    spectral_radius: Float[Array, ""]
    """Largest |eigenvalue| of the loop [-]."""


def sensitivity(system: System, theta: Any) -> Complex[Array, "9"]:
    """S at one angle θ = ω T_s [rad]: at v, at a and at the force, X, Y, Z each; traceable."""
    z = jnp.exp(1j * theta)
    x = jnp.linalg.solve(z * jnp.eye(len(system.A)) - system.A, system.B + 0j)
    seen = system.C @ x + system.D
    push, felt = jnp.diagonal(seen[:6].reshape(2, 3, 6)[..., :3], axis1=1, axis2=2), jnp.diagonal(seen[6:, 3:])
    return jnp.concatenate([1.0 + push.ravel(), felt])


@in_float64
def whole_arm_margins(params: Params, experiment: Experiment, sticking: bool = False) -> WholeArmMargins:
    """Margins of one controller on the whole arm; of a family those of its fixed gains, with which contact begins.

    Args:
        params: One controller.
        experiment: On the arm, with one stiffness.
        sticking: Whether the joints stick, else they slide (`whole_arm`).

    Raises:
        InputError: The controller is a batch, or the experiment has several stiffnesses.
    """
    if params.batch_shape:
        raise InputError("params", f"a batch {params.batch_shape}", "one controller", "Ask for one after another.")
    check_sampling(params, experiment.sampling_time)
    robot = with_cutoff(robot_on_its_tissue(experiment), params.velocity_cutoff, ops)
    kind = structure_of(experiment.arm, experiment.tissue)
    force_filter = experiment.loop_path().force_filter
    T_s = experiment.sampling_time
    found: WholeArmMargins = _margins(_system(params, robot, T_s, force_filter, kind=kind, sticking=sticking), T_s)
    return found


def _designed(params: Params, robot: Any, T_s: Any, force_filter: Any, kind: Any, sticking: bool) -> System:
    gains, _ = design_one(params, T_s, force_filter=force_filter)
    return whole_arm_system(arm.chain(), kind, robot, gains, params.K2, sticking)


def _of_system(system: System, T_s: Any) -> WholeArmMargins:
    radius = spectral_radius(system.A)

    def margins_at(cut: Any) -> LoopMargins:
        def loop(theta: Any, late: Any = None) -> Any:
            opened = jnp.vectorize(lambda at: 1.0 / sensitivity(system, at)[cut] - 1.0)(theta)
            return opened if late is None else opened * jnp.exp(-1j * theta * late)

        return loop_margins(loop, loop, T_s)

    cuts = jax.lax.map(margins_at, jnp.arange(9))
    stable = radius < 1.0 + ROUNDING
    lost = (jnp.inf, jnp.nan, jnp.nan, jnp.nan, jnp.nan)
    held = [jnp.where(stable, values, worst).reshape(3, 3) for values, worst in zip(cuts, lost, strict=True)]
    at_v, at_a, at_force = (LoopMargins(*(field[i] for field in held)) for i in range(3))
    return WholeArmMargins(at_v, at_a, at_force, radius)


_system = JitOnce(_designed, static_argnames=("kind", "sticking"))
_margins = JitOnce(_of_system)
