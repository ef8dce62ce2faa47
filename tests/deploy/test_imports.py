import ast
import subprocess
import sys
from pathlib import Path

import pytest

import deploy

SOURCES = sorted(Path(deploy.__file__).parent.glob("*.py"))
ALLOWED = {"numpy", "deploy", "jaxmpc.law", "jaxmpc.sealed", "jaxmpc.errors"}


def imported(source):
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield node.module
            if node.module == "jaxmpc":
                yield from (f"jaxmpc.{alias.name}" for alias in node.names)


def foreign(source):
    return [
        name
        for name in imported(source)
        if name.partition(".")[0] not in sys.stdlib_module_names
        and not any(name == allowed or name.startswith(f"{allowed}.") for allowed in ALLOWED)
    ]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_deploy_imports_only_what_the_robot_has(path):
    assert foreign(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "line", ["import jax", "from jax import numpy", "from jaxmpc import design", "import pickle, scipy"]
)
def test_the_check_itself_can_fail(line):
    assert foreign(line)


def test_importing_deploy_and_check_loads_no_simulator():
    modules = [f"deploy.{path.stem}" for path in SOURCES if path.stem != "__init__"]
    code = f"import sys, {', '.join(modules)}, jaxmpc.cli.check\n"
    code += "print([m for m in ('jax', 'equinox', 'optax', 'msgspec', 'rich', 'scipy') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
