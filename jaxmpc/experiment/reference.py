"""The table [reference]: wanted force over time, as holds, ramps and frequency sweeps in a row."""

from typing import Annotated

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import told_by_type
from jaxmpc.law.reference import DEFAULT, FASTEST, LARGEST, LONGEST, Piece, force_at, never_reached, on_ramp, place

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=LONGEST)]
Newton = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]
Frequency = Annotated[float, msgspec.Meta(gt=0.0, le=FASTEST)]


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
    start: Frequency
    stop: Frequency
    duration: Positive


Segment = Hold | Ramp | Sweep


class Reference(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Wanted force on the tissue per axis: a constant [N], or segments that start from 0 N."""

    x: Newton | tuple[Segment, ...] = DEFAULT["x"]
    y: Newton | tuple[Segment, ...] = DEFAULT["y"]
    z: Newton | tuple[Segment, ...] = DEFAULT["z"]
    preview: bool = False
    """Whether the controller knows the reference along H_p; the paper's does not."""

    def __post_init__(self) -> None:
        with told_by_type(self, "reference"):
            for key in DEFAULT:
                _check_all_reached(key, getattr(self, key))


def _check_all_reached(key: str, axis: float | tuple[Segment, ...]) -> None:
    """Refuse segments that never come, since a hold before them has no end."""
    lost = never_reached(msgspec.to_builtins(axis)) if isinstance(axis, tuple) else None
    if lost is not None:
        name = f"reference.{key}[{lost - 1}]"
        remedy = f"Say how long {name} holds, or leave out what follows."
        raise InputError(f"{name}.duration", "missing", "given [s] before another segment", remedy)


def placed(axis: float | tuple[Segment, ...]) -> tuple[Piece, ...]:
    """Pieces of `jaxmpc.law.reference` that an axis stands for."""
    return place(msgspec.to_builtins(axis))


def wanted_force(axis: float | tuple[Segment, ...], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force wanted at each time, and whether it stands on a ramp there.

    Args:
        axis: A constant [N] or segments.
        t: Times, shape (steps,) [s].

    Returns:
        Force, shape (steps,) [N], and a mask of the ramps; after the last segment the force is held.
    """
    pieces = placed(axis)
    return force_at(pieces, t, np), on_ramp(pieces, t, np)
