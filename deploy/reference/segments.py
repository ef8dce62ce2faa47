"""Holds, ramps and sweeps as a source: the same pieces, by the same function, as in the simulation.

They come from words, along straight lines between forces, or from the table [reference] of an experiment, per axis.
"""

import math
from collections.abc import Mapping, Sequence
from inspect import signature
from itertools import pairwise
from typing import Any

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.law.reference import (
    DEFAULT,
    FASTEST,
    KINDS,
    LARGEST,
    LONGEST,
    Piece,
    force_of,
    never_reached,
    piece_at,
    place,
)
from jaxmpc.law.vectors import Vector3

WORDS = "X,Y,Z@RATE, hold@SECONDS or sweep@X,Y,Z@HZ@HZ@SECONDS"
_BOUNDS = {"to": LARGEST, "amplitude": LARGEST, "start": FASTEST, "stop": FASTEST}
_SIGNED = ("to", "amplitude")
_OPTIONAL = {"hold": {"duration"}}
_NUMBERS = {kind: tuple(signature(placed).parameters)[2:] for kind, placed in KINDS.items()}


class Segments:
    """Wanted force of pieces per axis; after the last the force is held."""

    def __init__(self, axes: Sequence[Sequence[Piece]], name: str = "reference") -> None:
        """Take the pieces of X, Y and Z."""
        self._x, self._y, self._z = axes
        self._name, self._end = name, max(pieces[-1].begin for pieces in axes)
        self._ended = False

    def wanted(self, t: float) -> Vector3:
        """Force on the tissue [N] wanted at a time since contact [s]."""
        self._ended = self._ended or t >= self._end
        return _force_at(self._x, t), _force_at(self._y, t), _force_at(self._z, t)

    def notes(self) -> list[str]:
        """Whether it came to its end."""
        held = f"{self._name}: ended at {self._end:g} s, its last force was held"
        return [held] if self._ended and self._end > 0.0 else []


def from_words(text: str, *, rate: float, largest: float, start: Vector3 = (0.0, 0.0, 0.0)) -> Segments:
    """Segments in a row, each of all axes together.

    Args:
        text: `X,Y,Z@RATE` goes to a force [N] along a straight line at a rate [N/s], `hold@SECONDS` waits,
            `sweep@X,Y,Z@HZ@HZ@SECONDS` adds a sine of these amplitudes [N] from one frequency to another.
        rate: Largest rate [N/s].
        largest: Largest magnitude [N].
        start: Force where they begin [N].

    Raises:
        InputError: A segment is none of these, or exceeds a limit.
    """
    axes: list[list[Piece]] = [[], [], []]
    begin, force = 0.0, start
    words = text.split()
    if not words:
        raise InputError("reference", text, f"segments: {WORDS}", "For example 0,0,-5@2 hold@5.")
    for word in words:
        target, *numbers = word.removeprefix("sweep@").split("@")
        vector, values = _numbers(target.split(",")), _numbers(numbers)
        if word.startswith("sweep@") and len(vector) == len(values) == 3 and min(values) > 0.0:
            low, high, duration = values
            placed = [KINDS["sweep"](begin, f, a, low, high, duration) for f, a in zip(force, vector, strict=True)]
        elif target == "hold" and len(values) == 1 and values[0] > 0.0:
            placed = [KINDS["hold"](begin, f, duration := values[0]) for f in force]
        elif len(vector) == 3 and len(values) == 1 and values[0] > 0.0:
            to = (vector[0], vector[1], vector[2])
            duration = math.dist(to, force) / values[0]
            slopes = [(v - f) / duration if duration else 0.0 for f, v in zip(force, to, strict=True)]
            placed = [(Piece(begin, f, r), duration, v) for f, r, v in zip(force, slopes, to, strict=True)]
            force = to
        else:
            raise InputError("reference", word, WORDS, "For example 0,0,-5@2 hold@5.")
        for pieces, (piece, _, _) in zip(axes, placed, strict=True):
            pieces.append(piece)
        begin += duration
    for pieces, level in zip(axes, force, strict=True):
        pieces.append(Piece(begin, level))
    _check(axes, rate, largest)
    return Segments(axes)


def from_table(table: Mapping[str, Any], *, rate: float, largest: float, name: str = "reference") -> Segments:
    """The table [reference] of an experiment: a constant [N] or segments per axis.

    Args:
        table: Plain data with the keys x, y, z and preview, of which the artifact decides the last.
        rate: Largest rate of all axes together [N/s].
        largest: Largest magnitude [N].
        name: Of the table, for notes.

    Raises:
        InputError: A key or a value is wrong, or a segment exceeds a limit.
    """
    for key in table:
        if key not in (*DEFAULT, "preview"):
            raise InputError(f"reference.{key}", table[key], "a known key", nearest(key, [*DEFAULT, "preview"]))
    axes = [place(_axis(f"reference.{key}", table.get(key, value))) for key, value in DEFAULT.items()]
    _check(axes, rate, largest)
    return Segments(axes, name)


def check_size(force: Vector3, largest: float, key: str) -> None:
    """Refuse a force that is too great [N].

    Raises:
        InputError: It is.
    """
    size = math.hypot(*force)
    if not size <= largest:
        raise InputError(key, f"{size:.4g} N", f"at most {largest:g} N", "Ask for less, or declare a higher limit.")


def _force_at(pieces: Sequence[Piece], t: float) -> float:
    force: float = force_of(piece_at(pieces, t), t, math)
    return force


def _check(axes: Sequence[Sequence[Piece]], rate: float, largest: float) -> None:
    """Refuse what exceeds a limit at any time; between two beginnings of pieces each axis is a line and a sine."""
    begins = sorted({piece.begin for pieces in axes for piece in pieces})
    for begin, end in pairwise([*begins, begins[-1]]):
        at = [piece_at(pieces, begin) for pieces in axes]
        for t in (begin, end):
            reach = [abs(p.level + p.slope * (t - p.begin)) + abs(p.amplitude) for p in at]
            check_size((reach[0], reach[1], reach[2]), largest, "reference")
        speed = math.hypot(*(abs(p.slope) + abs(p.amplitude) * 2.0 * math.pi * _highest(p, end) for p in at))
        if speed > rate * (1.0 + 1e-9):
            bound = f"at most {rate:g} N/s fast"
            raise InputError(
                "reference",
                f"{speed:.4g} N/s from {begin:g} s on",
                bound,
                "Ask for a slower one, or allow it by --rate.",
            )


def _highest(piece: Piece, end: float) -> float:
    """Highest frequency of a sweep until a time [Hz]."""
    return max(piece.frequency, piece.frequency + piece.chirp * (end - piece.begin))


def _axis(key: str, axis: Any) -> Any:
    """An axis whose every number is within its bounds."""
    if isinstance(axis, list | tuple):
        for i, segment in enumerate(axis):
            _check_segment(f"{key}[{i}]", segment)
        if (lost := never_reached(axis)) is not None:
            remedy = f"Say how long {key}[{lost - 1}] holds, or leave out what follows."
            raise InputError(f"{key}[{lost - 1}].duration", "missing", "given [s] before another segment", remedy)
        return axis
    _within(key, axis, -LARGEST, LARGEST)
    return axis


def _check_segment(key: str, segment: Any) -> None:
    kind: Any = segment.get("kind") if isinstance(segment, Mapping) else None
    if kind not in KINDS:
        raise InputError(f"{key}.kind", kind, "a known kind", nearest(str(kind), list(KINDS)))
    numbers = {name: value for name, value in segment.items() if name != "kind"}
    if wrong := (set(numbers) ^ set(_NUMBERS[kind])) - _OPTIONAL.get(kind, set()):
        bound = f"exactly {', '.join(_NUMBERS[kind])} in a {kind}"
        raise InputError(f"{key}.{min(wrong)}", numbers.get(min(wrong), "missing"), bound, "Give these numbers.")
    for name, value in numbers.items():
        most = _BOUNDS.get(name, LONGEST)
        _within(f"{key}.{name}", value, -most if name in _SIGNED else math.ulp(0.0), most)


def _within(key: str, value: Any, low: float, high: float) -> None:
    number = isinstance(value, float | int) and not isinstance(value, bool)
    if not (number and low <= value <= high):
        raise InputError(key, value, f"a number in [{low:g}, {high:g}]", "Choose another value.")


def _numbers(words: Sequence[str]) -> list[float]:
    """All of them as finite numbers up to `LONGEST`; none if one is not."""
    try:
        values = list(map(float, words))
    except ValueError:
        return []
    return values if all(abs(value) <= LONGEST for value in values) else []
