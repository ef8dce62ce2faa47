"""Decides from what has been heard of the tissue: which stiffness is believed, who controls, whether to listen on.

The schedule has the control to the share of its authority, which rises where the stiffness is surely known, comes back
after a push (`credit`), and falls where doubt is large. Doubt comes from a loop that rings or bursts, from the force's
error where it is large or never calm, and from a guard that takes back gain. The sine sounds until the stiffness is
known, and again from a doubt on, within the time that it may.

With the noise ν over a second and β over a burst as multiples of what is usual, the mean square of the error u² [N²],
the share of gain b that a guard has taken back, the time r without a calm [s], and a = 1 where the schedule has all of
the control, doubt is the largest of these, from 0 to 2:

    2 (ν − 1.3),   ½ (β − 2.2),   2 (u²/0.4² − 1),   5 (b − 0.1),   10 (r − 0.4 − 0.5 a)

From 0 on the sine comes back, and from ½ on the authority goes.
"""

from jaxmpc.law import credit
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar
from jaxmpc.law.stiffness import FORCE_FLOOR, Alarm, StiffnessEstimate, StiffnessIdentification

ELASTIC, VISCOUS = 0.05, 0.09
"""Lead of the force up to which the schedule may have all of the control, and from which on none [-]. The sensor's
low-pass lets the force of a spring lag by 0.03; Hunt and Crossley's tissue, 0.5 s/m, leads by 0.1 to 0.5."""
FOLLOWING, RISING, FALLING, HEARING = 6.0, 2.0, 150.0, 2.0
"""Rates: of ln K̂ towards K per miss, of the authority up and down, of the sine [1/s]."""
ENOUGH, REST, AGAIN = 12.0, 60.0, 0.6
"""For how long the sine may sound without a break, the time constant with which that is forgotten [s], and to which
share it must be forgotten before the sine returns [-]: on an arm on which nothing is heard, 6 s in 40."""
DISTRUST, TRUST = 150.0, 150.0
"""Rate at which the schedule is trusted less while a guard takes back gain that it has [1/s], to some 0.3 until the
authority is gone, and the time constant with which trust returns [s]."""
LEARNING, FORGETTING = 0.5, 0.02
"""Rates at which what is usual is learned when the sine has gone off, and ever after [1/s]."""
UPSET = 0.4
"""RMS of the force's error from which on the authority goes whatever the cause [N]: rhythms but for premature beats
leave it below with the gains for the tissue."""
CALM, PATIENCE, CALMING = 0.07, 1.0, 0.05
"""RMS of the force's error below which it is calm [N], for how long it may not be while the schedule has all of the
control, and the time constant with which that is forgotten in a calm [s]. A loop whose gains are for tissue four times
as stiff swings without end; with the right gains, early beats leave no calm for 0.87 s at most, in 5760 trials."""
LOUDER, BURSTING, INAUDIBLE = 1.3, 2.2, 1e-6
"""From which multiple of what is usual on the noise, and a burst of it, tell of a loop that rings [-], with what is
added to all of them [N²]. Measured on Table I's motion: 1.0 ± 0.06 and at most 1.9; 1.1 on tissue 1.6 times as stiff
as known, 1.4 where it is twice as stiff. A premature beat on tissue of 810 N/m and above reaches both, too."""


def decide(
    constants: StiffnessIdentification,
    state: StiffnessEstimate,
    stiffness: Scalar,
    lead: Scalar,
    backed_off: Scalar,
    anywhere: Alarm,
    ops: Ops,
) -> StiffnessEstimate:
    """What is believed of the stiffness, who controls, and whether to go on listening.

    Args:
        constants: Constants.
        state: What has been heard by this sample.
        stiffness: What this tells [N/m].
        lead: By how much the force leads the displacement [-].
        backed_off: Share of the gain that a guard is taking back [-].
        anywhere: The most of any axis at the last sample: what has changed under one has changed under all.
        ops: Scalar functions.
    """
    T_s, band = constants.T_s, constants.band
    known = ops.exp(state.log_stiffness)
    miss = stiffness / known - 1.0
    full = ops.clip(10.0 * (state.heard - 0.8), 0.0, 1.0)
    elastic = ops.clip((VISCOUS - lead) / (VISCOUS - ELASTIC), 0.0, 1.0)
    sure = full * elastic * ops.clip(2.0 - 2.0 * state.width / band, 0.0, 1.0)
    log_stiffness = state.log_stiffness + FOLLOWING * T_s * sure * ops.clip(miss, -0.5, 0.5)

    quietest = (state.usual + INAUDIBLE * state.learned + FORCE_FLOOR) / (state.learned + FORCE_FLOOR)
    louder = 2.0 * ((state.noise + INAUDIBLE) / quietest - LOUDER)
    bursting = 0.5 * ((state.burst + INAUDIBLE) / quietest - BURSTING)
    ringing = ops.maximum(louder, bursting)
    settled = ops.clip(50.0 * (state.authority - 0.98), 0.0, 1.0)
    judged = ops.clip(10.0 * (state.learned - 0.8), 0.0, 1.0)
    swinging = ops.clip(5.0 * (backed_off - 0.1), 0.0, 2.0)
    upset = ops.clip(2.0 * (state.upset / UPSET**2 - 1.0), 0.0, 2.0)
    # Once it has begun to take the control, it takes all of it.
    restless = ops.clip(10.0 * (state.unrest - 0.4 - 0.5 * settled), 0.0, 2.0)
    ringing_or_upset = ops.maximum(ops.clip(judged * ringing, 0.0, 2.0), upset)
    doubt = ops.maximum(ops.maximum(ringing_or_upset, swinging), restless)
    calm = ops.clip(-ringing, 0.0, 1.0)
    quiet = settled * (1.0 - state.listening)
    learning = T_s * quiet * (LEARNING * (1.0 - judged) + FORGETTING * calm)

    arrived = ops.clip(2.0 - 20.0 * abs(miss), 0.0, 1.0)
    large = ops.clip(2.0 * ops.maximum(doubt, anywhere.doubt) - 1.0, 0.0, 1.0)
    strain = ops.maximum(state.strain, anywhere.strain)
    pardoned = credit.pardon(state, strain, ops)
    rising = ops.maximum(RISING * sure * arrived, credit.RETURNING * pardoned * (1.0 - large))
    authority = state.authority + T_s * (rising - FALLING * large)
    # Once it is more than half on again, the sine grows, and stays, until the stiffness has been heard.
    begun = ops.clip(10.0 * state.listening - 5.0, 0.0, 1.0) * ops.clip(8.5 - 10.0 * state.heard, 0.0, 1.0)
    unsettled = ops.clip(ops.maximum(ops.maximum(1.0 - settled, 10.0 * doubt), begun), 0.0, 1.0)
    # A schedule that comes back by itself needs no sine.
    unsettled = unsettled * (1.0 - pardoned * (1.0 - settled))
    done = ops.maximum(sure * arrived, ops.clip(6.0 - 10.0 * state.listening, 0.0, 1.0))
    # What has begun goes on until the time is used up, and what has ended waits: in between nothing is stable.
    limit = AGAIN + (1.0 - AGAIN) * state.listening
    allowed = ops.clip(10.0 * (limit - state.spent), 0.0, 1.0) * ops.clip(4.0 * state.trust - 2.0, 0.0, 1.0)
    sounding = unsettled * allowed - ops.maximum((1.0 - unsettled) * done, 1.0 - allowed)
    listening = state.listening + HEARING * T_s * sounding
    trust = state.trust + T_s * ((1.0 - state.trust) / TRUST - DISTRUST * state.authority * state.trust * swinging)
    stirred = settled * ops.clip(2.0 * (state.upset / CALM**2 - 1.0), 0.0, 1.0)
    state = credit.step(state, T_s, sure * arrived, settled, large, strain, ops)
    return state._replace(
        log_stiffness=ops.clip(log_stiffness, constants.least, constants.most),
        authority=ops.clip(authority, 0.0, state.trust),
        listening=ops.clip(listening, 0.0, 1.0),
        doubt=doubt,
        # More than any beat's, 1.3 times HEAVY's square: no axis is pardoned then, and all hear the tissue.
        strain=ops.maximum(state.strain, 0.65 * credit.HEAVY**2 * restless),
        unrest=state.unrest + T_s * (stirred / PATIENCE - (1.0 - stirred) * state.unrest / CALMING),
        usual=state.usual + learning * (state.noise - state.usual),
        learned=state.learned + learning * (1.0 - state.learned),
        spent=state.spent + T_s * (state.listening / ENOUGH - state.spent / REST),
        trust=ops.clip(trust, 0.0, 1.0),
    )
