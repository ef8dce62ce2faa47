"""A traced program as a web of operations, in which those that are equal are one.

Functions that are called are taken apart. A quotient is a product with a reciprocal, and of two choices by the same
condition, between something and 1, that are divided by each other one is left. A whole power is a product, of
reciprocals if it is negative; a product with a written zero is nothing.
"""

from collections import Counter
from typing import Any, NamedTuple

import jax.numpy as jnp

# JAX promises nothing of these, but nothing else takes a traced program apart; tests/jaxmpc/test_fewer_operations.py
# runs it.
from jax.extend.core import Literal

from jaxmpc.engine import lane_ops

ARITHMETIC = ("add", "add_any", "div", "integer_pow", "mul", "neg", "sqrt", "sub")
COMMUTING = ("add", "max", "min", "mul")
CALLS = ("jit", "pjit", "custom_jvp_call")
SINES = (lane_ops.SINE, lane_ops.COSINE)


class Node(NamedTuple):
    """One operation."""

    name: str
    """That of its primitive, or `input`, `number`, `inverse`, `part`, or one of `SINES`."""
    operands: tuple[int, ...] = ()
    """Places of other nodes."""
    told: Any = None
    """What else tells it from others: an input's place, a number, a part's place, parameters."""


class Web:
    """Operations by their places, each after those that it needs."""

    def __init__(self, inputs: list[Any]) -> None:
        """Begin with the inputs, which have the first places."""
        self.inputs: list[Any] = []
        self.nodes: list[Node] = []
        self.equations: dict[int, Any] = {}
        """What JAX traced, where it is no arithmetic."""
        self.near: dict[int, int] = {}
        """Per angle another near it, if one is known."""
        self.soon = set[int]()
        """Places that are computed as soon as they can, values too."""
        self._places = dict[Node, int]()
        for value in inputs:
            self._input(value)

    def take(self, jaxpr: Any, consts: Any, arguments: list[int]) -> list[int]:
        """Take in a program whose arguments have places; the places of its results."""
        places: dict[Any, int] = dict(zip(jaxpr.invars, arguments, strict=True))
        places.update(zip(jaxpr.constvars, map(self._input, consts), strict=True))

        def place(var: Any) -> int:
            if not isinstance(var, Literal):
                return places[var]
            return self._at("number", (), (float(var.val), str(var.aval)), var)

        for equation in jaxpr.eqns:
            found = self._equation(equation, [place(var) for var in equation.invars])
            places.update(zip(equation.outvars, found, strict=True))
        return [place(var) for var in jaxpr.outvars]

    def copy(self, other: "Web", place: int, operands: list[int], name: str = "") -> int:
        """Take in an operation of another web.

        Args:
            other: It has the same inputs.
            place: The operation's there.
            operands: Here.
            name: Another than there.
        """
        node = other.nodes[place]
        return self._at(name or node.name, tuple(operands), node.told, other.equations[place])

    def turns(self, results: list[int], values: int) -> dict[int, int]:
        """Per place that results need, their own among them, when it is its turn to be computed.

        JAX traces all tangents after all values, which would have to be kept until then. Here what only tangents need
        comes as soon as it can.

        Args:
            results: Places.
            values: How many of them, from the first on, are values; the others are tangents.
        """
        as_traced, turn = self._reached(results[:values]) - self.soon, dict[int, int]()
        for place in sorted(self._reached(results)):
            before = [turn[each] for each in self.nodes[place].operands]
            turn[place] = max(before) if before and place not in as_traced else place
        return turn

    def needed(self, results: list[int], values: int) -> list[int]:
        """These places in an order in which they can be computed; arguments as for `turns`."""
        turn = self.turns(results, values)
        return sorted(turn, key=lambda place: (turn[place], place))

    def fused(self, order: list[int], results: list[int]) -> dict[int, int]:
        """Sums of numbers that may take a product in themselves, and which; nothing else needs that product.

        Args:
            order: Places that are computed.
            results: Places that are wanted as they are.
        """
        users = Counter([*results, *(operand for place in order for operand in self.nodes[place].operands)])
        found = dict[int, int]()
        for place in order:
            if self.is_arithmetic(place, "add", "sub"):
                for operand in self.nodes[place].operands:
                    if self.is_arithmetic(operand, "mul") and users[operand] == 1:
                        found[place] = operand
        return found

    def is_arithmetic(self, place: int, *names: str) -> bool:
        """Whether it is one of these, of real numbers: of whole ones JAX's own equation is kept."""
        return self.nodes[place].name in names and self.equations[place] is None

    def _reached(self, results: list[int]) -> set[int]:
        """Places that some results need, their own among them."""
        found, stack = set[int](), list(results)
        while stack:
            place = stack.pop()
            if place not in found:
                found.add(place)
                stack += self.nodes[place].operands
                stack += [self.near[each] for each in self.nodes[place].operands if each in self.near]
        return found

    def number(self, place: int) -> float | None:
        """The number that a value is, wherever the program runs; None if it is none."""
        name, operands, told = self.nodes[place]
        if name in ("broadcast_in_dim", "convert_element_type"):
            return self.number(operands[0])
        return float(told[0]) if name == "number" else None

    def equals(self, place: int, number: float) -> bool:
        """Whether a value is this number."""
        return self.number(place) == number

    def _input(self, value: Any) -> int:
        self.inputs.append(value)
        return self._at("input", (), len(self.inputs) - 1)

    def _at(self, name: str, operands: tuple[int, ...], told: Any = None, equation: Any = None) -> int:
        node = Node(name, tuple(sorted(operands)) if name in COMMUTING else operands, told)
        place = self._places.setdefault(node, len(self.nodes))
        if place == len(self.nodes):
            self.nodes.append(node)
            self.equations[place] = equation
        return place

    def _equation(self, equation: Any, operands: list[int]) -> list[int]:
        name, params = equation.primitive.name, equation.params
        inner, called = params.get("jaxpr", params.get("call_jaxpr")), params.get("name")
        if called in SINES:
            return [self._at(called, tuple(operands))]
        if name in CALLS:
            found = self.take(inner.jaxpr, inner.consts, operands)
            if called == lane_ops.NEAR and found[0] != operands[1]:
                self.near[found[0]] = operands[1]
            return found
        if name in ARITHMETIC and params.get("y") != 0 and jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.floating):
            return [self._arithmetic(name, operands, params)]
        # Two programs may read the same and be different ones.
        place = self._at(name, tuple(operands), str(params) if inner is None else id(equation), equation)
        if not equation.primitive.multiple_results:
            return [place]
        return [self._at("part", (place,), i) for i in range(len(equation.outvars))]

    def _arithmetic(self, name: str, operands: list[int], params: Any) -> int:
        if name == "mul":
            return self._product(*operands)
        if name == "div":
            return self._quotient(*operands)
        if name == "integer_pow":
            return self._power(operands[0], params["y"])
        if name in ("add", "add_any"):  # tangents are added by a name of their own
            return self._total(*operands)
        if name in ("sub", "neg") and self.equals(operands[-1], 0.0):
            return operands[0]
        return self._at(name, tuple(operands))

    def _total(self, one: int, other: int) -> int:
        if self.equals(one, 0.0):
            return other
        return one if self.equals(other, 0.0) else self._at("add", (one, other))

    def _power(self, base: int, exponent: int) -> int:
        """A power whose exponent is not 0; the slope of a quotient asks for negative ones."""
        if exponent < 0:
            return self._power(self._at("inverse", (base,)), -exponent)
        if exponent == 1:
            return base
        even = self._power(self._product(base, base), exponent // 2)
        return self._product(even, base) if exponent % 2 else even

    def _product(self, one: int, other: int) -> int:
        for factor, rest in ((one, other), (other, one)):
            if self.equals(factor, 1.0):
                return rest
            if self.equals(factor, 0.0):
                return factor
        return self._at("mul", (one, other))

    def _quotient(self, above: int, below: int) -> int:
        top, bottom = self.nodes[above], self.nodes[below]
        if top.name == bottom.name == "select_n" and top.operands[0] == bottom.operands[0]:
            pairs = list(zip(top.operands[1:], bottom.operands[1:], strict=True))
            ones = [all(self.equals(each, 1.0) for each in pair) for pair in pairs]
            if any(ones):
                chosen = (a if one else self._over(a, b) for one, (a, b) in zip(ones, pairs, strict=True))
                return self._at("select_n", (top.operands[0], *chosen), top.told, self.equations[above])
        return self._over(above, below)

    def _over(self, above: int, below: int) -> int:
        return self._product(above, self._at("inverse", (below,)))
