r"""Gives the control back to a schedule after a push, without hearing the tissue again.

An early beat or a cough on stiff tissue is as sudden as a change of the tissue, and doubt rightly takes the authority
from the schedule. But the stiffness that was known is known still, and to hear it once more takes seconds in which the
fixed gains leave the heart's motion. So a schedule has credit κ: with it, and once doubt is over, the authority comes
back by itself, if something has pushed the tip. With the mean square over a second of the force's error, s², the
largest of any axis,

    push   p = clip(4 s²/F² − 4, 0, 1)
    pardon m = p clip(5 κ − 1, 0, 1) clip(4 t − 2, 0, 1) clip(10 l − 8, 0, 1)

with the trust t, which falls where a guard had to act, and how much of the usual noise has been learned, l: without it
nobody hears a loop ring. Whether the tissue has changed after all, the loop tells: it rings or swings again. The
schedule is proven (π → 1) by having all of the control for a while; a doubt that comes before that costs most of the
credit, one that comes after it a little, so that beats in a row are pardoned and a loop with the wrong gains is not.
No push, or one that is larger than any beat's, and the credit is gone: then the tissue is heard first. With a = 1 while
the schedule has all of the control, D = 1 while doubt takes away what it has of it, q = 1 while the sine tells the
stiffness, and h = clip(4 s²/H² − 4, 0, 1) where the push is too large, times in s,

    κ̇ = (10 q + 1) a (1 − D) (1 − κ) − ((0.6 + 3 (1 − p)) (1 − a) + 50 h + (20 + 800 (1 − π)) D) κ
    π̇ = a (1 − π)/0.35 − (1 − a) π/0.8
"""

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar
from jaxmpc.law.stiffness import StiffnessEstimate

FELT, HEAVY = 0.09, 0.29
"""F, RMS of the force's error over a second from which on something has pushed the tip, and from which on more than a
beat has [N]: a row of early beats on 1900 N/m has 0.28, tissue that turns four times softer 0.25 to 0.45."""
RETURNING = 4.0
"""Rate at which the authority comes back [1/s]."""
EARNED, REGAINED = 10.0, 1.0
"""Rates at which credit grows while the sine tells the stiffness, and while the schedule has the control [1/s]."""
FADING, LAPSING, LOST = 0.6, 3.0, 50.0
"""Rates at which it goes while the schedule has not all of the control, so that the tissue is heard after three
seconds at most; and in addition without a push, and after one that is too large [1/s]."""
SPENT, FORFEITED = 20.0, 800.0
"""Rates at which it goes while doubt takes the control away, and with nothing proven in addition [1/s]: the control is
gone after some 7 ms."""
PROVING, FORGETTING = 0.35, 0.8
"""Time constants with which the schedule is proven and that is forgotten [s]."""


def pardon(state: StiffnessEstimate, strain: Scalar, ops: Ops) -> Scalar:
    """m, how far a schedule without the control may take it back [-].

    Args:
        state: What is known of the tissue under one axis.
        strain: s², mean square of the force's error over a second, the largest of any axis [N²].
        ops: Scalar functions.
    """
    trusted = ops.clip(4.0 * state.trust - 2.0, 0.0, 1.0) * ops.clip(10.0 * (state.learned - 0.8), 0.0, 1.0)
    return push(strain, ops) * ops.clip(5.0 * state.credit - 1.0, 0.0, 1.0) * trusted


def step(
    state: StiffnessEstimate, T_s: Scalar, telling: Scalar, settled: Scalar, large: Scalar, strain: Scalar, ops: Ops
) -> StiffnessEstimate:
    """Advance credit and proof by one sample.

    Args:
        state: What is known of the tissue under one axis.
        T_s: Sampling time [s].
        telling: How surely the sine tells the stiffness that is believed [-].
        settled: Whether the schedule has all of the control [-].
        large: Whether doubt takes it away [-].
        strain: s², mean square of the force's error over a second, the largest of any axis [N²].
        ops: Scalar functions.
    """
    gained = (EARNED * telling + REGAINED) * settled * (1.0 - large)
    taken = large * ops.clip(20.0 * state.authority, 0.0, 1.0)
    too_large = ops.clip(4.0 * (strain / HEAVY**2 - 1.0), 0.0, 1.0)
    fading = (1.0 - settled) * (FADING + LAPSING * (1.0 - push(strain, ops)))
    lost = fading + LOST * too_large + taken * (SPENT + FORFEITED * (1.0 - state.proven))
    # No more than half of it in a sample, however long that is.
    kept = state.credit * (1.0 - ops.minimum(T_s * lost, 0.5))
    proven = settled * (1.0 - state.proven) / PROVING - (1.0 - settled) * state.proven / FORGETTING
    return state._replace(
        credit=ops.clip(kept + T_s * gained * (1.0 - state.credit), 0.0, 1.0), proven=state.proven + T_s * proven
    )


def push(strain: Scalar, ops: Ops) -> Scalar:
    """p, whether something has pushed the tip lately [-]; s² as in `pardon` [N²]."""
    return ops.clip(4.0 * (strain / FELT**2 - 1.0), 0.0, 1.0)
