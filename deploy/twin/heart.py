"""The heart under the twin: the simulator's motions as a stream without end, computed a few milliseconds ahead."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxmpc.law.vectors import Vector3
from jaxmpc.world.heart import harmonics, rhythm

BLOCK = 64
"""Points computed at once: few, so that no tick of a real-time twin is long."""
HORIZON = 600.0
"""Time for which beats are drawn beforehand [s]; beyond it they are drawn anew for twice as long."""
PUBLISHED: dict[str, dict[str, Any]] = {
    "rate-step": {"rhythm": "rate-step"},
    "ventilator-hold": {"ventilation": "hold", "ventilation_at": 8.0},
    "cough": {"ventilation": "cough"},
    "amplitude-drift": {"random_phases": True, "amplitude_spread": 0.3, "drift": 0.002},
}
"""What sets each experiment of `jaxmpc/experiment/published` apart, where it is not the rhythm of that name."""


@dataclass(frozen=True)
class Motion:
    """The keys of `jaxmpc.world.heart.motion.Motion` that its `rhythm` reads, without the file reader."""

    rhythm: str = "steady"
    seed: int = 0
    heart_rate_hz: float = 1.265
    rr_variation: float = 0.02
    sinus_arrhythmia: float = 0.02
    heart_rate_drift: float = 10.0
    rate_step_hz: tuple[float, float] = (1.0, 110.0 / 60.0)
    rate_step_at: float = 10.0
    ventilation: str = "steady"
    respiratory_rate_hz: float = 0.35
    ventilation_at: float = 10.0
    hold_duration: float = 10.0
    random_phases: bool = False
    amplitude_spread: float = 0.0
    drift: float = 0.0


class TwinHeart:
    """Position and velocity of the heart's surface at successive instants."""

    def __init__(self, name: str, step: float, seed: int, scale: float, start: float, fade: float) -> None:
        """Prepare a motion.

        Args:
            name: One of `deploy.twin.settings.RHYTHMS`.
            step: Time from one instant to the next [s].
            seed: Of all that is drawn.
            scale: Factor on the displacement [-].
            start: When it begins [s].
            fade: Time in which it grows to its full size [s].
        """
        self._step, self._scale, self._start, self._fade = step, scale, start, fade
        self._displacement: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
        if name in ("none", "harmonics"):
            size = 0.0 if name == "none" else scale
            self._displacement = lambda t: (harmonics.harmonic_motion(t, size), harmonics.harmonic_velocity(t, size))
        else:
            self._motion = Motion(seed=seed, **PUBLISHED.get(name, {"rhythm": name}))
            self._until, self._beats = HORIZON, rhythm.beats(_any(self._motion), HORIZON)
            self._displacement = self._rhythmic
        self._block, self._points = -1, [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]

    def at(self, instant: int) -> tuple[Vector3, Vector3]:
        """Displacement [m] and velocity [m/s] at an instant counted from 0."""
        block, within = divmod(instant, BLOCK)
        if block != self._block:
            self._block, self._points = block, self._computed(block)
        return self._points[within]

    def _computed(self, block: int) -> list[tuple[Vector3, Vector3]]:
        t = np.arange(block * BLOCK, (block + 1) * BLOCK) * self._step
        position, velocity = self._displacement(t)
        grown = harmonics.fade_in(t, self._start, self._fade)[:, None]
        growing = harmonics.fade_in_rate(t, self._start, self._fade)[:, None]
        moving = grown * velocity + growing * position
        rows = zip((grown * position).tolist(), moving.tolist(), strict=True)
        return [((x[0], x[1], x[2]), (v[0], v[1], v[2])) for x, v in rows]

    def _rhythmic(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `jaxmpc.world.heart.motion` composes it: beat and breath, cough, factors of the axes, drift."""
        motion = self._motion
        if t[-1] > self._until:
            self._until *= 2.0
            self._beats = rhythm.beats(_any(motion), self._until)
        seed = motion.seed if motion.random_phases else None
        cardiac, cardiac_rate = rhythm.cardiac_phase(self._beats.onsets, t)
        gain, gain_slope = rhythm.beat_gain(self._beats.gain, cardiac)
        beat, beat_slope = harmonics.heartbeat(cardiac, seed)
        breath_phase, breath_rate = rhythm.respiratory_phase(_any(motion), t)
        breath, breath_slope = harmonics.respiration(breath_phase, seed)
        cough, cough_rate = rhythm.cough(_any(motion), t)
        direction = np.linalg.norm(harmonics.AMPLITUDES_MM[:, harmonics.RESPIRATION], axis=1)
        direction /= np.linalg.norm(direction)
        position = gain[:, None] * beat + breath + np.outer(cough, direction)
        beating = (gain_slope[:, None] * beat + gain[:, None] * beat_slope) * cardiac_rate[:, None]
        velocity = beating + breath_slope * breath_rate[:, None] + np.outer(cough_rate, direction)

        spread = motion.amplitude_spread
        factor = self._scale * rhythm.generator(motion.seed, 3).uniform(1.0 - spread, 1.0 + spread, 3)
        drift = rhythm.generator(motion.seed, 4).standard_normal(3)
        drift *= motion.drift / 60.0 / np.linalg.norm(drift)
        since = np.maximum(t - self._start, 0.0)
        return factor * position + np.outer(since, drift), factor * velocity + np.outer(since > 0.0, drift)


def _any(motion: Motion) -> Any:
    """A motion for functions that declare another class with the same fields."""
    return motion
