"""What is called how: a class name stands for one thing, a module keeps its name, a docstring names what it describes.

That there is a docstring, and that its first line is a sentence, is ruff's to say.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping

import pytest

from tests.sources import SOURCES, imports, module_of, tree_of

TREES = {path: tree_of(path) for path in SOURCES}
MODULES = {module_of(path) for path in SOURCES}


def repeated_classes(trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    found = defaultdict(list)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(path)
    return {name: paths for name, paths in found.items() if len(paths) > 1}


def aliases(path: str, tree: ast.Module) -> list[str]:
    return [
        f"{path}:{each.line} {each.name} as {each.alias}"
        for each in imports(tree)
        if each.alias is not None and each.name in MODULES
    ]


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring: of a module, a class, a function, a field or a constant."""
    for node in ast.walk(tree):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                if isinstance(child.value.value, str):
                    yield child.lineno, child.value.value


def nameless(tree: ast.Module) -> list[int]:
    """Lines of the docstrings that begin with "Of", and so cannot be read alone."""
    return [line for line, text in docstrings(tree) if text.split()[:1] in ([], ["Of"])]


def test_no_two_classes_have_one_name() -> None:
    assert repeated_classes(TREES) == {}


@pytest.mark.parametrize("path", SOURCES)
def test_names_and_sentences(path: str) -> None:
    tree = TREES[path]
    assert aliases(path, tree) == []
    assert nameless(tree) == []


def test_a_repeated_class_would_be_seen() -> None:
    trees = {"a.py": ast.parse("class State: ..."), "b.py": ast.parse("def f():\n    class State: ...")}
    assert repeated_classes(trees) == {"State": ["a.py", "b.py"]}


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("from deploy.safety import clamp as limiter", 1),
        ("def f():\n    import sweeps.run as sweep", 1),
        ("from sweeps.run import run as sweep", 0),
        ("import numpy as np\nfrom deploy.safety import clamp", 0),
    ],
)
def test_an_alias_would_be_seen(source: str, count: int) -> None:
    assert len(aliases("a.py", ast.parse(source))) == count


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("Of the joints [rad].", [4]),
        ("Angles of the joints [rad].", []),
        ("Often right.", []),
        ("[rad]", []),
        ("", [4]),
    ],
)
def test_a_nameless_docstring_would_be_seen(text: str, lines: list[int]) -> None:
    assert nameless(ast.parse(f'class A:\n    """Joints."""\n    x: int\n    """{text}"""')) == lines
