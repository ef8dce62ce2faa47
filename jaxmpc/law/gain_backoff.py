r"""Takes the loop's gain back while it swings or asks for more than the joints give, and remembers where that began.

What swings at 20 Hz and above is the loop's own doing: a cable, or a tissue it was not designed for. With the force
error ε = y − F_d, its fourth-order high-pass h, its second-order low-pass l, and their mean squares over the axes,

    s²ₖ = s²ₖ₋₁ + α (Σ hₖ² − s²ₖ₋₁),  ℓ² likewise of l, and d² of a sine that listens to the tissue and its answer

a swing is *large* by e, at once, or *lasting* by f, when its share w has been high for half a second,

    e = (s²/(S² + ℓ² + d²))⁴,   wₖ = wₖ₋₁ + η (s²/(N² + s² + ℓ²/300 + d²/10) − wₖ₋₁),   f = (w/W)¹⁶

and the torques are *overloaded* by o while the limits hold back much of the commands, Δv = v_applied − v. A loop that
is quick while torques are held, or change as fast as they may, swings by that alone, the larger the more slowly: at a
few hertz no filter tells it from a heart, and no linear margin knows of it.

    oₖ = oₖ₋₁ + α (Σ Δvₖ²/(A² + Σ Δvₖ²) − oₖ₋₁),   p = (2 o)⁴
    1 − φ = (1 − r e/(1 + e)) (1 − r p/(1 + p)) (1 − r′ f/(1 + f))

While any of it lasts the gain g falls. Where it stood lately, m, is where that began, and a ceiling c falls below that;
the gain returns no further than to the ceiling, which rises so slowly that it probes once in a minute or more:

    mₖ = mₖ₋₁ + μ (gₖ₋₁ − mₖ₋₁)
    cₖ = cₖ₋₁ + φ min(0, g_min + ρ (mₖ − g_min) − cₖ₋₁) + γ cₖ₋₁ (1 − cₖ₋₁)
    gₖ = g_min + (1 − φ) (gₖ₋₁ + β (cₖ − gₖ₋₁) − g_min)

The cascades then run with `gains.backed_off`, which moves no state: nothing jumps. The damping K₂ is whole from a gain
g_D on, and gone at the least one:

    K₂ clip((g − g_min)/(g_D − g_min), 0, 1)

While torques change as fast as they may, the damping alone swings on an arm with soft cables, at 38 to 49 Hz, however
little the cascades do. A heart's own residual, sensor noise and a single beat are neither large nor lasting: there g is
1 and the loop keeps its margins. An event that the guard took for a swing costs a ceiling below 1 that is back within
minutes.
"""

from typing import Annotated, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Constant, Scalar, Vector, dot, sub

CORNER = 100.0
"""Corner of every stage of the filters, 16 Hz [rad/s]: beyond a heart's motion, whose rate may double, and below the
swings of 20–70 Hz that arms with cables of 15–60 Hz have."""
MEMORY = 0.02
"""Time constant of the mean squares [s]."""
LIMIT = 0.2
"""S, root mean square of h about no slow error at which the gain falls half as fast as it can [N]."""
NOTICED = 0.035
"""N, root mean square of h that makes half a share [N]: sensor noise alone has 0.015; 0.1 N has 0.05 at 25 Hz."""
PATIENCE = 0.5
"""Time constant of the share [s]."""
INSISTENT = 0.66
"""W, share at which a lasting swing makes the gain fall half as fast as it can [-]: that of h of 0.05 N."""
PACE, STEADY_PACE = 60.0, 4.0
"""Fastest relative fall of the gain while the swing is large, r/T_s, and while it lasts, r′/T_s [1/s]."""
HELD_BACK = 5.0
"""A, commands that the limits hold back, Euclidean norm over the axes, at which the torques count as half overloaded
[m/s²]: some 8 N·m of the second joint's 50."""
LATELY = 0.5
"""Time constant of the gain that is remembered [s]: longer than a fall takes, shorter than a return."""
BELOW = 0.6
"""ρ, how far below the gain at which a swing began the ceiling falls, −4.4 dB [-]."""
RETURN, PROBE = 3.0, 150.0
"""Time constants with which the gain comes back to its ceiling, and the ceiling to 1, from below slower still [s]."""
LEAST = 0.05
"""g_min [-]: below the gain at which any arm with cables of 15 Hz and above swings."""
DAMPED = 0.25
"""g_D [-]: of 480 arms with cables of 15–60 Hz none is unstable at a quarter of the gain with all of the damping, or at
0.15 with half of it; with none 22 and 7 % are there, and none at 0.05."""

_SHARE = Constant(low=0.0, below=1.0)
"""Poles and shares of a sample: below 1, so that the gain stays above its least."""
_PER_SQUARE = Constant(low=1e-9)


class GainBackoff(NamedTuple):
    """Constants; each may be a batch."""

    corner: Annotated[Scalar, _SHARE]
    """Pole of each stage of the filters [-]."""
    forgetting: Annotated[Scalar, _SHARE]
    """α [-]"""
    sensitivity: Annotated[Scalar, _PER_SQUARE]
    """1/S² [1/N²]"""
    attention: Annotated[Scalar, _PER_SQUARE]
    """1/N² [1/N²]"""
    relief: Annotated[Scalar, _PER_SQUARE]
    """1/A² [s⁴/m²]"""
    patience: Annotated[Scalar, _SHARE]
    """η [-]"""
    pace: Annotated[Scalar, _SHARE]
    """r [-]"""
    steady_pace: Annotated[Scalar, _SHARE]
    """r′ [-]"""
    remembrance: Annotated[Scalar, _SHARE]
    """μ [-]"""
    recovery: Annotated[Scalar, _SHARE]
    """β [-]"""
    probing: Annotated[Scalar, _SHARE]
    """γ [-]"""


class BackoffMemory(NamedTuple):
    """What lasts longer than the filters."""

    gain: Scalar
    """g [-]"""
    ceiling: Scalar
    """c [-]"""
    lately: Scalar
    """m [-]"""


class BackoffState(NamedTuple):
    """What is remembered between two samples."""

    memory: BackoffMemory
    stages: tuple[Vector, Vector, Vector, Vector]
    """What each stage of the high-pass has taken off, per axis [N]."""
    swing: Scalar
    """s² [N²]"""
    drift: Scalar
    """ℓ² [N²]"""
    dither: Scalar
    """d² [N²]"""
    share: Scalar
    """w [-]"""
    overload: Scalar
    """o [-]"""
    held_back: Scalar
    """ΣΔv² of the last commands, which whoever applies the limits has to tell [m²/s⁴]"""


def constants(T_s: Scalar, ops: Ops) -> GainBackoff:
    """Constants for a sampling time [s]."""
    here = 0.0 * T_s
    return GainBackoff(
        corner=ops.exp(-CORNER * T_s),
        forgetting=1.0 - ops.exp(-T_s / MEMORY),
        sensitivity=1.0 / LIMIT**2 + here,
        attention=1.0 / NOTICED**2 + here,
        relief=1.0 / HELD_BACK**2 + here,
        patience=T_s / PATIENCE,
        pace=PACE * T_s,
        steady_pace=STEADY_PACE * T_s,
        remembrance=T_s / LATELY,
        recovery=T_s / RETURN,
        probing=T_s / PROBE,
    )


def init(zero: Scalar = 0.0) -> BackoffState:
    """Full gain, no error yet; numbers in the form of `zero`."""
    one, axes = 1.0 + zero, (zero,) * 3
    return BackoffState(BackoffMemory(one, one, one), (axes, axes, axes, axes), zero, zero, zero, zero, zero, zero)


def taken(memory: BackoffMemory, ops: Ops) -> Scalar:
    """How far the gain lies below its ceiling, or below where it was lately [-]: 0 where it has come to stay."""
    return ops.maximum(memory.ceiling, memory.lately) - memory.gain


def damping(memory: BackoffMemory, ops: Ops) -> Scalar:
    """Share of the damping K₂ that is left [-]."""
    return ops.clip((memory.gain - LEAST) / (DAMPED - LEAST), 0.0, 1.0)


def step(guard: GainBackoff, state: BackoffState, error: Vector, ops: Ops, dither: Vector = ()) -> BackoffState:
    """Advance by one sample.

    Args:
        guard: Constants.
        state: What `init` or the last `step` returned.
        error: Measured force less the wanted one, 3 scalars [N].
        ops: Scalar functions.
        dither: What is added to the wanted force, and what the error was freed of as its answer: it takes a while until
            that begins, and ends, when the answer does [N].
    """
    fast, stages = error, []
    for stage in state.stages:
        slow = _passed(guard.corner, stage, fast)
        fast = sub(fast, slow)
        stages.append(slow)
    first, second, third, fourth = stages
    swing = state.swing + guard.forgetting * (_square(fast) - state.swing)
    # Two high-passes 1 − P have taken off P and P (1 − P): their difference is the low-pass P².
    drift = state.drift + guard.forgetting * (_square(sub(first, second)) - state.drift)
    heard = state.dither + guard.forgetting * (dot(dither, dither) - state.dither)
    seen = guard.attention * swing
    seen = seen / (1.0 + seen + guard.attention * (drift / 300.0 + heard / 10.0))
    share = state.share + guard.patience * (seen - state.share)

    large = guard.sensitivity * swing / (1.0 + guard.sensitivity * (drift + heard))
    # e/(1 + e) from its root's, so that no power of a force that runs away overflows.
    root = large * large / (1.0 + large * large)
    at_once = guard.pace * root * root / (1.0 - 2.0 * root * (1.0 - root))
    held = guard.relief * state.held_back
    overload = state.overload + guard.forgetting * (held / (1.0 + held) - state.overload)
    overloaded = 4.0 * overload * overload
    overloaded = overloaded * overloaded
    lasting = share / INSISTENT
    for _ in range(4):
        lasting = lasting * lasting
    left = (1.0 - at_once) * (1.0 - guard.steady_pace * lasting / (1.0 + lasting))
    left = left * (1.0 - guard.pace * overloaded / (1.0 + overloaded))

    gain, ceiling, lately = state.memory
    lately = lately + guard.remembrance * (gain - lately)
    lower = ops.minimum(0.0, LEAST + BELOW * (lately - LEAST) - ceiling)
    ceiling = ceiling + (1.0 - left) * lower + guard.probing * state.memory.ceiling * (1.0 - state.memory.ceiling)
    gain = LEAST + left * (gain + guard.recovery * (ceiling - gain) - LEAST)
    memory = BackoffMemory(gain, ceiling, lately)
    filtered = first, second, third, fourth
    return BackoffState(memory, filtered, swing, drift, heard, share, overload, 0.0 * state.held_back)


def _passed(pole: Scalar, state: Vector, value: Vector) -> Vector:
    return tuple(new + pole * (old - new) for new, old in zip(value, state, strict=True))


def _square(value: Vector) -> Scalar:
    x, y, z = value
    return x * x + y * y + z * z
