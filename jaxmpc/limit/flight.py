"""A linear law flown in time, in the linear loop of the simulation: whether it keeps what its response promises."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmpc.experiment import Experiment
from jaxmpc.limit.law import LinearLaw
from jaxmpc.quantities import AXES
from jaxmpc.stability.loop import contact_of
from jaxmpc.world.contact import Contact, init, move, sense
from jaxmpc.world.quantise import quantise
from jaxmpc.xla import ops
from jaxmpc.xla.precision import in_float64


class Flown(NamedTuple):
    """Root mean squares over the samples that count."""

    rms: float
    """Residual as measured [N]."""
    true_rms: float
    """Residual of the force on the tissue itself [N]."""
    chatter: float
    """Change of the acceleration asked, from sample to sample [m/s²]."""


@in_float64
def flown(
    law: LinearLaw,
    stiffness: float,
    experiment: Experiment,
    axis: str,
    acceleration: Float[np.ndarray, " steps"] | None = None,
) -> Flown:
    """Fly an experiment's heart, reference, sensor noise and quantisation.

    Args:
        law: What flies.
        stiffness: K_s of the tissue [N/m].
        experiment: What it meets.
        axis: "x", "y" or "z".
        acceleration: What else acts on the tip (`uncompensated_acceleration`) [m/s²]; None is nothing.
    """
    index, signals = AXES.index(axis), experiment.signals
    contact = contact_of(stiffness, 0.0, experiment.loop_path())
    pushed = np.zeros(experiment.steps) if acceleration is None else acceleration
    met = signals.heart[:, index], signals.noise[:, index], signals.force_ref[: experiment.steps, index], pushed
    error, true_error, asked = map(np.asarray, _run(law, contact, experiment.sensor.lsb[index], met))
    score = signals.score[:, index]

    def root(values: Any) -> float:
        return float(np.sqrt(np.mean(values[score] ** 2)))

    return Flown(root(error), root(true_error), root(np.diff(asked, prepend=asked[:1])))


@jax.jit
def _run(law: LinearLaw, contact: Contact, lsb: Any, met: Any) -> Any:
    def sample(carry: Any, now: Any) -> Any:
        memory, state = carry
        heart, noise, wanted, push = now
        true = contact.stiffness * (state.x - heart)
        force, state = sense(contact, state, heart)
        error = quantise(force + noise, lsb, ops) - wanted
        v = law.C @ memory + law.D * error
        state, a = move(contact, state, v, push)
        return (law.A @ memory + law.B * error, state), (error, true - wanted, a)

    start = jnp.zeros(len(law.B)), init(jnp.asarray(0.0))
    return jax.lax.scan(sample, start, jax.tree.map(jnp.asarray, met))[1]
