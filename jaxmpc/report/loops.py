"""What a controller looks like to a control engineer: its open loops over frequency and its step response."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from jaxmpc.experiment import Experiment
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains
from jaxmpc.stability.family import gains_on
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.synthesis.params import Params
from jaxmpc.world.contact import Contact
from jaxmpc.world.contact import init as contact_init
from jaxmpc.world.contact import move as contact_move
from jaxmpc.world.contact import sense as contact_sense
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import on_cpu
from jaxmpc.xla.precision import in_float64

LOWEST_HZ, POINTS = 0.1, 500
"""Where the curves over frequency begin, and their points up to the Nyquist frequency, in equal ratios."""

STEP_SAMPLES = 512
"""Length of the answer to a step, from which overshoot is read [samples]."""

_contact = jax.jit(contact_of)


class Curves(NamedTuple):
    """One controller on the experiment's tissues, which one with knots knows."""

    frequency: Float[np.ndarray, " points"]
    """[Hz]"""
    open_loop: Complex[np.ndarray, "stiffness points"]
    """L, cut where its sensitivity peaks higher: at v or at a = v − K₂ẋ [-]."""
    time: Float[np.ndarray, " samples"]
    """[s]"""
    force: Float[np.ndarray, "stiffness samples"]
    """Answer of the linear loop to a step of its reference by 1 N [N]."""

    @property
    def sensitivity(self) -> Float[np.ndarray, "stiffness points"]:
        """|S| = |1/(1 + L)| [-]."""
        magnitude: np.ndarray = 1.0 / np.abs(1.0 + self.open_loop)
        return magnitude

    @property
    def overshoot(self) -> Float[np.ndarray, " stiffness"]:
        """How far the force exceeds the step, relative to it [-]."""
        excess: np.ndarray = np.maximum(self.force.max(axis=1) - 1.0, 0.0)
        return excess


@on_cpu()
@in_float64
def curves(params: Params, experiment: Experiment, ideal: bool) -> Curves:
    """Curves of one controller.

    Args:
        params: The controller.
        experiment: Its tissues, delay and filters; the step is that of its linear loop.
        ideal: Whether L is that of the ideal loop, or of the loop as it runs; as in `jaxmpc.margins`.
    """
    T_s = experiment.sampling_time
    theta = np.geomspace(2.0 * np.pi * LOWEST_HZ * T_s, np.pi, POINTS)
    controllers = gains_on(params, experiment.stiffness, experiment.loop_path())
    loops, forces = [], []
    for i, K_s in enumerate(experiment.stiffness):
        gains, K2 = jax.tree.map(lambda leaf, i=i: leaf[i], controllers)
        paths = (experiment.loop_path(kind).with_cutoff(params.velocity_cutoff) for kind in (ideal, None))
        judged, met = (_world(K_s, K2, path) for path in paths)
        cuts = np.asarray(_open_loops(gains, judged, theta))
        loops.append(min(cuts[:1] if ideal else cuts, key=lambda loop: np.abs(1.0 + loop).min()))
        forces.append(step_response(gains, met)[0])
    return Curves(theta / (2.0 * np.pi * T_s), np.stack(loops), np.arange(STEP_SAMPLES) * T_s, np.stack(forces))


@JitOnce
def _open_loops(gains: Gains, contact: Contact, theta: Any) -> Any:
    """Cut at v and at a, (2, points)."""
    return jnp.stack([loop_response(gains, contact, theta, cut)[0] for cut in (0.0, 1.0)])


def _world(stiffness: float, K2: Any, path: LoopPath) -> Contact:
    """One contact as plain arrays; its stiffness has the shape (1, 1)."""
    plain: Contact = jax.tree.map(np.asarray, _contact(np.array([[stiffness]]), K2, path))
    return plain


def step_response(gains: Gains, contact: Contact, samples: int = STEP_SAMPLES) -> Float[np.ndarray, "worlds samples"]:
    """Measured force of the linear loop after a step of its reference by 1 N at rest, by the law itself [N].

    Args:
        gains: One controller, plain arrays.
        contact: Worlds whose stiffness has the shape (worlds, 1).
        samples: How many.
    """
    # The law is plain arithmetic: it runs on arrays of tissues as it stands, and nothing is compiled.
    summed = gains._replace(mpc_ref=(np.sum(gains.mpc_ref),))
    zero: Any = np.zeros_like(contact.stiffness)
    controller, state = cascade.init(gains, zero), contact_init(zero)
    forces = []
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(samples):
            force, state = contact_sense(contact, state, zero)
            controller, v = cascade.step(summed, controller, force, (1.0,))
            state, _ = contact_move(contact, state, v)
            forces.append(force)
    return np.concatenate(forces, axis=1)
