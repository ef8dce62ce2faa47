"""How the heart moves: position and velocity of its surface at any time."""

from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import check_built
from jaxmpc.world.heart import harmonics, phase, recording, rhythm, ventilation
from jaxmpc.world.heart.bounds import Seconds, Size
from jaxmpc.world.heart.rhythm_settings import RhythmSettings

Surface = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Position, shape (n, 3) [m], and velocity, shape (n, 3) [m/s], of the heart's surface at times, shape (n,) [s]."""


class Motion(RhythmSettings, frozen=True, forbid_unknown_fields=True):
    """How the heart moves; the keys of a rhythm need kind = "rhythm".

    Where a figure comes from: (published), (usual practice), or (chosen here).
    """

    kind: Literal["harmonics", "rhythm", "recording", "none"] = "harmonics"
    """"harmonics": the table's seven peaks. "rhythm": its harmonics locked to cardiac and respiratory phase."""
    scale: Size = 1.0
    """Factor on the displacement [-]."""
    phases: Literal["table", "random"] = "table"
    """Phases of the harmonics: the table's, or drawn from `seed`."""
    file: str = ""
    """A recording, CSV or npz; relative to the experiment's file."""
    unit: Literal["m", "mm"] = "m"
    repeat: bool = False
    start: Seconds = 0.0
    """When the motion begins [s]."""
    fade: Seconds = 1.0
    """Time in which it grows to its full size [s]; 0 makes it jump there."""

    def __post_init__(self) -> None:
        if self.kind == "rhythm":
            return
        for name, default in _OF_RHYTHMS.items():
            value = getattr(self, name)
            if value != default:
                remedy = 'Set motion.kind = "rhythm" or remove this key.'
                raise InputError(f"motion.{name}", value, "given for a rhythm only", remedy)

    @property
    def drawn(self) -> bool:
        """Whether its seed draws anything."""
        if self.kind == "rhythm" and (self.draws_beats or self.amplitude_spread or self.drift):
            return True
        return self.kind in ("harmonics", "rhythm") and self.phases == "random"


_OF_RHYTHMS = {field.name: field.default for field in msgspec.structs.fields(RhythmSettings) if field.name != "seed"}
"""Keys of a rhythm alone, and their defaults."""


def displacement(motion: Motion, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the heart's surface; the same function of time wherever it is asked.

    Acceleration is continuous, and velocity is the exact derivative, but for the jump that `fade` = 0 makes.

    Args:
        motion: How the heart moves.
        t: Times, from 0 on, not decreasing, evenly spaced or not, shape (n,) [s].

    Returns:
        Position, shape (n, 3) [m], and velocity, shape (n, 3) [m/s].

    Raises:
        InputError: A value is out of bounds, a recording unusable or too short, the times not as above.
    """
    if t.ndim != 1 or not (np.isfinite(t).all() and (t >= 0.0).all() and (np.diff(t) >= 0.0).all()):
        remedy = "Sort the times and begin at 0 s or later."
        raise InputError("t", "something else", "a vector of finite times that do not decrease, from 0 on", remedy)
    return prepared(motion, t.max(initial=0.0))(t)


def prepared(motion: Motion, until: float) -> Surface:
    """Draw beats or read a recording once; what is returned takes any times up to `until` [s], as `displacement` does.

    Raises:
        InputError: A value is out of bounds, or a recording unusable.
    """
    # What was built in Python has not met its bounds yet.
    check_built(motion, "motion")
    unfaded = _unfaded(motion, until)

    def surface(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position, velocity = unfaded(t)
        grown = harmonics.fade_in(t, motion.start, motion.fade)[:, None]
        growing = harmonics.fade_in_rate(t, motion.start, motion.fade)[:, None]
        return grown * position, grown * velocity + growing * position

    return surface


def _unfaded(motion: Motion, until: float) -> Surface:
    """Motion at its full size from the start on."""
    seed = motion.seed if motion.phases == "random" else None
    match motion.kind:
        case "none":
            return lambda t: (np.zeros((len(t), 3)), np.zeros((len(t), 3)))
        case "harmonics":
            return lambda t: (
                harmonics.harmonic_motion(t, motion.scale, seed),
                harmonics.harmonic_velocity(t, motion.scale, seed),
            )
        case "rhythm":
            beats = rhythm.beats(motion, until)
            return lambda t: _rhythmic(motion, beats, t, seed)
        case "recording":
            times, values = recording.read_recording(motion.file, motion.unit)

            def played(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                local = np.maximum(t - motion.start, 0.0)
                position, velocity = recording.recorded_motion(local, times, values, motion.repeat, motion.file)
                return motion.scale * position, motion.scale * velocity

            return played


def _rhythmic(
    motion: Motion, beats: rhythm.Beats, t: np.ndarray, phase_seed: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """gain(θ_h)·heartbeat(θ_h) + respiration(θ_r) + cough, per-axis factors on all, plus the drift."""
    cardiac, cardiac_rate = phase.cardiac_phase(beats.onsets, t)
    gain, gain_slope = phase.beat_gain(beats.gain, cardiac)
    beat, beat_slope = harmonics.heartbeat(cardiac, phase_seed)
    breath_phase, breath_rate = ventilation.respiratory_phase(motion, t)
    breath, breath_slope = harmonics.respiration(breath_phase, phase_seed)
    cough, cough_rate = ventilation.cough(motion, t)
    direction = np.linalg.norm(harmonics.AMPLITUDES_MM[:, harmonics.RESPIRATION], axis=1)
    direction /= np.linalg.norm(direction)
    position = gain[:, None] * beat + breath + np.outer(cough, direction)
    beat_velocity = (gain_slope[:, None] * beat + gain[:, None] * beat_slope) * cardiac_rate[:, None]
    velocity = beat_velocity + breath_slope * breath_rate[:, None] + np.outer(cough_rate, direction)

    spread = motion.amplitude_spread
    factor = motion.scale * rhythm.generator(motion.seed, 3).uniform(1.0 - spread, 1.0 + spread, 3)
    drift = rhythm.generator(motion.seed, 4).standard_normal(3)
    drift *= motion.drift / 60.0 / np.linalg.norm(drift)
    since = np.maximum(t - motion.start, 0.0)
    return factor * position + np.outer(since, drift), factor * velocity + np.outer(since > 0.0, drift)
