r"""Where in its beat the heart is, from how the tip moves.

A tip that holds its force moves as the heart does. Its displacement, less what is slow, is y, and drives one complex
pole that turns with the believed rate ω,

    x ← (1 − s) e^(jωT_s) x + s y,   s = ω T_s/(2π c)                                          a resonator of c cycles

Where y leads or lags it, the rate is wrong by as much as the angle of x turns:

    ω ← ω + f s · Im(x* y) s/(T_s |x|²)                                                      frequency-locked loop

Of a heart's displacement the beat itself is the largest part, whatever its harmonics are; of its velocity it need not
be. Where the heart misses beats x goes through zero and its angle jumps, so the phase is not that angle: it goes on at
the rate, and follows the angle slowly.

    φ ← φ + ω T_s + p T_s sin(arg x − φ)
"""

from typing import Annotated, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Constant, Scalar

PI = 3.141592653589793
Pair = tuple[Scalar, Scalar]
FLOOR = 2.5e-9
"""|x|² at which half of a displacement is believed to be the heart's [m²]: 50 µm, a thirtieth of a beat."""
STRAY = 3.0
"""By how much the rate is believed to be wrong in one sample at most [rad/s]."""


class PulseFinder(NamedTuple):
    """Constants; each may be a batch."""

    T_s: Annotated[Scalar, Constant(low=1e-5, below=0.2)]
    """Sampling time [s]."""
    slow: Annotated[Scalar, Constant(low=0.0, below=1.0)]
    """Share of each of two high-passes of the displacement that is new in a sample [-]."""
    cycles: Annotated[Scalar, Constant(low=0.1, below=100.0)]
    """c, memory of the resonator [cycles]."""
    following: Annotated[Scalar, Constant(low=0.0, below=100.0)]
    """f, how fast the rate follows, over how fast the resonator does [-]."""
    pulling: Annotated[Scalar, Constant(low=0.0, below=100.0)]
    """p, how fast the phase follows [1/s]."""
    first: Annotated[Scalar, Constant(low=0.1, below=100.0)]
    """Rate that is believed before anything is heard [rad/s]."""
    least: Annotated[Scalar, Constant(low=0.1, below=100.0)]
    """Lowest rate of a heart [rad/s]."""
    most: Annotated[Scalar, Constant(low=0.1, below=100.0)]
    """Highest [rad/s]."""


class Pulse(NamedTuple):
    """What is known of the heart's beat, and all that this is gathered from."""

    rate: Scalar
    """ω [rad/s]."""
    phase: Pair
    """Cosine and sine of φ [-], from an origin of no meaning."""
    turning: Pair
    """x, real and imaginary part [m]."""
    passed: Pair
    """What the high-passes remember [m]."""


def init(constants: PulseFinder, like: Scalar) -> Pulse:
    """Nothing is heard: contact has just been made; in the form of a finite number."""
    zero = 0.0 * like
    return Pulse(constants.first + zero, (1.0 + zero, zero), (zero, zero), (zero, zero))


def step(constants: PulseFinder, state: Pulse, speed: Scalar, ops: Ops) -> tuple[Pulse, Scalar]:
    """Advance by one sample.

    Args:
        constants: Constants.
        state: What `init` or the last `step` returned.
        speed: Of the tip, along the axis in which the heart moves most [m/s].
        ops: Scalar functions.

    Returns:
        What is known now, and how much of it is the heart, 0 to 1 [-].
    """
    T_s, (once, twice), (real, imaginary) = constants.T_s, state.passed, state.turning
    once = (1.0 - constants.slow) * once + T_s * speed
    twice = twice + constants.slow * (once - twice)
    y, angle = once - twice, state.rate * T_s
    share = angle / (2.0 * PI * constants.cycles)
    real, imaginary = _turned((real, imaginary), angle)
    real, imaginary = real + share * (y - real), imaginary - share * imaginary
    power = real * real + imaginary * imaginary + FLOOR
    stray = ops.clip(-imaginary * y * share / (T_s * power), -STRAY, STRAY)
    rate = ops.clip(state.rate + constants.following * share * stray, constants.least, constants.most)
    cosine, sine = state.phase
    lead = (imaginary * cosine - real * sine) / ops.sqrt(power)
    cosine, sine = _turned((cosine, sine), angle + constants.pulling * T_s * lead)
    # Renormalised, since a rotation of floats would shrink or grow over hours.
    length = 1.5 - 0.5 * (cosine * cosine + sine * sine)
    return Pulse(rate, (length * cosine, length * sine), (real, imaginary), (once, twice)), 1.0 - FLOOR / power


def _turned(pair: Pair, angle: Scalar) -> Pair:
    """Turned by a small angle; its size stays, but for the fourth power of that."""
    (real, imaginary), cosine = pair, 1.0 - 0.5 * angle * angle
    return real * cosine - imaginary * angle, imaginary * cosine + real * angle
