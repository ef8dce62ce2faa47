"""A traced step with fewer instructions, for a kernel whose rate is that at which they are issued.

    a / b                              a · (1/b): each denominator inverted once, by the processor's own reciprocal
    sin, cos of an angle near another  that one's, turned by the difference (`Ops.near`)
    what is equal                      computed once (`jaxmpc.engine.web`)
    a·b + c                            one instruction, where nothing else needs a·b; sums are put together anew for
                                       it (`jaxmpc.engine.sums`)

and with fewer registers: each tangent comes as soon as it can, not after all values.
"""

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxmpc.engine import lane_ops
from jaxmpc.engine.sums import regrouped
from jaxmpc.engine.web import SINES, Web

OPERATORS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "mul": operator.mul,
    "neg": operator.neg,
    "sub": operator.sub,
}


class Instructions(NamedTuple):
    """What a processor does in one instruction, to its own last bit."""

    reciprocal: Callable[[Any], Any]
    root: Callable[[Any], Any]
    fused: lane_ops.Fused
    """a·b + c, rounded once."""


def lean(function: Callable[..., Any], processor: Instructions, *arguments: Any, values: int | None = None) -> Any:
    """f(…) in fewer instructions; what is left has no slopes, so f takes those that are wanted itself.

    Args:
        function: Traceable, of array leaves alone, with the functions of `lane_ops`.
        processor: What it does in one instruction.
        arguments: Its own.
        values: How many leaves of its result, from the first on, are values; the others are tangents. None: all.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    inputs = jax.tree.leaves(arguments)
    traced = Web(inputs)
    places = traced.take(closed.jaxpr, closed.consts, list(range(len(inputs))))
    values = len(places) if values is None else values
    web, results = regrouped(traced, places, values)
    order = web.needed(results, values)
    found = _Values(web, processor, web.fused(order, results))
    for place in order:
        if place not in found.within:
            found.value(place)
    return jax.tree.unflatten(jax.tree.structure(shape), list(map(found.value, results)))


class _Values:
    """Values of a web, as they come to be needed."""

    def __init__(self, web: Web, processor: Instructions, fused: dict[int, int]) -> None:
        self.web, self.processor, self.fused = web, processor, fused
        self.within = set(fused.values())
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
        if place in self.fused:
            return self._fused(name, operands, self.fused[place])
        values = list(map(self.value, operands))
        if name in OPERATORS:
            return OPERATORS[name](*values)
        if name == "part":
            return values[0][told]
        if name in ("inverse", "sqrt"):
            return (self.processor.root if name == "sqrt" else self.processor.reciprocal)(values[0])
        # What has turned out to be nothing is a number where there was one per lane.
        pairs = zip(values, equation.invars, strict=True)
        wide = [value if jnp.shape(value) else jnp.broadcast_to(value, var.aval.shape) for value, var in pairs]
        return equation.primitive.bind(*wide, **equation.params)

    def _fused(self, name: str, operands: tuple[int, ...], product: int) -> Any:
        factor, other = self.web.nodes[product].operands
        rest = operands[1] if operands[0] == product else operands[0]
        if name == "add":
            return self.processor.fused(*map(self.value, (factor, other, rest)))
        if operands[0] == product:
            return self.processor.fused(self.value(factor), self.value(other), self._negative(rest))
        return self.processor.fused(self._negative(factor), self.value(other), self.value(rest))

    def _negative(self, place: int) -> Any:
        """A number's is a number: Triton knows no operation on nothing but numbers."""
        number = self.web.number(place)
        return -self.value(place) if number is None else -number

    def _sines(self, angle: int) -> tuple[Any, Any]:
        if angle not in self.sines:
            near, value = self.web.near.get(angle), self.value(angle)
            if near is None:
                self.sines[angle] = lane_ops.sines(value, self.processor.fused)
            else:
                self.sines[angle] = lane_ops.turned(*self._sines(near), value - self.value(near), self.processor.fused)
        return self.sines[angle]
