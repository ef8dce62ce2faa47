"""Plausibility of the sensors: pure steps, one for the force, one for the encoders.

Faults are named as PX4 names them. What each can see, and what it cannot:

    off, intermittent   3 samples missing in a row
    garbage             not finite, beyond the sensor, or a jump
    stuck               12 equal samples of all three axes, or an encoder that stops dead at speed, or while a servo
                        pushes its motor on the way out (`deploy.safety.unmoved`)
    slow                too many samples that repeat the one before
    wrong, sign flip    when it sets in: a jump of the force, or an innovation of the observer; an encoder's as a jump.
                        A scale or bias that was there from the start looks like another tissue: it is *not* seen
                        here, but by the motors if it hides a push (`deploy.safety.force_balance`). A wrong sign from
                        the start shows at first contact, in the force error (`deploy.loop.cycle`), or there.
    delayed             not seen as such; the loop it destabilises breaks a limit, or the innovation's

Each threshold stands between the fastest that a tissue, a motor or an observer does and the smallest fault that it is
there for; the tests check both sides of it.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import erf, isfinite, pi, sqrt
from typing import NamedTuple

from deploy.controller.limits import MECHANICAL_STOPS
from deploy.safety.reasons import Reason
from jaxmpc.law.vectors import Vector3, Vector4

FORCE_LOST = 3
"""Missing samples in a row that are too many; one or two are bridged by the observer's prediction."""
FORCE_RANGE = 120.0
"""Beyond this no sensor here measures [N]: Barrett's counts end at 128 N, and ours never come near."""
FORCE_JUMP, FORCE_JUMP_LOST = 0.625, 1.5
"""Largest change of an axis from one sample to the next, and whatever was lost in between [N]. A clean run changes it
by 0.17 N at most; a flipped sign of 0.4 N and half the scale of 1.3 N change it by more."""
STUCK = 12
"""Equal samples of all three axes in a row that no live sensor gives; `repeats` says how likely they are."""
SLOW = 24
"""Repetitions that are too many, each new value taking one and each repeated one giving two: half the rate reaches it
in 46 samples, a sensor that repeats by chance in one sample of ten in 1e9 of them."""
INNOVATION, INNOVATIONS = 1.4, 3
"""Innovation of the observer on an axis [N], and samples in a row, that no tissue in our range gives: premature beats
bring that of the set `cautious`, whose observer is slow, to 1.10 N, the text design's stays below 0.55 N."""

MOTOR_SPEED = 150.0
"""Faster than this no motor turns [rad/s]: without load and at 48 V it reaches 100 (wam.md §2.5)."""
STUCK_SPEED = 6.0
"""Motors faster than this do not stand still at once [rad/s]: at the torque limits (J4: 15 N m on 0.076 kg m²) braking
leaves 5.2 rad/s in the remembered speed. It is 0.14, 0.21, 0.36, 0.33 rad/s at the joints: slower ones are not seen."""
SETTLING = 0.5
"""Weight of a new sample in the remembered speed [-]."""
BEYOND_STOP = 0.1
"""Farther beyond its mechanical stop no joint goes [rad]."""


class ForceState(NamedTuple):
    """Memory of the force sensor's check."""

    last: Vector3 | None = None
    """Last sample that came [N]."""
    missing: int = 0
    """Samples in a row that did not."""
    equal: int = 1
    """Samples in a row with this value."""
    repeated: int = 0
    """Repetitions, as `SLOW` counts them."""
    surprising: int = 0
    """Samples in a row with a large innovation."""


def force_step(
    state: ForceState, force: Vector3 | None, innovation: Vector3 | None = None
) -> tuple[ForceState, Reason | None]:
    """Take a sample of the force sensor.

    Args:
        state: What the last step returned; `ForceState()` at first, and again after a tare.
        force: As read, before it is turned into the world's frame, which would hide repetitions [N]; None if none came.
        innovation: Of the force observer [N]; None without contact, and until the observer has settled after it.

    Returns:
        The next state, and why the sample must not be used, or None.
    """
    if force is None:
        missing = state.missing + 1
        return state._replace(missing=missing), Reason.FORCE_LOST if missing >= FORCE_LOST else None
    x, y, z = force
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        return state, Reason.FORCE_NOT_FINITE
    if max(abs(x), abs(y), abs(z)) > FORCE_RANGE:
        return state, Reason.FORCE_RANGE
    equal, repeated = 1, max(state.repeated - 1, 0)
    if state.last is not None:
        jump = max(abs(x - state.last[0]), abs(y - state.last[1]), abs(z - state.last[2]))
        if jump > min((1 + state.missing) * FORCE_JUMP, FORCE_JUMP_LOST):
            return state, Reason.FORCE_JUMP
        if jump == 0.0:
            equal, repeated = state.equal + 1, state.repeated + 2
    surprising = 0
    # Not by max(), which may pass over a NaN.
    if innovation is not None and not all(abs(each) <= INNOVATION for each in innovation):
        surprising = state.surprising + 1
    reason = None
    if equal >= STUCK:
        reason = Reason.FORCE_STUCK
    elif repeated >= SLOW:
        reason = Reason.FORCE_SLOW
    elif surprising >= INNOVATIONS:
        reason = Reason.FORCE_MODEL
    return ForceState(force, 0, equal, repeated, surprising), reason


def repeats(noise: Sequence[float], lsb: Sequence[float], samples: int = STUCK) -> float:
    """Chance that a live sensor gives so many equal samples of all axes from now on, the force being constant.

    It is largest where the force lies on a count, which is taken for each axis.

    Args:
        noise: Standard deviation of each axis [N].
        lsb: Its least significant bit [N]; 0 is a perfect one, which repeats only without noise.
        samples: How many equal ones.
    """
    chance = 1.0
    for deviation, step in zip(noise, lsb, strict=True):
        if deviation > 0.0:
            chance *= _equal(step / (deviation * sqrt(2.0)), samples) if step > 0.0 else 0.0
    return chance


def _equal(step: float, samples: int) -> float:
    reach = int(6.0 / step) + 2
    edges = [erf((count - 0.5) * step) for count in range(-reach, reach + 1)]
    return sum((0.5 * (high - low)) ** samples for low, high in pairwise(edges))


class EncoderState(NamedTuple):
    """Memory of the four motor encoders' check."""

    counts: tuple[int | None, int | None, int | None, int | None] = (None, None, None, None)
    """Last that came."""
    age: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Cycles since then."""
    speed: Vector4 = (0.0, 0.0, 0.0, 0.0)
    """Speeds of the motors before they stood still [rad/s]."""
    still: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Samples in a row with this value, less one."""


def encoder_step(
    state: EncoderState, counts: Sequence[int | None], counts_per_turn: Sequence[int], T_s: float, unmoved: int = -1
) -> tuple[EncoderState, Reason | None, int]:
    """Take a sample of the motor encoders.

    Args:
        state: What the last step returned; `EncoderState()` at first.
        counts: Counts of motors 1–4; None where none came.
        counts_per_turn: Of each, CTS as the pucks say.
        T_s: Time since the last step [s].
        unmoved: A motor (0–3) that is pushed and stands still: it is not believed until it tells a motion; −1 for none.

    Returns:
        The next state, why the sample must not be used or None, and the motor that it is about (0–3; −1 for none).
    """
    last, ages, speeds, stills = list(state.counts), list(state.age), list(state.speed), list(state.still)
    found, culprit = None, -1
    for i, now in enumerate(counts):
        before = last[i]
        if now is None:
            ages[i] += 1
            continue
        if before is not None:
            speed = (now - before) * (2.0 * pi / counts_per_turn[i]) / ((ages[i] + 1) * T_s)
            if not abs(speed) <= MOTOR_SPEED:
                return state, Reason.ENCODER_JUMP, i
            if now == before:
                stills[i] += 1
            else:
                stills[i] = 0
                speeds[i] += SETTLING * (speed - speeds[i])
            if stills[i] >= STUCK - 1:
                if i == unmoved:
                    speeds[i] = MOTOR_SPEED  # as if it had stopped dead: so it is found, now and as long as it stands
                if abs(speeds[i]) > STUCK_SPEED:
                    found, culprit = Reason.ENCODER_STUCK, i
                else:
                    speeds[i] = 0.0
        last[i], ages[i] = now, 0
    following = EncoderState(
        (last[0], last[1], last[2], last[3]),
        (ages[0], ages[1], ages[2], ages[3]),
        (speeds[0], speeds[1], speeds[2], speeds[3]),
        (stills[0], stills[1], stills[2], stills[3]),
    )
    return following, found, culprit


def beyond_stop(q: Sequence[float]) -> int:
    """The first joint (0–3) whose angle [rad] no arm can have, or −1."""
    for i, (angle, (low, high)) in enumerate(zip(q, MECHANICAL_STOPS, strict=True)):
        if not low - BEYOND_STOP <= angle <= high + BEYOND_STOP:
            return i
    return -1
