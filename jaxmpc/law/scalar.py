"""3-vectors and 3×3 matrices as tuples of scalars; constants fold away.

A scalar is a Python float (a constant) or anything with + - * / (a traced JAX scalar, a batch of them, a recorded
operation). Products with the constants 0 and 1 and sums with 0 vanish while the program is traced, so the zeros
and ones of a robot's geometry cost nothing at run time.
"""

from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

Scalar = Any
"""A float, a traced JAX scalar, a batch of either, or a recorded operation."""
Vector = tuple[Any, ...]
Matrix = tuple[tuple[Any, ...], ...]
"""Rows of scalars."""

ZERO: Vector = (0.0, 0.0, 0.0)


class Constant(NamedTuple):
    """Shape and bounds of a constant of the law, declared beside its name for whoever reads it from a file."""

    shape: tuple[int | None, ...] = ()
    """None stands for any length but 0."""
    low: float | None = None
    """Least value."""
    below: float | None = None
    """What every value is below."""
    optional: bool = False
    """Whether it may be None."""


def declared(table: type) -> dict[str, Any]:
    """Fields of a table of constants by name.

    Returns:
        The `Constant` of each, the class of a part that may be missing, or the class of several parts in a tuple.
    """
    found: dict[str, Any] = {}
    for name, hint in get_type_hints(table, include_extras=True).items():
        kinds = (hint, *get_args(hint))
        kind = next(each for each in kinds if isinstance(each, Constant) or hasattr(each, "_fields"))
        found[name] = (kind,) if get_origin(hint) is tuple else kind
    return found


def _is(x: Scalar, constant: float) -> bool:
    return type(x) is float and x == constant


def plus(a: Scalar, b: Scalar) -> Scalar:
    """a + b."""
    return b if _is(a, 0.0) else a if _is(b, 0.0) else a + b


def minus(a: Scalar, b: Scalar) -> Scalar:
    """a − b."""
    return a if _is(b, 0.0) else -b if _is(a, 0.0) else a - b


def times(a: Scalar, b: Scalar) -> Scalar:
    """a · b."""
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    for one, other in ((a, b), (b, a)):
        if _is(one, 1.0):
            return other
        if _is(one, -1.0):
            return minus(0.0, other)
    return a * b


def dot(a: Vector, b: Vector) -> Scalar:
    """Sum of products."""
    total: Scalar = 0.0
    for x, y in zip(a, b, strict=True):
        total = plus(total, times(x, y))
    return total


def add(a: Vector, b: Vector) -> Vector:
    """Sum, element by element."""
    return tuple(map(plus, a, b))


def sub(a: Vector, b: Vector) -> Vector:
    """Difference, element by element."""
    return tuple(map(minus, a, b))


def scale(factor: Scalar, a: Vector) -> Vector:
    """A vector times a scalar."""
    return tuple(times(factor, x) for x in a)


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two 3-vectors."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def transpose(A: Matrix) -> Matrix:
    """Aᵀ."""
    return tuple(zip(*A, strict=True))


def apply(A: Matrix, x: Vector) -> Vector:
    """A x."""
    return tuple(dot(row, x) for row in A)


def apply_transposed(A: Matrix, x: Vector) -> Vector:
    """Aᵀ x."""
    return tuple(dot(column, x) for column in zip(*A, strict=True))


def matmul(A: Matrix, B: Matrix) -> Matrix:
    """A B."""
    columns = transpose(B)
    return tuple(tuple(dot(row, column) for column in columns) for row in A)


def factor_ldl(A: Matrix) -> tuple[Matrix, Vector]:
    """A = L D Lᵀ of a symmetric positive definite matrix.

    Returns:
        L without its diagonal of ones (row i has i entries), and 1/D.
    """
    rows: list[list[Scalar]] = []
    pivots: list[Scalar] = []
    inverse: list[Scalar] = []
    for i in range(len(A)):
        row: list[Scalar] = []
        scaled: list[Scalar] = []
        for j in range(i):
            value = A[i][j]
            for k in range(j):
                value = minus(value, times(scaled[k], rows[j][k]))
            scaled.append(value)
            row.append(times(value, inverse[j]))
        pivot = A[i][i]
        for k in range(i):
            pivot = minus(pivot, times(scaled[k], row[k]))
        rows.append(row)
        pivots.append(pivot)
        inverse.append(1.0 / pivot)
    return tuple(map(tuple, rows)), tuple(inverse)


def solve_ldl(factors: tuple[Matrix, Vector], b: Vector) -> Vector:
    """x of L D Lᵀ x = b."""
    lower, inverse = factors
    x = list(map(times, solve_lower(lower, b), inverse))
    for i in reversed(range(len(x))):
        for j in range(i + 1, len(x)):
            x[i] = minus(x[i], times(lower[j][i], x[j]))
    return tuple(x)


def solve_lower(lower: Matrix, b: Vector) -> Vector:
    """x of L x = b, the first half of the way to that of L D Lᵀ x = b."""
    x = list(b)
    for i in range(len(x)):
        for j in range(i):
            x[i] = minus(x[i], times(lower[i][j], x[j]))
    return tuple(x)
