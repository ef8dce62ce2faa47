r"""Finds the stiffness of the tissue under one axis while it is controlled, and says how well it is known.

A sine is added to the wanted force, above the band of any heart. With the differences Δ of the measured force and of
the tip's displacement from sample to sample, mixed down with the sine's angle φ and passed by three low-passes P,

    Y = P³ [Δy e^(−iφ)],   X = P³ [Δx e^(−iφ)],   K = Re(Y X*)/|X|²                             lock-in

needs neither inertia nor loop gain. What the second low-pass still passes besides the sine, n = (P² − P³)[Δy − K Δx],
has a third of the power of what is left in Y − K X where the rest is white, so that K is known to

    w = c √(1.5 ⟨|n|²⟩) / |Y|                                                                   relative width

A tissue whose force leads the displacement, by Im(Y X*)/Re(Y X*), is not the spring that the gains are for: its
damping adds to the loop's gain, the more the higher the frequency. There the fixed gains hold.

The lock-in takes seconds, and the sine is not to sound for ever. Whether the tissue has become stiffer since is heard
without it: a fading-memory filter predicts the force from its past, and what it cannot predict,

    ⟨ε²⟩, over a second and over a few samples                                                  watch

is the sensor's noise, which no heart and no tissue changes, until a loop with too much gain begins to ring. Softer
tissue leaves a loop with too little gain, which is heard late, by the force's error alone. A change brings the sine
back; a large one also takes the authority from the schedule, so that the fixed gains hold until the stiffness is known
again.
"""

from typing import Annotated, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Constant, Scalar

Pair = tuple[Scalar, Scalar]
Triple = tuple[Scalar, Scalar, Scalar]
FORCE_FLOOR, TIP_FLOOR = 1e-12, 1e-18
"""Powers far below what can be heard [N²], [m²]: quotients stay finite, and so do their slopes, in float32 too."""
LEAD_FLOOR = 1e-15
"""The same of their product [N m]."""
_SHARE = Constant(low=0.0, below=1.0)
_PAIR = Constant((2,))
_TRIPLE = Constant((3,))


class StiffnessIdentification(NamedTuple):
    """Constants; each may be a batch."""

    T_s: Annotated[Scalar, Constant(low=1e-5, below=0.2)]
    """Sampling time [s]."""
    amplitude: Annotated[Scalar, Constant(low=0.0, below=2.0)]
    """Amplitude of the sine that is added to the wanted force [N]."""
    turn: Annotated[Pair, _PAIR]
    """Cosine and sine of what the sine's angle gains in a sample [-], shape (2,)."""
    mixing: Annotated[Scalar, _SHARE]
    """Share of each low-pass of the lock-in that is new in a sample [-]."""
    averaging: Annotated[Scalar, _SHARE]
    """The same of the mean of what it passes besides the sine [-]."""
    confidence: Annotated[Scalar, Constant(low=0.0)]
    """c, half width of the interval over its standard deviation [-]."""
    band: Annotated[Scalar, Constant(low=1e-3, below=1.0)]
    """Largest relative half width that counts as known [-]."""
    least: Annotated[Scalar, Constant(low=0.0)]
    """Smallest ln K̂ [-]."""
    most: Annotated[Scalar, Constant(low=0.0)]
    """Largest ln K̂ [-]."""
    prediction: Annotated[Triple, _TRIPLE]
    """Gains of the watch's filters: force [-], its rate [1/s], its second derivative [1/s²], shape (3,)."""
    watching: Annotated[Scalar, _SHARE]
    """Share of the watch's means that is new in a sample [-]."""


class StiffnessEstimate(NamedTuple):
    """What is known of the tissue under one axis, and all that this is gathered from."""

    log_stiffness: Scalar
    """ln K̂, K̂ in N/m."""
    authority: Scalar
    """w, from 0, where nothing is known, to 1, where the schedule has all of the control [-]."""
    listening: Scalar
    """Share of the sine's amplitude that is on [-]."""
    width: Scalar
    """Relative half width of the interval of K [-]; large where nothing is heard."""
    doubt: Scalar
    """How surely the tissue has changed [-]: the sine comes back from 0 on, and above 0.5 the authority goes."""
    wave: Pair
    """Cosine and sine of the angle φ [-]."""
    last: Pair
    """Measured force [N] and displacement of the tip [m] at the last sample."""
    force: tuple[Pair, Pair, Pair]
    """Δy mixed down, after one, two and three low-passes [N]."""
    tip: tuple[Pair, Pair, Pair]
    """Δx likewise [m]."""
    rest: Scalar
    """⟨|n|²⟩ [N²]."""
    heard: Scalar
    """How much of the averaging's memory is filled [-]."""
    predicted: Triple
    """Force [N], rate [N/s] and second derivative [N/s²] as predicted from the measured forces."""
    noise: Scalar
    """⟨ε²⟩ [N²]."""
    burst: Scalar
    """The same over `BURST` alone [N²]."""
    upset: Scalar
    """Mean square of the force's error [N²]."""
    usual: Scalar
    """What of ⟨ε²⟩ has been learned to be usual [N²]: so much for `learned`, which is how much of it has been."""
    learned: Scalar
    """[-]"""
    spent: Scalar
    """How much of the time that the sine may sound is used up [-]."""
    trust: Scalar
    """Largest authority that the schedule may have, which falls where a guard took back gain that it had [-]."""


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
UPSET, UPSET_MEMORY = 0.4, 0.1
"""RMS of the force's error, and its memory [s], from which on the authority goes whatever the cause [N]: rhythms but
for premature beats leave it below with the gains for the tissue."""
BURST = 0.03
"""Memory of a burst [s]."""
LOUDER, BURSTING, INAUDIBLE = 1.3, 2.2, 1e-6
"""From which multiple of what is usual on the noise, and a burst of it, tell of a loop that rings [-], with what is
added to all of them [N²]. Measured on Table I's motion: 1.0 ± 0.06 and at most 1.9; 1.1 on tissue 1.6 times as stiff
as known, 1.4 where it is twice as stiff. A premature beat on tissue of 810 N/m and above reaches both, too."""
UNHEARD = 10.0
"""Width before anything is heard [-]."""


def init(constants: StiffnessIdentification, force: Scalar) -> StiffnessEstimate:
    """Nothing is known: contact has just been made, with a measured force [N]."""
    zero = 0.0 * force
    none = zero, zero
    middle = 0.5 * (constants.least + constants.most) + zero
    return StiffnessEstimate(
        log_stiffness=middle,
        authority=zero,
        listening=zero,
        width=zero + UNHEARD,
        doubt=zero,
        wave=(1.0 + zero, zero),
        last=(force, zero),
        force=(none, none, none),
        tip=(none, none, none),
        rest=zero,
        heard=zero,
        predicted=(force, zero, zero),
        noise=zero,
        burst=zero,
        upset=zero,
        usual=zero,
        learned=zero,
        spent=zero,
        trust=1.0 + zero,
    )


def dither(constants: StiffnessIdentification, state: StiffnessEstimate) -> Scalar:
    """What is added to the wanted force at this sample [N]."""
    return constants.amplitude * state.listening * state.wave[1]


def answer(constants: StiffnessIdentification, state: StiffnessEstimate) -> Scalar:
    """What of the measured force is the loop's answer to the sine [N]."""
    turn_cosine, turn_sine = constants.turn
    (cosine, sine), (real, imaginary) = state.wave, state.force[-1]
    # Δy = y (1 − e^(−iωT_s)), undone; both halves of the spectrum.
    less = 1.0 - turn_cosine
    y_real = real + turn_sine / less * imaginary
    y_imaginary = imaginary - turn_sine / less * real
    return y_real * cosine - y_imaginary * sine


def step(
    constants: StiffnessIdentification,
    state: StiffnessEstimate,
    force: Scalar,
    tip: Scalar,
    wanted: Scalar,
    backed_off: Scalar,
    elsewhere: Scalar,
    ops: Ops,
) -> StiffnessEstimate:
    """Advance by one sample.

    Args:
        constants: Constants.
        state: What `init` or the last `step` returned.
        force: Measured force on the tissue, before any filter of the law [N].
        tip: Measured displacement of the tip along the axis, from any origin [m].
        wanted: Wanted force, without the sine [N].
        backed_off: Share of the gain that a guard is taking back [-].
        elsewhere: Largest doubt of any axis at the last sample: what has changed under one has changed under all [-].
        ops: Scalar functions.
    """
    state = _watch(constants, state, force)
    state, stiffness, lead = _listen(constants, state, force, tip, ops)
    error = force - answer(constants, state) - wanted
    state = state._replace(upset=state.upset + constants.T_s / UPSET_MEMORY * (error * error - state.upset))
    return _decide(constants, state, stiffness, lead, backed_off, elsewhere, ops)


def _listen(
    constants: StiffnessIdentification, state: StiffnessEstimate, force: Scalar, tip: Scalar, ops: Ops
) -> tuple[StiffnessEstimate, Scalar, Scalar]:
    """The lock-in: what it has heard, the stiffness that this tells [N/m], and by how much the force leads [-]."""
    (cosine, sine), (turn_cosine, turn_sine) = state.wave, constants.turn
    wave = turn_cosine * cosine - turn_sine * sine, turn_sine * cosine + turn_cosine * sine
    on = ops.clip(1e3 * state.listening, 0.0, 1.0)
    heard_force = _mixed(constants.mixing, state.force, on * (force - state.last[0]), wave)
    heard_tip = _mixed(constants.mixing, state.tip, on * (tip - state.last[1]), wave)
    (_, Y2, Y), (_, X2, X) = heard_force, heard_tip
    in_phase, ahead = Y[0] * X[0] + Y[1] * X[1], Y[1] * X[0] - Y[0] * X[1]
    stiffness = in_phase / (_power(X) + TIP_FLOOR)
    besides = tuple(y2 - y - stiffness * (x2 - x) for y2, y, x2, x in zip(Y2, Y, X2, X, strict=True))
    rest = state.rest + constants.averaging * (_power(besides) - state.rest)
    heard = state.heard + constants.averaging * (state.listening - state.heard)
    # Renormalised, since a rotation of floats would shrink or grow over hours.
    length = 1.5 - 0.5 * _power(wave)
    ratio = 1.5 * (rest + FORCE_FLOOR) / (heard * _power(Y) + FORCE_FLOOR)
    state = state._replace(
        wave=(length * wave[0], length * wave[1]),
        last=(force, tip),
        force=heard_force,
        tip=heard_tip,
        rest=rest,
        heard=heard,
        width=ops.minimum(constants.confidence * ops.sqrt(ratio), UNHEARD),
    )
    return state, stiffness, ahead / (abs(in_phase) + LEAD_FLOOR)


def _watch(constants: StiffnessIdentification, state: StiffnessEstimate, force: Scalar) -> StiffnessEstimate:
    """The watch: a fading-memory filter of second order, and the power of what it has not predicted."""
    T_s, (of_value, of_rate, of_curve) = constants.T_s, constants.prediction
    value, rate, curve = state.predicted
    error = force - value
    value, rate, curve = value + of_value * error, rate + of_rate * error, curve + of_curve * error
    return state._replace(
        predicted=(value + T_s * rate + 0.5 * T_s * T_s * curve, rate + T_s * curve, curve),
        noise=state.noise + constants.watching * (error * error - state.noise),
        burst=state.burst + T_s / BURST * (error * error - state.burst),
    )


def _decide(
    constants: StiffnessIdentification,
    state: StiffnessEstimate,
    stiffness: Scalar,
    lead: Scalar,
    backed_off: Scalar,
    elsewhere: Scalar,
    ops: Ops,
) -> StiffnessEstimate:
    """What is believed of the stiffness, who controls, and whether to go on listening."""
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
    doubt = ops.maximum(ops.maximum(judged * ops.clip(ringing, 0.0, 2.0), upset), swinging)
    calm = ops.clip(-ringing, 0.0, 1.0)
    quiet = settled * (1.0 - state.listening)
    learning = T_s * quiet * (LEARNING * (1.0 - judged) + FORGETTING * calm)

    arrived = ops.clip(2.0 - 20.0 * abs(miss), 0.0, 1.0)
    large = ops.clip(2.0 * ops.maximum(doubt, elsewhere) - 1.0, 0.0, 1.0)
    authority = state.authority + T_s * (RISING * sure * arrived - FALLING * large)
    # Once it is more than half on again, the sine grows, and stays, until the stiffness has been heard.
    begun = ops.clip(10.0 * state.listening - 5.0, 0.0, 1.0) * ops.clip(8.5 - 10.0 * state.heard, 0.0, 1.0)
    unsettled = ops.clip(ops.maximum(ops.maximum(1.0 - settled, 10.0 * doubt), begun), 0.0, 1.0)
    done = ops.maximum(sure * arrived, ops.clip(6.0 - 10.0 * state.listening, 0.0, 1.0))
    # What has begun goes on until the time is used up, and what has ended waits: in between nothing is stable.
    limit = AGAIN + (1.0 - AGAIN) * state.listening
    allowed = ops.clip(10.0 * (limit - state.spent), 0.0, 1.0) * ops.clip(4.0 * state.trust - 2.0, 0.0, 1.0)
    sounding = unsettled * allowed - ops.maximum((1.0 - unsettled) * done, 1.0 - allowed)
    listening = state.listening + HEARING * T_s * sounding
    trust = state.trust + T_s * ((1.0 - state.trust) / TRUST - DISTRUST * state.authority * state.trust * swinging)
    return state._replace(
        log_stiffness=ops.clip(log_stiffness, constants.least, constants.most),
        authority=ops.clip(authority, 0.0, state.trust),
        listening=ops.clip(listening, 0.0, 1.0),
        doubt=doubt,
        usual=state.usual + learning * (state.noise - state.usual),
        learned=state.learned + learning * (1.0 - state.learned),
        spent=state.spent + T_s * (state.listening / ENOUGH - state.spent / REST),
        trust=ops.clip(trust, 0.0, 1.0),
    )


def _mixed(new: Scalar, passed: tuple[Pair, ...], change: Scalar, wave: Pair) -> tuple[Pair, Pair, Pair]:
    """Three low-passes of what is mixed down with the wave."""
    value, following = (change * wave[0], -change * wave[1]), []
    for real, imaginary in passed:
        value = real + new * (value[0] - real), imaginary + new * (value[1] - imaginary)
        following.append(value)
    once, twice, thrice = following
    return once, twice, thrice


def _power(pair: tuple[Scalar, ...]) -> Scalar:
    return pair[0] * pair[0] + pair[1] * pair[1]
