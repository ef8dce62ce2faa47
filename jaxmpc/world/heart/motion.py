"""How the heart moves: position and velocity of its surface at any time."""

from collections.abc import Callable
from typing import Annotated, Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import convert
from jaxmpc.world.heart import harmonics, recording, rhythm

Surface = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Position, shape (n, 3) [m], and velocity, shape (n, 3) [m/s], of the heart's surface at times, shape (n,) [s]."""
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)]
Size = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
HeartRate = Annotated[float, msgspec.Meta(ge=0.6, le=2.5)]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the heart moves.

    Where a figure comes from: (published), (usual practice), or (chosen here).
    """

    kind: Literal["harmonics", "rhythm", "recording", "none"] = "harmonics"
    """"harmonics": the table's seven peaks. "rhythm": its harmonics locked to cardiac and respiratory phase."""
    scale: Size = 1.0
    """Factor on the displacement [-]."""
    phases: Literal["table", "random"] = "table"
    """Phases of the harmonics: the table's, or drawn from `seed`."""
    seed: Seed = 0
    """Seed of the phases, and of all that a rhythm draws."""
    file: str = ""
    """A recording, CSV or npz; relative to the experiment's file."""
    unit: Literal["m", "mm"] = "m"
    repeat: bool = False
    start: Seconds = 0.0
    """When the motion begins [s]."""
    fade: Seconds = 1.0
    """Time in which it grows to its full size [s]; 0 makes it jump there."""

    # All below needs kind = "rhythm".
    rhythm: Literal["steady", "variability", "rate-step", "premature", "bigeminy", "fibrillation"] = "steady"
    """"premature": one beat in 10–20 comes early, at 45–75 % of the cycle (published), and a full compensatory pause
    follows; its displacement is × 0.5–0.8, the next one's × 1.1–1.3 (chosen here). "bigeminy": bursts in which every
    other beat is one. "fibrillation": RR varies by 20 %, no beat knowing of the last (chosen here)."""
    heart_rate_hz: HeartRate = 1.265
    """Mean heart rate of every rhythm but the rate step [Hz] (published)."""
    rr_variation: Annotated[float, msgspec.Meta(ge=0.0, le=0.1)] = 0.02
    """Variability: standard deviation over mean of the RR interval, ECGSYN's two bands [-] (published: 2.2 %)."""
    sinus_arrhythmia: Annotated[float, msgspec.Meta(ge=0.0, le=0.1)] = 0.02
    """Variability: peak to peak of RR over one breath [s] (published: 0.011–0.037)."""
    heart_rate_drift: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] = 10.0
    """Variability: slow drift to either side, from end to end in 60 s [1/min] (chosen here)."""
    rate_step_hz: tuple[HeartRate, HeartRate] = (1.0, 110.0 / 60.0)
    """Rate step: heart rate before and after it, 60 and 110 per minute; it takes 3 s [Hz] (chosen here)."""
    rate_step_at: Seconds = 10.0
    """When the rate step begins [s]."""
    ventilation: Literal["steady", "hold", "cough"] = "steady"
    """"hold": the ventilator stops once. "cough": 10 mm in 0.3 s along the direction of breathing, and back."""
    respiratory_rate_hz: Annotated[float, msgspec.Meta(ge=0.2, le=0.45)] = 0.35
    """Ventilator rate [Hz] (published: 0.34 and twice that; usual practice: 12–25 per minute)."""
    ventilation_at: Seconds = 10.0
    """When the hold or the cough begins [s]."""
    hold_duration: Annotated[float, msgspec.Meta(ge=1.0, le=60.0)] = 10.0
    """Length of the hold [s] (usual practice: 10–30)."""
    amplitude_spread: Annotated[float, msgspec.Meta(ge=0.0, le=0.9)] = 0.0
    """Half-width of a factor on the amplitude about 1, drawn once per axis [-] (chosen here: 0.3)."""
    drift: Annotated[float, msgspec.Meta(ge=0.0, le=0.02)] = 0.0
    """Drift of the baseline in a drawn direction, not scaled [m/min] (chosen here: 0.002)."""

    def __post_init__(self) -> None:
        if self.kind == "rhythm":
            return
        fields = msgspec.structs.fields(self)
        names = [field.name for field in fields]
        for field in fields[names.index("rhythm") :]:
            value = getattr(self, field.name)
            if value != field.default:
                remedy = 'Set motion.kind = "rhythm" or remove this key.'
                raise InputError(f"motion.{field.name}", value, "given for a rhythm only", remedy)


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
    convert(msgspec.to_builtins(motion), Motion, "motion")
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
    cardiac, cardiac_rate = rhythm.cardiac_phase(beats.onsets, t)
    gain, gain_slope = rhythm.beat_gain(beats.gain, cardiac)
    beat, beat_slope = harmonics.heartbeat(cardiac, phase_seed)
    breath_phase, breath_rate = rhythm.respiratory_phase(motion, t)
    breath, breath_slope = harmonics.respiration(breath_phase, phase_seed)
    cough, cough_rate = rhythm.cough(motion, t)
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
