"""What a rhythm is made from, and where each figure comes from."""

from typing import Annotated, Literal

import msgspec

from jaxmpc.world.heart.bounds import Seconds, Seed

HeartRate = Annotated[float, msgspec.Meta(ge=0.6, le=2.5)]


class RhythmSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a rhythm is made from.

    Where a figure comes from: (published), (usual practice), or (chosen here).
    """

    seed: Seed = 0
    """Seed of the phases, and of all that a rhythm draws."""
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

    @property
    def draws_beats(self) -> bool:
        """Whether its seed draws when the heart beats, or how strongly."""
        if self.rhythm == "variability":
            return self.rr_variation > 0.0 or self.heart_rate_drift > 0.0
        return self.rhythm in ("premature", "bigeminy", "fibrillation")
