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

from jaxmpc.law.belief import decide
from jaxmpc.law.credit import push
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar
from jaxmpc.law.stiffness import FORCE_FLOOR, UNHEARD, Alarm, Pair, StiffnessEstimate, StiffnessIdentification

TIP_FLOOR, LEAD_FLOOR = 1e-18, 1e-15
"""As `FORCE_FLOOR`, of the tip's movement [m²] and of their product [N m]."""
BURST, UPSET_MEMORY, STRAIN_MEMORY = 0.03, 0.1, 1.0
"""Memory of a burst of noise, of the force's error, and of the longer one of it [s]."""
FORGIVING = 20.0
"""By how much faster the watch forgets its noise after a push that took the control from the schedule [-]."""


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
    anywhere: Alarm,
    ops: Ops,
) -> StiffnessEstimate:
    """Advance by one sample.

    Args:
        constants: Constants.
        state: What `unknown` or the last `step` returned.
        force: Measured force on the tissue, before any filter of the law [N].
        tip: Measured displacement of the tip along the axis, from any origin [m].
        wanted: Wanted force, without the sine [N].
        backed_off: Share of the gain that a guard is taking back [-].
        anywhere: The most of any axis at the last sample: what has changed under one has changed under all.
        ops: Scalar functions.
    """
    state = _watch(constants, state, force, ops.maximum(state.strain, anywhere.strain), ops)
    state, stiffness, lead = _listen(constants, state, force, tip, ops, anywhere.wave)
    error = force - answer(constants, state) - wanted
    state = state._replace(
        upset=state.upset + constants.T_s / UPSET_MEMORY * (error * error - state.upset),
        strain=state.strain + constants.T_s / STRAIN_MEMORY * (error * error - state.strain),
    )
    return decide(constants, state, stiffness, lead, backed_off, anywhere, ops)


def _listen(
    constants: StiffnessIdentification,
    state: StiffnessEstimate,
    force: Scalar,
    tip: Scalar,
    ops: Ops,
    shared: Pair | None = None,
) -> tuple[StiffnessEstimate, Scalar, Scalar]:
    """The lock-in: what it has heard, the stiffness that this tells [N/m], and by how much the force leads [-]."""
    (cosine, sine), (turn_cosine, turn_sine) = shared or state.wave, constants.turn
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


def _watch(
    constants: StiffnessIdentification, state: StiffnessEstimate, force: Scalar, strain: Scalar, ops: Ops
) -> StiffnessEstimate:
    """The watch: a fading-memory filter of second order, and the power of what it has not predicted."""
    T_s, (of_value, of_rate, of_curve) = constants.T_s, constants.prediction
    value, rate, curve = state.predicted
    error = force - value
    forgiving = FORGIVING * (1.0 - state.authority) * push(strain, ops)
    watching = ops.minimum(constants.watching * (1.0 + forgiving), 0.5)
    value, rate, curve = value + of_value * error, rate + of_rate * error, curve + of_curve * error
    return state._replace(
        predicted=(value + T_s * rate + 0.5 * T_s * T_s * curve, rate + T_s * curve, curve),
        noise=state.noise + watching * (error * error - state.noise),
        burst=state.burst + T_s / BURST * (error * error - state.burst),
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
