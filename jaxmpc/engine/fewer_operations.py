"""A traced step with fewer instructions, for a kernel whose rate is that at which they are issued.

A compiler keeps the order in which a program rounds. Here it is free, because either order is as exact:

    x + (a b + c d)  →  (x + a b) + c d     two multiply-adds, not a product, a multiply-add and a sum
    a / b            →  a · (1/b)           each denominator inverted once, by the processor's own reciprocal
    sin, cos of an angle near another       that one's, turned by the difference (`Ops.near`)

A sum that was to be rounded in a certain order, to gain digits, would lose them: the step has none. What is made of a
lane's constants alone stays whole, so that it can leave the loop.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from jaxmpc.engine import lane_ops
from jaxmpc.engine.web import SINES, SUMS, Web


class Inverses(NamedTuple):
    """What a processor does in one instruction, to its own last bit."""

    reciprocal: Callable[[Any], Any]
    root: Callable[[Any], Any]


def lean(function: Callable[..., Any], inverses: Inverses, constants: Any, *others: Any) -> Any:
    """f(constants, …) in fewer instructions; what is left has no slopes, so f takes those that are wanted itself.

    Args:
        function: Traceable, of array leaves alone, with the functions of `lane_ops` for float32.
        inverses: Reciprocal and root.
        constants: Its first argument, which no sample changes.
        others: Its other arguments.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(constants, *others)
    inputs = jax.tree.leaves((constants, *others))
    web = Web(inputs, len(jax.tree.leaves(constants)))
    results = web.take(closed.jaxpr, closed.consts, list(range(len(inputs))))
    return jax.tree.unflatten(jax.tree.structure(shape), _Values(web, results, inverses).found())


class _Values:
    """Values of a web, as they come to be needed."""

    def __init__(self, web: Web, results: list[int], inverses: Inverses) -> None:
        self.web, self.results, self.inverses = web, results, inverses
        self.needed = web.needed(results)
        self.uses = Counter(results)
        for place in self.needed:
            self.uses.update(web.nodes[place].operands)
        self.values: dict[int, Any] = {}
        self.sines: dict[int, tuple[Any, Any]] = {}

    def found(self) -> list[Any]:
        """The results, in their order."""
        for place in self.needed:
            # What may be a part of a longer sum comes with it.
            if self.uses[place] > 1 or self.web.nodes[place].name not in (*SUMS, "mul"):
                self._value(place)
        return list(map(self._value, self.results))

    def _value(self, place: int) -> Any:
        if place not in self.values:
            self.values[place] = self._computed(place)
        return self.values[place]

    def _computed(self, place: int) -> Any:
        name, operands, told = self.web.nodes[place]
        if name == "input":
            return self.web.inputs[told]
        if name in SUMS:
            return self._sum(place)
        if name in SINES:
            return self._sines(operands[0])[SINES.index(name)]
        equation = self.web.equations[place]
        if name == "number":
            return equation.val
        values = list(map(self._value, operands))
        if name == "mul":
            return values[0] * values[1]
        if name == "part":
            return values[0][told]
        if name in ("inverse", "sqrt"):
            return (self.inverses.root if name == "sqrt" else self.inverses.reciprocal)(values[0])
        return equation.primitive.bind(*values, **equation.params)

    def _sum(self, place: int) -> Any:
        """Begins with what is no product, so that every product costs one instruction."""
        first, *rest = sorted(
            self._terms(place, True, whole=True), key=lambda term: (self._product(term[1]), not term[0])
        )
        total = self._value(first[1]) if first[0] else -self._value(first[1])
        for positive, term in rest:
            total = total + self._value(term) if positive else total - self._value(term)
        return total

    def _terms(self, place: int, positive: bool, *, whole: bool = False) -> list[tuple[bool, int]]:
        """What a sum adds or subtracts; `whole` if it is the sum that was asked for."""
        name, operands, _ = self.web.nodes[place]
        if name not in SUMS or not (whole or self._alone(place)):
            return [(positive, place)]
        signs = positive, positive if name == "add" else not positive
        terms = [self._terms(each, sign) for each, sign in zip(operands, signs[-len(operands) :], strict=True)]
        found = [term for each in terms for term in each if not self.web.equals(term[1], 0.0)]
        return found or [(positive, operands[0])]

    def _product(self, place: int) -> bool:
        return self.web.nodes[place].name == "mul" and self._alone(place)

    def _alone(self, place: int) -> bool:
        """Whether it is needed once, and at every sample."""
        return self.uses[place] == 1 and not self.web.constant[place]

    def _sines(self, angle: int) -> tuple[Any, Any]:
        if angle not in self.sines:
            near, value = self.web.near.get(angle), self._value(angle)
            if near is None:
                self.sines[angle] = lane_ops.sines(value)
            else:
                self.sines[angle] = lane_ops.turned(*self._sines(near), value - self._value(near))
        return self.sines[angle]
