"""Wanted force on one axis over time: holds, ramps and sweeps in a row, each a piece of one formula.

    F(t) = F₀ + r s + A sin(2π (f + ½ c s) s),   s = t − t₀

A hold has r = A = 0, a ramp A = 0, a sweep r = 0. Simulation and robot fly the same pieces by the same function.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxmpc.law.scalar import Scalar, Vector

PI = 3.141592653589793
LARGEST, LONGEST, FASTEST = 100.0, 1e4, 500.0
"""Bounds of what a segment may ask for: force [N], time [s] or rate [N/s], frequency [Hz]."""
DEFAULT = {"x": 0.0, "y": 0.0, "z": -5.0}
"""The paper's wanted force [N]."""

Segment = Mapping[str, Any]
"""Plain data: its `kind` (a key of `KINDS`) and the numbers of that kind."""


class Piece(NamedTuple):
    """Force from a time on, until the next piece begins."""

    begin: float
    """t₀ [s]."""
    level: float
    """F₀ [N]."""
    slope: float = 0.0
    """r [N/s]."""
    amplitude: float = 0.0
    """A [N]."""
    frequency: float = 0.0
    """f [Hz]."""
    chirp: float = 0.0
    """c [Hz/s]."""


Placed = tuple[Piece, float | None, float]
"""A piece, its duration [s] (None: to the end) and the force that the next one starts from [N]."""


def told(force_ref: Sequence[Sequence[Sequence[float]]]) -> list[list[tuple[float, ...]]]:
    """What each sample of a stretch is told by a reference that is known ahead, where rows hold only what is ahead.

    Its own wanted force is the first that the row before it has ahead; nothing tells that of the first row, which takes
    its own.

    Args:
        force_ref: Wanted force of each axis 1…H samples ahead (n, 3, H) [N].

    Returns:
        Wanted force of the sample itself and 1…H samples ahead (n, 3, 1 + H) [N].
    """
    befores = [*force_ref[:1], *force_ref[:-1]]
    return [
        [(before[0], *ahead) for before, ahead in zip(was, row, strict=True)]
        for was, row in zip(befores, force_ref, strict=True)
    ]


def split(wanted: Sequence[Sequence[Scalar]], weights: int) -> tuple[Vector, tuple[Sequence[Scalar], ...]]:
    """Wanted force of a sample itself, 3 scalars, and what its cascades are given, 3 × `weights` [N].

    Args:
        wanted: One value per axis; or 1 + H, of the sample and of 1…H ahead, where that many are weighed.
        weights: How many the MPC weighs.
    """
    return tuple(axis[0] for axis in wanted), tuple(axis[-weights:] for axis in wanted)


def hold(begin: float, level: float, duration: float | None = None) -> Placed:
    """Keep the force reached so far, for `duration` [s]; without one, to the end."""
    return Piece(begin, level), duration, level


def ramp(begin: float, level: float, to: float, rate: float) -> Placed:
    """Go to a force `to` [N] at a constant `rate` [N/s]."""
    slope = rate if to > level else -rate if to < level else 0.0
    return Piece(begin, level, slope), abs(to - level) / rate, to


def sweep(begin: float, level: float, amplitude: float, start: float, stop: float, duration: float) -> Placed:
    """Add `amplitude` [N] × a sine whose frequency goes linearly from `start` to `stop` [Hz] in `duration` [s]."""
    return Piece(begin, level, 0.0, amplitude, start, (stop - start) / duration), duration, level


KINDS: Mapping[str, Any] = {"hold": hold, "ramp": ramp, "sweep": sweep}
"""Segments by name; their numbers are the arguments after `level`."""


def place(axis: float | Sequence[Segment]) -> tuple[Piece, ...]:
    """Pieces of a constant force [N], or of segments from 0 N on; after the last the force is held."""
    if isinstance(axis, float | int):
        return (Piece(0.0, float(axis)),)
    pieces: list[Piece] = []
    begin = level = 0.0
    for segment in axis:
        numbers = {key: value for key, value in segment.items() if key != "kind"}
        piece, duration, level = KINDS[segment["kind"]](begin, level, **numbers)
        pieces.append(piece)
        if duration is None:
            return tuple(pieces)
        begin += duration
    return (*pieces, Piece(begin, level))


def never_reached(axis: Sequence[Segment]) -> int | None:
    """Place of the first segment behind a hold that lasts to the end; None where every segment is flown."""
    endless = next((i for i, each in enumerate(axis) if each["kind"] == "hold" and each.get("duration") is None), None)
    return None if endless is None or endless + 1 == len(axis) else endless + 1


def force_of(piece: Piece, t: Scalar, ops: Any) -> Scalar:
    """F(t) of one piece [N]; `ops` has `sin`."""
    since = t - piece.begin
    phase = 2.0 * PI * (piece.frequency + 0.5 * piece.chirp * since) * since
    return piece.level + piece.slope * since + piece.amplitude * ops.sin(phase)


def force_at(pieces: Sequence[Piece], t: Scalar, ops: Any) -> Scalar:
    """Wanted force at a time, or at each time of an array [N]; `ops` has `sin` and `where`."""
    force: Scalar = pieces[0].level
    for piece in pieces:
        force = ops.where(t >= piece.begin, force_of(piece, t, ops), force)
    return force


def on_ramp(pieces: Sequence[Piece], t: Scalar, ops: Any) -> Scalar:
    """Whether the wanted force stands on a ramp at a time, or at each time of an array."""
    ramping: Scalar = False
    for piece in pieces:
        ramping = ops.where(t >= piece.begin, piece.slope != 0.0, ramping)
    return ramping


def piece_at(pieces: Sequence[Piece], t: float) -> Piece:
    """The piece in which a single time lies [s]."""
    found = pieces[0]
    for piece in pieces:
        if piece.begin > t:
            break
        found = piece
    return found
