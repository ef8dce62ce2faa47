"""Record scalar arithmetic once, run it ever after as a straight-line Python function.

The source that is recorded stays the only implementation. The order of its operations is kept, so for
finite values the recording gives the bits that the source gives on floats: `operand` says what is folded,
`statements` how the rest becomes text.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from deploy.runtime.operand import Operand, Tape
from deploy.runtime.statements import statements, text
from jaxmpc.law.ops import LARGEST_EXPONENT

FUNCTIONS: dict[str, Callable[..., float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "sqrt": math.sqrt,
    "exp": math.exp,
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
        return _apply("exp", self.minimum(x, LARGEST_EXPONENT))

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
    results = [result for result in tape.operations.values() if result.name in needed]
    arguments = [f"a{index}" for index in range(len(operands))]
    body = [f"{text(tree, {}, none='_')} = {argument}" for argument, tree in zip(arguments, operands, strict=True)]
    body += statements(results, output, free=arguments)
    head = f"def recorded({', '.join(arguments)}):"
    source = "\n    ".join([head, *body]) + "\n"
    namespace: dict[str, Any] = {"__builtins__": {}, **FUNCTIONS}
    exec(compile(source, "<recorded>", "exec"), namespace)  # our own text: names and numbers made above
    return Recorded(namespace["recorded"], source, len(results))


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


def _apply(name: str, *arguments: Any) -> Any:
    tape = next((each.tape for each in arguments if isinstance(each, Operand)), None)
    if tape is None:
        return FUNCTIONS[name](*arguments)
    return tape.operation(f"{name}({', '.join('{}' for _ in arguments)})", *arguments)
