"""Record scalar arithmetic once, run it ever after as a straight-line Python function.

The source that is recorded stays the only implementation. The order of its operations is kept, so for
finite values the recording gives the bits that the source gives on floats. Only x·1, x/1, x ± 0, x·0 and
−(−x) are folded: equal in value, though a zero may change its sign, and 0·x no longer spreads a NaN of x.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from math import isfinite
from typing import Any, NoReturn

from jaxmpc.law.ops import FLOATS

FUNCTIONS: dict[str, Callable[..., float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "sqrt": math.sqrt,
    "exp": FLOATS.exp,
    "log": math.log,
    "minimum": min,
    "maximum": max,
    "abs": abs,
}
"""What a recording may call besides its own arithmetic."""


@dataclass(frozen=True)
class Recorded:
    """A straight-line function and how it came about.

    Attributes:
        function: Takes the inputs in the nesting they were recorded with; NamedTuples may come, and do
            return, as plain tuples.
        source: Its text.
        operations: Arithmetic operations of one call.
    """

    function: Callable[..., Any]
    source: str
    operations: int


class Operand:
    """A number that is known only when the recorded function runs: an input, or what an operation gave."""

    __slots__ = ("arguments", "form", "name", "tape")
    __array_ufunc__ = None  # so that a numpy number on the left leaves the operation to this class
    __hash__ = None  # type: ignore[assignment]  # never a key: == has no answer yet

    def __init__(self, tape: "Tape", name: str, form: str = "", arguments: tuple[Any, ...] = ()) -> None:
        self.tape, self.name, self.form, self.arguments = tape, name, form, arguments

    def __add__(self, other: Any) -> Any:
        return self if _equals(other, 0.0) else self.tape.operation("{} + {}", self, other)

    def __radd__(self, other: Any) -> Any:
        return self if _equals(other, 0.0) else self.tape.operation("{} + {}", other, self)

    def __sub__(self, other: Any) -> Any:
        return self if _equals(other, 0.0) else self.tape.operation("{} - {}", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.tape.operation("{} - {}", other, self)

    def __mul__(self, other: Any) -> Any:
        if _equals(other, 0.0):
            return 0.0
        return self if _equals(other, 1.0) else self.tape.operation("{} * {}", self, other)

    def __rmul__(self, other: Any) -> Any:
        if _equals(other, 0.0):
            return 0.0
        return self if _equals(other, 1.0) else self.tape.operation("{} * {}", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self if _equals(other, 1.0) else self.tape.operation("{} / {}", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self.tape.operation("{} / {}", other, self)

    def __neg__(self) -> Any:
        return self.arguments[0] if self.form == "-{}" else self.tape.operation("-{}", self)

    def __abs__(self) -> Any:
        return self.tape.operation("abs({})", self)

    def __eq__(self, other: object) -> NoReturn:
        raise TypeError("a recorded number cannot be compared: its value is not known yet")

    def __bool__(self) -> NoReturn:
        raise TypeError("a recorded number is neither true nor false: its value is not known yet")


class _Functions:
    """Scalar functions of the law: recorded on operands, computed on numbers."""

    def sin(self, x: Any) -> Any:
        """Sine of an angle [rad]."""
        return _apply("sin", x)

    def cos(self, x: Any) -> Any:
        """Cosine of an angle [rad]."""
        return _apply("cos", x)

    def sqrt(self, x: Any) -> Any:
        """Square root."""
        return _apply("sqrt", x)

    def exp(self, x: Any) -> Any:
        """Exponential."""
        return _apply("exp", x)

    def log(self, x: Any) -> Any:
        """Natural logarithm."""
        return _apply("log", x)

    def minimum(self, x: Any, y: Any) -> Any:
        """Smaller of two."""
        return _apply("minimum", x, y)

    def maximum(self, x: Any, y: Any) -> Any:
        """Larger of two."""
        return _apply("maximum", x, y)

    def clip(self, x: Any, low: Any, high: Any) -> Any:
        """A value held within two limits."""
        return self.minimum(self.maximum(x, low), high)


OPS: Any = _Functions()
"""The `ops` of whatever is recorded: no more than the robot's law calls, none of which compares."""


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
        text = form.format(*map(_text, arguments))
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


def compile_straightline(function: Callable[..., Any], inputs: Sequence[Any]) -> Recorded:
    """Run a function once on operands and return what it did as straight-line code.

    Args:
        function: Arithmetic on scalars, nested in tuples, lists or NamedTuples as it likes; None stands for a part
            that is missing.
        inputs: Its arguments, nested likewise; the numbers in them only hold a place.

    Raises:
        ValueError: It uses or returns a constant that is not finite.
        TypeError: It compares operands, or uses or returns something that is not a number.
    """
    tape = Tape()
    number = count()
    operands = [map_leaves(lambda _: Operand(tape, f"x{next(number)}"), each) for each in inputs]
    output = map_leaves(tape.checked, function(*operands))
    if output is None:
        raise TypeError("cannot record None: it is neither a number nor an operand")
    needed = _needed(output)
    body = [f"{_text(tree, none='_')} = a{index}" for index, tree in enumerate(operands)]
    steps = [f"{result.name} = {text}" for text, result in tape.operations.items() if result.name in needed]
    body += [*steps, f"return {_text(output)}"]
    head = f"def recorded({', '.join(f'a{index}' for index in range(len(operands)))}):"
    source = "\n    ".join([head, *body]) + "\n"
    namespace: dict[str, Any] = {"__builtins__": {}, **FUNCTIONS}
    exec(compile(source, "<recorded>", "exec"), namespace)  # our own text: names and numbers made above
    return Recorded(namespace["recorded"], source, len(steps))


def map_leaves(function: Callable[[Any], Any], tree: Any) -> Any:
    """The same nesting with every leaf replaced; a NamedTuple stays one, a list becomes a tuple, None stays."""
    if tree is None:
        return None
    if not isinstance(tree, tuple | list):
        return function(tree)
    children = tuple(map_leaves(function, child) for child in tree)
    return type(tree)(*children) if hasattr(tree, "_fields") else children


def _needed(output: Any) -> set[str]:
    """Names of everything that the output is made from."""
    pending: list[Operand | float] = []
    map_leaves(pending.append, output)
    needed: set[str] = set()
    while pending:
        operand = pending.pop()
        if isinstance(operand, Operand) and operand.name not in needed:
            needed.add(operand.name)
            pending.extend(operand.arguments)
    return needed


def _text(tree: Any, none: str = "None") -> str:
    """Python text of nested operands and constants; repr of a float is exact."""
    if isinstance(tree, tuple):
        return f"({''.join(f'{_text(child, none)}, ' for child in tree)})"
    return none if tree is None else tree.name if isinstance(tree, Operand) else repr(tree)


def _apply(name: str, *arguments: Any) -> Any:
    tape = next((each.tape for each in arguments if isinstance(each, Operand)), None)
    if tape is None:
        return FUNCTIONS[name](*arguments)
    return tape.operation(f"{name}({', '.join('{}' for _ in arguments)})", *arguments)


def _equals(value: Any, constant: float) -> bool:
    return isinstance(value, int | float) and value == constant
