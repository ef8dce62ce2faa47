"""A traced step with fewer instructions, for a kernel whose rate is that at which they are issued.

    a / b                              a · (1/b): each denominator inverted once, by the processor's own reciprocal
    sin, cos of an angle near another  that one's, turned by the difference (`Ops.near`)
    what is equal                      computed once (`jaxmpc.engine.web`)

and with fewer registers: each tangent comes as soon as it can, not after all values. Sums stay as they stand. Put
together anew, so that each product costs one instruction, they keep both factors of each until then: the arm's kernel
then spills, and its slopes take twice as long.
"""

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from jaxmpc.engine import lane_ops
from jaxmpc.engine.web import SINES, Web

OPERATORS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "mul": operator.mul,
    "neg": operator.neg,
    "sub": operator.sub,
}


class Inverses(NamedTuple):
    """What a processor does in one instruction, to its own last bit."""

    reciprocal: Callable[[Any], Any]
    root: Callable[[Any], Any]


def lean(function: Callable[..., Any], inverses: Inverses, *arguments: Any, values: int | None = None) -> Any:
    """f(…) in fewer instructions; what is left has no slopes, so f takes those that are wanted itself.

    Args:
        function: Traceable, of array leaves alone, with the functions of `lane_ops` for float32.
        inverses: Reciprocal and root.
        arguments: Its own.
        values: How many leaves of its result, from the first on, are values; the others are tangents. None: all.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    inputs = jax.tree.leaves(arguments)
    web = Web(inputs)
    results = web.take(closed.jaxpr, closed.consts, list(range(len(inputs))))
    found = _Values(web, inverses)
    for place in web.needed(results, len(results) if values is None else values):
        found.value(place)
    return jax.tree.unflatten(jax.tree.structure(shape), list(map(found.value, results)))


class _Values:
    """Values of a web, as they come to be needed."""

    def __init__(self, web: Web, inverses: Inverses) -> None:
        self.web, self.inverses = web, inverses
        self.values: dict[int, Any] = {}
        self.sines: dict[int, tuple[Any, Any]] = {}

    def value(self, place: int) -> Any:
        if place not in self.values:
            self.values[place] = self._computed(place)
        return self.values[place]

    def _computed(self, place: int) -> Any:
        name, operands, told = self.web.nodes[place]
        if name == "input":
            return self.web.inputs[told]
        if name in SINES:
            return self._sines(operands[0])[SINES.index(name)]
        equation = self.web.equations[place]
        if name == "number":
            return equation.val
        values = list(map(self.value, operands))
        if name in OPERATORS:
            return OPERATORS[name](*values)
        if name == "part":
            return values[0][told]
        if name in ("inverse", "sqrt"):
            return (self.inverses.root if name == "sqrt" else self.inverses.reciprocal)(values[0])
        return equation.primitive.bind(*values, **equation.params)

    def _sines(self, angle: int) -> tuple[Any, Any]:
        if angle not in self.sines:
            near, value = self.web.near.get(angle), self.value(angle)
            if near is None:
                self.sines[angle] = lane_ops.sines(value)
            else:
                self.sines[angle] = lane_ops.turned(*self._sines(near), value - self.value(near))
        return self.sines[angle]
