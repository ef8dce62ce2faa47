"""Wanted force over time: holds, ramps and frequency sweeps in a row."""

from typing import Annotated, Literal

import msgspec
import numpy as np

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e4)]
Newton = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]


class Hold(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="hold", tag_field="kind"):
    """Keep the force reached so far, for `duration` [s]; without one, to the end."""

    duration: Positive | None = None


class Ramp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="ramp", tag_field="kind"):
    """Go to a force `to` [N] at a constant `rate` [N/s]."""

    to: Newton
    rate: Positive


class Sweep(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="sweep", tag_field="kind"):
    """Add `amplitude` [N] × a sine whose frequency goes linearly from `start` to `stop` [Hz] in `duration` [s]."""

    amplitude: Newton
    start: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)]
    stop: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)]
    duration: Positive


Segment = Hold | Ramp | Sweep
Axis = Literal["x", "y", "z"]


class Reference(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Wanted force on the tissue per axis: a constant [N], or segments that start from 0 N."""

    x: Newton | tuple[Segment, ...] = 0.0
    y: Newton | tuple[Segment, ...] = 0.0
    z: Newton | tuple[Segment, ...] = -5.0
    preview: bool = False
    """Whether the controller knows the reference along H_p; the paper's does not."""


def wanted_force(axis: float | tuple[Segment, ...], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force wanted at each time, and whether it stands on a ramp there.

    Args:
        axis: A constant [N] or segments.
        t: Times, shape (steps,) [s].

    Returns:
        Force, shape (steps,) [N], and a mask of the ramps; after the last segment the force is held.
    """
    if isinstance(axis, float | int):
        return np.full(len(t), float(axis)), np.zeros(len(t), bool)
    force, ramps = np.zeros(len(t)), np.zeros(len(t), bool)
    level, begin = 0.0, 0.0
    for segment in axis:
        since = t - begin
        match segment:
            case Hold():
                duration = np.inf if segment.duration is None else segment.duration
                value = np.full(len(t), level)
            case Ramp():
                duration = abs(segment.to - level) / segment.rate
                value = level + np.sign(segment.to - level) * segment.rate * since
                ramps |= (since >= 0.0) & (since < duration)
                level = segment.to
            case Sweep():
                duration = segment.duration
                rate = (segment.stop - segment.start) / duration
                value = level + segment.amplitude * np.sin(2.0 * np.pi * (segment.start + 0.5 * rate * since) * since)
        inside = (since >= 0.0) & (since < duration)
        force[inside] = value[inside]
        begin += duration
    force[t >= begin] = level
    return force, ramps
