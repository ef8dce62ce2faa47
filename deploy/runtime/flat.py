"""A nesting of numbers as one flat tuple.

A tick unpacks what the controller remembers and builds it anew. Every tuple within a tuple costs an object: a family
has a hundred of them, which is 2.5 µs of a tick of 60.
"""

from collections.abc import Iterable
from typing import Any

from deploy.runtime.straightline import map_leaves


def flat(tree: Any) -> tuple[Any, ...]:
    """All numbers of a nesting in their order."""
    leaves: list[Any] = []
    map_leaves(leaves.append, tree)
    return tuple(leaves)


def nested(like: Any, numbers: Iterable[Any]) -> Any:
    """Numbers in their order, in the nesting of another; `flat` undone."""
    following = iter(numbers)
    return map_leaves(lambda _: next(following), like)


def places(tree: Any) -> Any:
    """Where in `flat` each number of a nesting is found, in that nesting."""
    return nested(tree, range(len(flat(tree))))
