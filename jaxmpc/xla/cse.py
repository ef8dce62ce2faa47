"""Values that are used more than once, computed once.

XLA on a CPU copies a cheap operation into every fusion that needs it, and the dynamics of a robot is a web of cheap
operations that all need each other: left alone, 10 300 of them are executed for a step of 2 700. Only what counts
as expensive is kept and shared, and a quotient does. So values worth sharing are divided by a one that the
compiler cannot see through, which is exact.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

# JAX promises nothing of these, but nothing else takes a traced program apart; tests/jaxmpc/test_cse.py runs it.
from jax.extend.core import Jaxpr, Literal, jaxpr_as_fun

COPIED = 25
"""Operations that may be copied rather than shared: below, memory costs more than arithmetic (measured)."""
CHEAP = {"abs", "add", "add_any", "ge", "gt", "le", "lt", "max", "min", "mul", "neg", "select_n", "sign", "sub"}
"""Primitives that XLA copies."""


def sharing(function: Callable[..., Any], one: Any) -> Callable[..., Any]:
    """The same function of scalars, with its intermediate values shared.

    Args:
        function: Traceable, of array leaves alone.
        one: A scalar 1 that is no constant of the program.
    """

    def run(*arguments: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        leaves = _evaluate(closed, jax.tree.leaves(arguments), one)
        return jax.tree.unflatten(jax.tree.structure(shape), leaves)

    return run


def _evaluate(closed: Any, arguments: Any, one: Any) -> list[Any]:
    """Run a program operation by operation, sharing what is used twice and took more than `COPIED` of them."""
    jaxpr = closed.jaxpr
    uses: dict[Any, int] = {}
    for consumer in (*(equation.invars for equation in jaxpr.eqns), jaxpr.outvars):
        for var in consumer:
            if not isinstance(var, Literal):
                uses[var] = uses.get(var, 0) + 1
    values: dict[Any, Any] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*closed.consts, *arguments), strict=True))
    cost: dict[Any, int] = {}

    def value_of(var: Any) -> Any:
        return var.val if isinstance(var, Literal) else values[var]

    for equation in jaxpr.eqns:
        inputs = [var for var in equation.invars if not isinstance(var, Literal)]
        cheap = equation.primitive.name in CHEAP
        total = 1 + sum(cost.get(var, 0) for var in inputs) if cheap else 0
        for var, value in zip(equation.outvars, bind(closed, equation, value_of), strict=True):
            values[var], cost[var] = value, total
            if total > COPIED and uses.get(var, 0) > 1 and jnp.issubdtype(value.dtype, jnp.floating):
                values[var], cost[var] = value / one.astype(value.dtype), 0
    return [value_of(var) for var in jaxpr.outvars]


def bind(closed: Any, equation: Any, value_of: Callable[[Any], Any]) -> list[Any]:
    """One operation; by JAX's own evaluator if it holds a program, whose form is JAX's affair."""
    if any(isinstance(value, Jaxpr | type(closed)) for value in equation.params.values()):
        names = list(dict.fromkeys(var for var in equation.invars if not isinstance(var, Literal)))
        about = closed.jaxpr.debug_info.with_unknown_names()
        alone = Jaxpr((), names, equation.outvars, [equation], closed.jaxpr.effects, debug_info=about)
        return list(jaxpr_as_fun(closed.replace(jaxpr=alone, consts=[]))(*map(value_of, names)))
    found = equation.primitive.bind(*map(value_of, equation.invars), **equation.params)
    return list(found) if equation.primitive.multiple_results else [found]
