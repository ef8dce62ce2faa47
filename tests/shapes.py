"""The checker of shapes under pytest: annotations of arrays are held at every call, all others cost nothing.

The others are mypy's to hold. Checked at run time they would make the law, plain arithmetic called a million times,
ten times slower, and refuse wrong input before the code that is to explain it sees it.
"""

import ast
from collections.abc import Callable
from typing import Any, get_args

from beartype import BeartypeConf, beartype

from tests.sources import SOURCES, imports, module_of, tree_of

_check = beartype(conf=BeartypeConf(is_pep484_tower=True))


def with_shapes() -> list[str]:
    """Modules of the product that annotate arrays."""

    def annotates(tree: ast.Module) -> bool:
        return any(each.name.startswith("jaxtyping.") for each in imports(tree))

    return [module_of(path) for path in SOURCES if annotates(tree_of(path))]


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with its shapes checked."""
    shaped = {name: hint for name, hint in function.__annotations__.items() if _shaped(hint)}
    if not shaped:
        return function
    function.__annotations__ = shaped
    held: Callable[..., Any] = _check(function)
    return held


def _shaped(hint: Any) -> bool:
    return hasattr(hint, "dim_str") or any(map(_shaped, get_args(hint)))
