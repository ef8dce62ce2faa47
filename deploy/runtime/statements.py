"""Python text of recorded operations.

What Python takes for such a function is less its arithmetic than its names: the number behind each is allocated, stored
and kept to the end. So what is used once stands where it is used, and a name is free again after its last use, an
input's and an argument's too: half of the time.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from deploy.runtime.operand import Operand

DEEPEST = 40
"""Parentheses within each other, of the 200 that Python reads."""


class _Formula(NamedTuple):
    text: str
    reads: tuple[str, ...]
    """Results that it names, each as often as it does."""
    depth: int


def statements(results: Iterable[Operand], output: Any, free: Iterable[str] = ()) -> list[str]:
    """Assignments and the return of a function.

    Args:
        results: Of all operations that are needed, each after its arguments.
        output: Nested operands and constants.
        free: Names that are free from the beginning.
    """
    results = list(results)
    uses = Counter(each.name for result in results for each in result.arguments if isinstance(each, Operand))
    kept = _operands(output)
    names: dict[str, str] = {}
    unnamed: dict[str, _Formula] = {}
    free, lines = list(free), []
    for result in results:
        formula = _formula(result, names, unnamed)
        if uses[result.name] == 1 and result.name not in kept and formula.depth < DEEPEST:
            unnamed[result.name] = formula
            continue
        uses.subtract(formula.reads)
        free += [names.get(each, each) for each in sorted(set(formula.reads) - kept) if not uses[each]]
        names[result.name] = free.pop() if free else result.name
        lines.append(f"{names[result.name]} = {formula.text}")
    return [*lines, f"return {text(output, names)}"]


def text(tree: Any, names: Mapping[str, str], none: str = "None") -> str:
    """Nested operands, which may have other names, and constants; repr of a float is exact."""
    if isinstance(tree, tuple):
        return f"({''.join(f'{text(child, names, none)}, ' for child in tree)})"
    return none if tree is None else names.get(tree.name, tree.name) if isinstance(tree, Operand) else repr(tree)


def _formula(result: Operand, names: Mapping[str, str], unnamed: dict[str, _Formula]) -> _Formula:
    """An operation on what has a name and on what has none, which stands in parentheses and is taken from `unnamed`."""
    parts: list[str] = []
    reads: list[str] = []
    depth = 0
    for each in result.arguments:
        part = unnamed.pop(each.name, None) if isinstance(each, Operand) else None
        if part is None:
            parts.append(text(each, names))
            reads += [each.name] if isinstance(each, Operand) else []
        else:
            parts.append(f"({part.text})")
            reads += part.reads
            depth = max(depth, 1 + part.depth)
    return _Formula(result.form.format(*parts), tuple(reads), depth)


def _operands(tree: Any) -> set[str]:
    """Names of all operands in a nesting."""
    if isinstance(tree, tuple):
        return set().union(*map(_operands, tree))
    return {tree.name} if isinstance(tree, Operand) else set()
