"""Polynomials in d = 1 − z⁻¹, so that what tends to zero with the frequency keeps its digits.

With its coefficients at hand, an answer of the law takes few operations at each angle. Programs look at a loop in a
dozen places: they have three quarters of the operations, and compile in two thirds of the time. Numpy's own polynomials
ask coefficients for their values, which traced ones do not have.
"""

from itertools import zip_longest
from typing import Any

Coefficients = tuple[Any, ...]
"""Scalars of rising powers, from that of d⁰ on; the float 0.0 where there is no such power."""


class Polynomial:
    """Sum of cₖ dᵏ; traceable."""

    __array_ufunc__ = None  # a numpy scalar leaves its product with a polynomial to that

    def __init__(self, *coefficients: Any) -> None:
        """Take what stands before d⁰, d¹, …."""
        self.coefficients: Coefficients = coefficients

    def __add__(self, other: Any) -> "Polynomial":
        pairs = zip_longest(self.coefficients, _of(other).coefficients, fillvalue=0.0)
        return Polynomial(*(_sum(one, another) for one, another in pairs))

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Polynomial":
        return self + _of(other) * -1.0

    def __rsub__(self, other: Any) -> "Polynomial":
        return self * -1.0 + _of(other)

    def __mul__(self, other: Any) -> "Polynomial":
        factors = _of(other).coefficients
        found = [0.0] * (len(self.coefficients) + len(factors) - 1)
        for i, one in enumerate(self.coefficients):
            for k, factor in enumerate(factors):
                found[i + k] = _sum(found[i + k], _product(one, factor))
        return Polynomial(*found)

    __rmul__ = __mul__


def value(coefficients: Coefficients, d: Any) -> Any:
    """The polynomial at d."""
    *lower, found = coefficients
    for coefficient in reversed(lower):
        found = found * d + coefficient
    return found


def _of(value: Any) -> Polynomial:
    return value if isinstance(value, Polynomial) else Polynomial(value)


def _sum(one: Any, another: Any) -> Any:
    if _is(one, 0.0) or _is(another, 0.0):
        return another if _is(one, 0.0) else one
    return one + another


def _product(one: Any, another: Any) -> Any:
    """Without the operations that change nothing: every q is 1 − d."""
    if _is(one, 0.0) or _is(another, 0.0):
        return 0.0
    if _is(one, 1.0) or _is(another, 1.0):
        return another if _is(one, 1.0) else one
    return one * another


def _is(coefficient: Any, number: float) -> bool:
    return isinstance(coefficient, float) and coefficient == number
