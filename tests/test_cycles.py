"""No import cycle between files or between folders; imports for types and deferred ones count like all others."""

import ast
from collections.abc import Iterable, Mapping

import pytest

from tests.sources import SOURCES, imports, module_of, tree_of

Graph = Mapping[str, set[str]]


def file_graph(trees: Mapping[str, ast.Module]) -> dict[str, set[str]]:
    """Which module imports which: those alone that are among the sources."""
    known = {module_of(path) for path in trees}

    def module(name: str) -> str:
        return name if name in known else name.rpartition(".")[0]

    return {
        module_of(path): {module(each.name) for each in imports(tree)} & known - {module_of(path)}
        for path, tree in trees.items()
    }


def folder_graph(files: Graph, packages: Iterable[str]) -> dict[str, set[str]]:
    """Which folder imports which; a file of a package's root stands for itself, and so does an `__init__`."""
    inits = set(packages)

    def folder(module: str) -> str:
        above = module if module in inits else module.rpartition(".")[0]
        return above if "." in above else module

    graph: dict[str, set[str]] = {}
    for module, imported in files.items():
        graph.setdefault(folder(module), set()).update(map(folder, imported))
    return {node: others - {node} for node, others in graph.items()}


def cycles(graph: Graph) -> list[list[str]]:
    """Groups whose members reach each other."""

    def reached(start: str) -> set[str]:
        found: set[str] = set()
        waiting = [start]
        while waiting:
            new = graph.get(waiting.pop(), set()) - found
            found |= new
            waiting += new
        return found

    reach = {node: reached(node) for node in graph}
    groups = {frozenset(other for other in reach[node] if node in reach.get(other, ())) for node in graph}
    return sorted(sorted(group) for group in groups if group)


FILES = file_graph({path: tree_of(path) for path in SOURCES})
FOLDERS = folder_graph(FILES, (module_of(path) for path in SOURCES if path.endswith("/__init__.py")))


def test_no_files_import_each_other() -> None:
    assert cycles(FILES) == []


def test_no_folders_import_each_other() -> None:
    assert cycles(FOLDERS) == []


def test_the_graphs_hold_the_imports() -> None:
    assert "jaxmpc.law.scalar" in FILES["jaxmpc.law.chain"]
    assert "jaxmpc.law" in FOLDERS["jaxmpc.world"]
    assert "deploy.controller" in FOLDERS["deploy.cli"]


@pytest.mark.parametrize(
    ("back", "between_files", "between_folders"),
    [
        ("import p.one.a", True, True),
        ("from p.one import a", True, True),
        ("from p.one.a import f", True, True),
        ("if TYPE_CHECKING:\n    from p.one.a import f", True, True),
        ("def g():\n    from p.one.a import f", True, True),
        # By way of another file of the folder: no two files import each other, but the folders do.
        ("from p.one.other import f", False, True),
        ("import os", False, False),
    ],
)
def test_a_cycle_is_seen(back: str, between_files: bool, between_folders: bool) -> None:
    sources = {
        "p/__init__.py": "",
        "p/one/__init__.py": "",
        "p/one/a.py": "from p.two import b",
        "p/one/other.py": "",
        "p/two/__init__.py": "",
        "p/two/b.py": back,
    }
    files = file_graph({path: ast.parse(source) for path, source in sources.items()})
    folders = folder_graph(files, ("p", "p.one", "p.two"))
    assert cycles(files) == ([["p.one.a", "p.two.b"]] if between_files else [])
    assert cycles(folders) == ([["p.one", "p.two"]] if between_folders else [])
