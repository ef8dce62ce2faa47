"""The sources of the four packages, read and never run: which modules there are and what each imports."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxmpc", "tuning", "sweeps", "deploy")
SOURCES = sorted(path.relative_to(ROOT).as_posix() for name in PACKAGES for path in ROOT.glob(f"{name}/**/*.py"))


class Import(NamedTuple):
    line: int
    name: str
    """Dotted; for `from a import b` it is a.b, be that a module or not."""
    deferred: bool
    """Inside a function: it happens only when that runs."""
    alias: str | None


def imports(tree: ast.AST, deferred: bool = False) -> Iterator[Import]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (Import(node.lineno, each.name, deferred, each.asname) for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = "." * node.level + (node.module or "")
            yield from (Import(node.lineno, f"{parent}.{each.name}", deferred, each.asname) for each in node.names)
        else:
            yield from imports(node, deferred or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda))


def within(name: str, modules: tuple[str, ...]) -> bool:
    return any(name == module or name.startswith(f"{module}.") for module in modules)


def module_of(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@cache
def tree_of(path: str) -> ast.Module:
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))
