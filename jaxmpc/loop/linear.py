"""One sample of the linear closed loop: law, contact and imperfections of one axis."""

from typing import Any, NamedTuple

from jaxmpc.law import cascade, schedule
from jaxmpc.law.gains import Gains
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import plus
from jaxmpc.law.stiffness import SILENT
from jaxmpc.world import contact
from jaxmpc.world.contact import Contact
from jaxmpc.world.quantise import quantise

Scalar = Any

HIGHEST_FORCE = 1e3
"""A run whose force leaves this has diverged [N]."""
HIGHEST_ERROR = 20.0
"""A run whose residual leaves this is beyond the force limit, as is one whose force leaves the experiment's [N]."""


class AxisSignals(NamedTuple):
    """What one axis meets: at one sample, or with leading dimensions (…, steps)."""

    heart: Scalar
    """Position of the heart's surface [m]."""
    noise: Scalar
    """[N]"""
    force_ref: Any
    """Wanted force, of the sample itself or 1 … H_p samples ahead [N]."""
    score: Scalar
    """Whether the sample counts."""
    acceleration: Scalar | None = None
    """Acceleration of the tip by what else acts on it, such as friction [m/s²]; None costs nothing."""
    late: Any = None
    """Whether the sample is of the end of the run, where swinging is judged; None costs nothing and judges none."""
    wanted: Scalar | None = None
    """Wanted force of the sample itself where `force_ref` is of later ones; None where that is its first [N]."""

    @property
    def present(self) -> Scalar:
        """What is wanted at the sample itself, by which its force is judged [N]."""
        return self.force_ref[0] if self.wanted is None else self.wanted


class Sample(NamedTuple):
    """What a recorded run keeps of one sample."""

    force: Scalar
    """Measured force [N]."""
    force_ref: Any
    """Wanted force: what the controller was told, one value or H_p of them [N]."""
    u: Scalar
    """MPC output [N]."""
    v: Scalar
    """Command of the cascade [m/s²]."""
    a: Scalar
    """Acceleration asked of the robot [m/s²]."""
    p_hat: Scalar
    """Estimated disturbance [m/s²]."""
    tip: Scalar
    """Tip position [m]."""
    true_force: Scalar
    """Force on the tissue itself [N]."""


class LinearCarry(NamedTuple):
    """State of the whole loop between two samples."""

    controller: cascade.AxisState
    contact: contact.ContactState


def start(gains: Gains) -> LinearCarry:
    """The loop at rest: the tip touches without force."""
    zero = 0.0 * gains.mpc_u
    return LinearCarry(cascade.init(gains, zero), contact.init(zero))


def advance(
    gains: Gains, world: Contact, lsb: Scalar, carry: LinearCarry, now: AxisSignals, ops: Ops
) -> tuple[LinearCarry, Sample]:
    """One sample of the closed loop.

    Args:
        gains: The controller, taken apart into scalars.
        world: Constants of the axis.
        lsb: Quantisation of the force sensor [N]; 0 is none.
        carry: State.
        now: What is met at this sample.
        ops: Scalar functions.
    """
    clean, state = contact.sense(world, carry.contact, now.heart)
    force = quantise(clean + now.noise, lsb, ops)
    tip, true = state.x, contact.true_force(world, carry.contact, now.heart)
    controller, dither, _ = schedule.listen(gains, carry.controller, force, tip, now.present, 0.0, SILENT, ops)
    known, K2 = schedule.now(gains, world.K2, controller, ops)
    controller, v = cascade.step(known, controller, force, tuple(plus(wanted, dither) for wanted in now.force_ref))
    state, a = contact.move(world._replace(K2=K2), state, v, now.acceleration)
    sample = Sample(force, now.force_ref, controller.u, v, a, controller.p_hat, tip, true)
    return LinearCarry(controller, state), sample
