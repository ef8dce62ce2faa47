"""What the robot side imports: read from its source, then seen by importing it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import deploy

ROOT = Path(deploy.__file__).parent
SOURCES = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.glob("**/*.py"))}
ROBOT = ("numpy", "can", "deploy", "jaxmpc.__version__", "jaxmpc.law", "jaxmpc.sealed", "jaxmpc.errors")
ROBOT = (*ROBOT, "jaxmpc.world.drive")
TWIN = (*ROBOT, "mujoco", "jaxmpc.world")
"""The twin stands in for the metal; it runs on a workstation."""


def imported(source):
    """Dotted names; for `from a import b` it is a.b, be that a module or not."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def foreign(source, name="runtime.py"):
    in_twin = name.startswith("twin/")
    return [
        each
        for each in imported(source)
        if (
            each.partition(".")[0] not in sys.stdlib_module_names
            and not any(each == allowed or each.startswith(f"{allowed}.") for allowed in (TWIN if in_twin else ROBOT))
        )
        or (each.startswith("deploy.twin") and not in_twin)
    ]


@pytest.mark.parametrize("name", SOURCES)
def test_deploy_imports_only_what_the_robot_has(name):
    assert foreign(SOURCES[name].read_text(encoding="utf-8"), name) == []


@pytest.mark.parametrize(
    "line",
    ["import jax", "from jax import numpy", "from jaxmpc import design", "import pickle, scipy", "import mujoco"],
)
def test_the_check_itself_can_fail(line):
    assert foreign(line)


def test_the_robot_knows_no_twin():
    assert foreign("from deploy.twin import twin")
    assert foreign("from deploy.twin import twin\nimport mujoco", "twin/server.py") == []


def test_importing_deploy_and_check_loads_no_simulator():
    dotted = [
        f"deploy.{name.removesuffix('.py').replace('/', '.')}" for name in SOURCES if not name.startswith("twin/")
    ]
    modules = [name.removesuffix(".__init__") for name in dotted]
    code = f"import sys, {', '.join(modules)}, jaxmpc.cli.check\n"
    code += "print([m for m in ('jax', 'equinox', 'optax', 'msgspec', 'mujoco', 'rich', 'scipy') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
