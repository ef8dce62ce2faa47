"""What is known of the tissue's stiffness under one axis: constants of its identification, and its state."""

from typing import Annotated, NamedTuple

from jaxmpc.law.scalar import Constant, Scalar

Pair = tuple[Scalar, Scalar]
Triple = tuple[Scalar, Scalar, Scalar]
FORCE_FLOOR = 1e-12
"""Power far below what can be heard [N²]: quotients stay finite, and so do their slopes, in float32 too."""
UNHEARD = 10.0
"""Width before anything is heard [-]."""
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
    """The same over a few samples alone [N²]."""
    upset: Scalar
    """Mean square of the force's error [N²]."""
    strain: Scalar
    """The same over a longer time; more than any beat's where the error is never calm [N²]."""
    unrest: Scalar
    """For how long the error has not been calm, of the time after which the loop is taken to swing [-]."""
    usual: Scalar
    """What of ⟨ε²⟩ has been learned to be usual [N²]: so much for `learned`, which is how much of it has been."""
    learned: Scalar
    """[-]"""
    spent: Scalar
    """How much of the time that the sine may sound is used up [-]."""
    trust: Scalar
    """Largest authority that the schedule may have, which falls where a guard took back gain that it had [-]."""
    credit: Scalar
    """How far the schedule may take back a control that doubt has taken, without hearing the tissue again [-]."""
    proven: Scalar
    """How surely the schedule has had all of the control for a while [-]."""


class Alarm(NamedTuple):
    """What the axes tell each other."""

    doubt: Scalar
    """How surely the tissue has changed [-]."""
    strain: Scalar
    """Mean square of the force's error over a longer time [N²]."""
    wave: Pair | None = None
    """Cosine and sine of the angle φ, which is the same for all, so that it is turned once [-]; None where each has its
    own."""


SILENT = Alarm(0.0, 0.0)
"""An axis that knows of no others hears this."""


def unknown(constants: StiffnessIdentification, force: Scalar) -> StiffnessEstimate:
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
        strain=zero,
        unrest=zero,
        usual=zero,
        learned=zero,
        spent=zero,
        trust=1.0 + zero,
        credit=zero,
        proven=zero,
    )
