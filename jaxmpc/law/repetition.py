r"""What every beat of the heart repeats is learned, and taken out before it comes: adaptive feedforward cancellation.

With e the error of the force on one axis behind two low-passes, u = e^{jφ} the phase of the beat (`pulse`) and its
harmonics n = 1…N (after Bodson and Douglas, Automatica 33, 1997),

    c_n ← c_n − g_n h_n ω e₁ (uⁿ)*,   r = h Re Σ h_n c_n wⁿ,   w = u e^{jωd}

and r is added to the wanted force; h_n fades harmonics that are too fast. The lead d is what low-passes and loop take
to answer, so that in e, when the beat has come to where r was meant for, h ρ of it is seen, ρ = Re Σ h_n c_n uⁿ. Hence
what the error would be with nothing of what is learned, e₀ = e − h ρ, and with all of it, e₁ = e₀ + ρ; and h is what
it earns:

    h = clip(a (1 − ⟨e₁²⟩/⟨e₀²⟩), 0, 1),   and less where the error is too large for a beat like those before

At a rate that stays, each harmonic is a resonator: what repeats is gone in a few beats. Of what does not repeat, as
where atria fibrillate, h leaves nothing learned. The low-passes keep the resonators' skirts from where the loop has its
least margin. It is known how the loop answers only as far as the stiffness of the tissue is, so what is learned counts,
and is learned, to the share of the schedule's authority.
"""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.pulse import Pair, Pulse, PulseFinder
from jaxmpc.law.scalar import Constant, Scalar

LOUDEST = 0.1
"""Largest error from which one sample learns [N]: an early beat teaches little of the next."""
UNUSUAL = 0.3
"""Error from which on what is learned is used less, and from twice of which on not at all [N]: an early beat is unlike
those before. With all of it in use such a beat could end in a third more force."""
LARGEST = 1.0
"""Largest force that is added [N]."""
PROVEN = 2.0
"""a, inverse of the share of the error's power that what is learned must take away to be used whole [-]."""
UNHEARD = 1e-12
"""Power far below the sensor's noise, with which quotients and their slopes stay finite [N²]."""
FADING = 12.0
"""Below the highest frequency that is learned, over which harmonics fade [rad/s]."""


class Repetition(NamedTuple):
    """Constants; each may be a batch."""

    finder: PulseFinder
    """How the heart's beat is followed."""
    gains: Annotated[Any, Constant((None,))]
    """g_n, what of each harmonic is learned in a radian of the beat [s], shape (N,)."""
    smoothing: Annotated[Scalar, Constant(low=0.0, below=1.0)]
    """Share of each low-pass of the error that is new in a sample [-]."""
    judging: Annotated[Scalar, Constant(low=0.0, below=1.0)]
    """What is forgotten of the mean squares of the error in a radian of the beat, times a sample [s]."""
    highest: Annotated[Scalar, Constant(low=1.0, below=1e3)]
    """Highest frequency of a harmonic that is learned [rad/s]."""
    lead: Annotated[Scalar, Constant(low=0.0, below=0.1)]
    """d [s]."""


class Learned(NamedTuple):
    """What is remembered of one axis."""

    error: Pair
    """Error of the force, behind one low-pass and behind two [N]."""
    parts: tuple[Pair, ...]
    """c_n, real and imaginary part [N]."""
    power: Pair
    """⟨e₁²⟩ and ⟨e₀²⟩ [N²]."""
    used: Scalar
    """h times the authority [-]."""


class Beat(NamedTuple):
    """The heart's beat at one sample, for all axes: harmonics, each to the share to which it is learned and used."""

    rate: Scalar
    """ω [rad/s]."""
    now: Sequence[Pair]
    """h_n uⁿ"""
    ahead: Sequence[Pair]
    """h_n wⁿ"""
    teaching: Sequence[Pair]
    """g_n h_n ω uⁿ"""


def nothing(constants: Repetition, like: Scalar) -> Learned:
    """Nothing is learned; in the form of a finite number."""
    zero = 0.0 * like
    none = zero, zero
    return Learned(none, tuple(none for _ in range(len(constants.gains))), none, zero)


def beat_of(constants: Repetition, known: Pulse, ops: Ops) -> Beat:
    """The beat from what is known of it."""
    count, (cosine, sine), angle = len(constants.gains), known.phase, known.rate * constants.lead
    lead_cosine, lead_sine = ops.cos(angle), ops.sin(angle)
    ahead = cosine * lead_cosine - sine * lead_sine, sine * lead_cosine + cosine * lead_sine
    shares = [share(constants, (n + 1.0) * known.rate, ops) for n in range(count)]
    now = _scaled(shares, _powers(known.phase, count))
    teaching = _scaled([gain * known.rate for gain in constants.gains], now)
    return Beat(known.rate, now, _scaled(shares, _powers(ahead, count)), teaching)


def share(constants: Repetition, frequency: Scalar, ops: Ops) -> Scalar:
    """How far a harmonic of this frequency [rad/s] is learned [-]."""
    return ops.clip((constants.highest - frequency) / FADING, 0.0, 1.0)


def step(
    constants: Repetition, learned: Learned, beat: Beat, error: Scalar, authority: Scalar, ops: Ops
) -> tuple[Learned, Scalar]:
    """Advance one axis by one sample.

    Args:
        constants: Constants.
        learned: What `nothing` or the last `step` returned.
        beat: Where the heart is in its beat.
        error: Measured less wanted force [N].
        authority: Share of the control that the schedule has, times how surely the beat is the heart's [-].
        ops: Scalar functions.

    Returns:
        What is learned, and what is added to the wanted force [N].
    """
    once, twice = learned.error
    once = once + constants.smoothing * (error - once)
    twice = twice + constants.smoothing * (once - twice)
    seen = _sum(learned.parts, beat.now)
    without = twice - learned.used * seen
    whole = without + seen
    (of_whole, of_without), new = learned.power, constants.judging * beat.rate
    of_whole, of_without = (
        of_whole + new * (whole * whole - of_whole),
        of_without + new * (without * without - of_without),
    )
    told = authority * ops.clip(whole, -LOUDEST, LOUDEST)
    parts = tuple(
        (real - told * cosine, imaginary + told * sine)
        for (real, imaginary), (cosine, sine) in zip(learned.parts, beat.teaching, strict=True)
    )
    usual = ops.clip(2.0 - abs(error) / UNUSUAL, 0.0, 1.0)
    used = authority * usual * ops.clip(PROVEN * (1.0 - of_whole / (of_without + UNHEARD)), 0.0, 1.0)
    added = used * ops.clip(_sum(parts, beat.ahead), -LARGEST, LARGEST)
    return Learned((once, twice), parts, (of_whole, of_without), used), added


def _sum(parts: Sequence[Pair], turned: Sequence[Pair]) -> Scalar:
    """Re Σ c_n zₙ [N]."""
    total: Scalar = 0.0
    for (real, imaginary), (cosine, sine) in zip(parts, turned, strict=True):
        total = total + real * cosine - imaginary * sine
    return total


def _scaled(sizes: Sequence[Scalar], turned: Sequence[Pair]) -> list[Pair]:
    """Each of some complex numbers times a real one."""
    return [(size * cosine, size * sine) for size, (cosine, sine) in zip(sizes, turned, strict=True)]


def _powers(phase: Pair, count: int) -> list[Pair]:
    """Powers 1…count of a complex number."""
    (cosine, sine), found = phase, [phase]
    for _ in range(count - 1):
        real, imaginary = found[-1]
        found.append((real * cosine - imaginary * sine, imaginary * cosine + real * sine))
    return found
