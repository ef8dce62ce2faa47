"""How the lungs breathe: respiratory phase, a hold of the ventilator, a cough."""

import numpy as np

from jaxmpc.world.heart.harmonics import fade_in, fade_in_rate
from jaxmpc.world.heart.rhythm_settings import RhythmSettings

HOLD_RAMP = 0.5
"""Time in which the lungs come to rest and start again [s]."""
COUGH, COUGH_DURATION = 0.010, 0.3
"""Displacement of a cough [m] and the time in which it is reached, and undone [s]."""


def respiratory_phase(motion: RhythmSettings, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phase of the ventilator, shape (n,) [cycles], and its rate, shape (n,) [cycles/s].

    During a hold the lungs stay where it found them.
    """
    rate = motion.respiratory_rate_hz
    if motion.ventilation != "hold":
        return rate * t, np.full(np.shape(t), rate)
    held, holding = (
        before - after
        for before, after in zip(
            *(_ramp(t, at) for at in (motion.ventilation_at, motion.ventilation_at + motion.hold_duration)), strict=True
        )
    )
    return rate * (t - held), rate * (1.0 - holding)


def _ramp(t: np.ndarray, start: float) -> tuple[np.ndarray, np.ndarray]:
    """The integral of `fade_in` over `HOLD_RAMP`, and `fade_in` itself."""
    s = np.clip((t - start) / HOLD_RAMP, 0.0, 1.0)
    integral = HOLD_RAMP * s**4 * (2.5 - 3.0 * s + s**2) + np.maximum(t - start - HOLD_RAMP, 0.0)
    return integral, fade_in(t, start, HOLD_RAMP)


def cough(motion: RhythmSettings, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the cough along the direction of breathing, shape (n,) [m], and its velocity [m/s]."""
    if motion.ventilation != "cough":
        return np.zeros(np.shape(t)), np.zeros(np.shape(t))
    begin, end = motion.ventilation_at, motion.ventilation_at + COUGH_DURATION
    shape = fade_in(t, begin, COUGH_DURATION) - fade_in(t, end, COUGH_DURATION)
    rate = fade_in_rate(t, begin, COUGH_DURATION) - fade_in_rate(t, end, COUGH_DURATION)
    return COUGH * shape, COUGH * rate
