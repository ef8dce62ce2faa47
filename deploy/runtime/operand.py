"""Numbers that are known only when a recorded function runs, and the tape of what was done with them.

Whatever keeps the value is folded while it is recorded: x·1, x/1, x ± 0, x·0; signs move to a sum that takes
them up, a − (−b) = a + b; a quotient by a power of two becomes a product. A zero may change its sign by that, and
0·x no longer spreads a NaN of x; every other bit stays.
"""

from math import frexp, isfinite
from typing import Any, NoReturn


class Operand:
    """A number that is known only when the recorded function runs: an input, or what an operation gave."""

    __slots__ = ("arguments", "form", "name", "tape")
    __array_ufunc__ = None  # so that a numpy number on the left leaves the operation to this class
    __hash__ = None  # type: ignore[assignment]  # never a key: == has no answer yet

    def __init__(self, tape: "Tape", name: str, form: str = "", arguments: tuple[Any, ...] = ()) -> None:
        self.tape, self.name, self.form, self.arguments = tape, name, form, arguments

    def __add__(self, other: Any) -> Any:
        return _sum(self.tape, self, other)

    def __radd__(self, other: Any) -> Any:
        return _sum(self.tape, other, self)

    def __sub__(self, other: Any) -> Any:
        return _difference(self.tape, self, other)

    def __rsub__(self, other: Any) -> Any:
        return _difference(self.tape, other, self)

    def __mul__(self, other: Any) -> Any:
        return _product(self.tape, self, other)

    def __rmul__(self, other: Any) -> Any:
        return _product(self.tape, other, self)

    def __truediv__(self, other: Any) -> Any:
        return _quotient(self.tape, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _quotient(self.tape, other, self)

    def __neg__(self) -> Any:
        return self.arguments[0] if _opposite(self) else self.tape.operation("-{}", self)

    def __abs__(self) -> Any:
        return self.tape.operation("abs({})", self)

    def __eq__(self, other: object) -> NoReturn:
        raise TypeError("a recorded number cannot be compared: its value is not known yet")

    def __bool__(self) -> NoReturn:
        raise TypeError("a recorded number is neither true nor false: its value is not known yet")


class Tape:
    """The operations of one recording, each different one once, in their first order."""

    def __init__(self) -> None:
        self.operations: dict[str, Operand] = {}

    def operation(self, form: str, *arguments: Any) -> Operand:
        """The result of an operation, of the earlier one if it was recorded before.

        Args:
            form: Its text with one {} per argument.
            *arguments: Operands and constants.

        Raises:
            ValueError: A constant is not finite.
            TypeError: An argument is neither a number nor an operand of this recording.
        """
        arguments = tuple(self.checked(argument) for argument in arguments)
        text = form.format(*(each.name if isinstance(each, Operand) else repr(each) for each in arguments))
        if text not in self.operations:
            self.operations[text] = Operand(self, f"t{len(self.operations)}", form, arguments)
        return self.operations[text]

    def checked(self, value: Any) -> Operand | float:
        """An operand of this recording, or a finite constant."""
        if isinstance(value, Operand):
            if value.tape is not self:
                raise TypeError("an operand of another recording was used")
            return value
        if not isinstance(value, int | float):
            raise TypeError(f"cannot record {value!r}: it is neither a number nor an operand")
        if not isfinite(value):
            raise ValueError(f"cannot record the constant {value!r}: it is not finite")
        return float(value)


def _sum(tape: Tape, a: Any, b: Any) -> Any:
    if _equals(a, 0.0) or _equals(b, 0.0):
        return b if _equals(a, 0.0) else a
    if _opposite(b):
        return a - -b
    return b - -a if _opposite(a) else tape.operation("{} + {}", a, b)


def _difference(tape: Tape, a: Any, b: Any) -> Any:
    if _equals(a, 0.0) or _equals(b, 0.0):
        return -b if _equals(a, 0.0) else a
    if _opposite(b):
        return a + -b
    if not _opposite(a):
        return tape.operation("{} - {}", a, b)
    return -(-a + b) if isinstance(b, Operand) else -b - -a


def _product(tape: Tape, a: Any, b: Any) -> Any:
    if _equals(a, 0.0) or _equals(b, 0.0):
        return 0.0
    for one, other in ((a, b), (b, a)):
        if _equals(one, 1.0):
            return other
        if _equals(one, -1.0):
            return -other
        if _opposite(one):
            return -(-one * other) if isinstance(other, Operand) else -one * -other
    return tape.operation("{} * {}", a, b)


def _quotient(tape: Tape, a: Any, b: Any) -> Any:
    if _opposite(a) or _opposite(b):
        return -(a / -b) if _opposite(b) else -(-a / b) if isinstance(b, Operand) else -a / -b
    if isinstance(b, int | float) and isfinite(b) and abs(frexp(b)[0]) == 0.5 and isfinite(1.0 / b):
        return a * (1.0 / b)
    return tape.operation("{} / {}", a, b)


def _opposite(value: Any) -> bool:
    """Whether it is −x of an operand x."""
    return isinstance(value, Operand) and value.form == "-{}"


def _equals(value: Any, constant: float) -> bool:
    return isinstance(value, int | float) and value == constant
