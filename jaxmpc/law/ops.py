"""Scalar functions that the law and the world need besides + - * /: what they are, and those of plain floats.

Whoever runs the law brings its own: `jaxmpc.xla.ops` for JAX, the recorder of `deploy.runtime.straightline` for the
robot, `jaxmpc.world.arrays` for numpy's arrays, and `FLOATS` for numbers as they are.
"""

import math
from typing import Any, Protocol

from jaxmpc.law.scalar import Scalar


class Ops(Protocol):
    """Functions of scalars of one kind."""

    def sin(self, angle: Scalar, /) -> Scalar:
        """Sine of an angle [rad]."""

    def cos(self, angle: Scalar, /) -> Scalar:
        """Cosine of an angle [rad]."""

    def sqrt(self, value: Scalar, /) -> Scalar:
        """Square root."""

    def exp(self, value: Scalar, /) -> Scalar:
        """Exponential."""

    def log(self, value: Scalar, /) -> Scalar:
        """Natural logarithm."""

    def floor(self, value: Scalar, /) -> Scalar:
        """Largest whole number not above a value."""

    def minimum(self, one: Scalar, other: Scalar, /) -> Scalar:
        """Smaller of two."""

    def maximum(self, one: Scalar, other: Scalar, /) -> Scalar:
        """Larger of two."""

    def clip(self, value: Scalar, low: Scalar, high: Scalar, /) -> Scalar:
        """A value held within two limits."""

    def replaced(self, value: Scalar, new: Scalar, /) -> Scalar:
        """Another value in the place of one, whose slope stays: what a tuner sees through a limit."""

    def near(self, angle: Scalar, other: Scalar, /) -> Scalar:
        """The angle, of which it is known that another whose sine is needed too is not 0.1 rad away."""

    def where(self, condition: Any, this: Scalar, that: Scalar, /) -> Scalar:
        """This where the condition holds, else that."""


LARGEST_EXPONENT = 50.0
"""Where an exponential of Python's own numbers, which would overflow, is held."""


class _Floats:
    """The functions on Python's own numbers."""

    sin, cos = staticmethod(math.sin), staticmethod(math.cos)
    sqrt, log = staticmethod(math.sqrt), staticmethod(math.log)
    minimum, maximum = staticmethod(min), staticmethod(max)

    @staticmethod
    def floor(value: float) -> float:
        return math.floor(value)

    @staticmethod
    def exp(value: float) -> float:
        return math.exp(min(value, LARGEST_EXPONENT))

    @staticmethod
    def clip(value: float, low: float, high: float) -> float:
        return min(max(value, low), high)

    @staticmethod
    def replaced(value: float, new: float) -> float:
        return new

    @staticmethod
    def near(angle: float, other: float) -> float:
        return angle

    @staticmethod
    def where(condition: bool, this: float, that: float) -> float:
        return this if condition else that


FLOATS: Ops = _Floats()
