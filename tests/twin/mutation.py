"""Small wrong versions of a module, one change each, to see whether its tests notice."""

import ast
import copy
import sys
import types
from collections.abc import Callable, Iterator
from typing import NamedTuple

COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.GtE), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "sin": "cos", "cos": "sin"}
DROPPED = {"abs", "round", "sqrt"}
"""Calls of one argument that are left out."""


class Mutant(NamedTuple):
    """One change."""

    line: int
    before: str
    after: str
    source: str
    node: int
    """Its place among all nodes of the source."""
    choice: int
    """Which of the node's wrong versions it is."""

    def __str__(self) -> str:
        return f"{self.line}: {self.before} → {self.after}"

    @property
    def tree(self) -> ast.Module:
        """The wrong module."""
        whole = ast.parse(self.source)
        old = list(ast.walk(whole))[self.node]
        new = ast.copy_location(copy.deepcopy(list(_changes(old))[self.choice]), old)
        return ast.fix_missing_locations(_Replace(old, new).visit(whole))


def _changes(node: ast.AST) -> Iterator[ast.AST]:
    """Wrong versions of a node."""
    match node:
        case ast.Compare():
            for i, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    yield ast.Compare(node.left, [*node.ops[:i], other(), *node.ops[i + 1 :]], node.comparators)
            if len(node.ops) == 2:
                yield ast.Compare(node.left, node.ops[:1], node.comparators[:1])
                yield ast.Compare(node.comparators[0], node.ops[1:], node.comparators[1:])
        case ast.BinOp(left, operator, right) if type(operator) in ARITHMETIC:
            yield ast.BinOp(left, ARITHMETIC[type(operator)](), right)
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield operand
        case ast.BoolOp(operator, values):
            yield ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
            for i in range(len(values)):
                rest = [*values[:i], *values[i + 1 :]]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(operator, rest)
        case ast.Call(ast.Name(name), arguments, keywords) if name in CALLS:
            yield ast.Call(ast.Name(CALLS[name], ast.Load()), arguments, keywords)
            if name in ("min", "max") and len(arguments) > 1:
                yield arguments[0]
        case ast.Call(ast.Name(name), [argument], []) if name in DROPPED:
            yield argument
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(float() as value):
            yield ast.Constant(1.25 * value if value else 0.1)
        case ast.IfExp(test, body, orelse):
            yield body
            yield orelse
            del test
        case ast.If(test, body, orelse):
            yield ast.If(ast.Constant(False), body, orelse)
            yield ast.If(ast.Constant(True), body, orelse)
            del test
        case ast.Return(ast.Attribute(ast.Name("Reason"), _)):
            yield ast.Return(ast.Constant(None))
        case ast.AugAssign(target, operator, value) if type(operator) in ARITHMETIC:
            yield ast.AugAssign(target, ARITHMETIC[type(operator)](), value)
        case ast.Continue():
            yield ast.Pass()


def mutants(source: str) -> list[Mutant]:
    """Every one of a module, in the order of its text; annotations, messages and strict= of zip() stay."""
    tree = ast.parse(source)
    skipped = {
        id(part)
        for node in ast.walk(tree)
        for annotation in (getattr(node, "annotation", None), getattr(node, "returns", None))
        if annotation is not None
        for part in ast.walk(annotation)
    } | {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.keyword) and node.arg == "strict"}
    found = [
        Mutant(getattr(node, "lineno", 0), _text(node), _text(change), source, index, choice)
        for index, node in enumerate(ast.walk(tree))
        if id(node) not in skipped
        for choice, change in enumerate(_changes(node))
    ]
    return sorted(found)


class _Replace(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        return self.new if node is self.old else super().visit(node)


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.If):
        return f"if {ast.unparse(node.test)}"
    return ast.unparse(node)


def module_of(name: str, tree: ast.Module) -> types.ModuleType:
    """A mutant as a module of its own; `sys.modules` keeps the right one.

    Raises:
        Exception: Whatever the mutant raises while it is imported; it is caught by that.
    """
    module = types.ModuleType(name)
    kept = sys.modules[name]
    sys.modules[name] = module  # dataclasses and enums look their module up
    try:
        exec(compile(tree, f"<mutant of {name}>", "exec"), module.__dict__)
    finally:
        sys.modules[name] = kept
    return module


def survives(name: str, mutant: Mutant, checks: list[Callable[[types.ModuleType], None]]) -> bool:
    """Whether no check fails on it."""
    try:
        module = module_of(name, mutant.tree)
        for check in checks:
            check(module)
    except (Exception, ExceptionGroup):
        return False
    except BaseException as error:  # pytest.raises fails with an exception that is none
        if type(error).__name__ == "Failed":
            return False
        raise
    return True
