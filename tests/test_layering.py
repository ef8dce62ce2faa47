"""Who may import whom, and what must never be called: read from the source, then checked by running it."""

import ast
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.sources import ROOT, SOURCES, Import, imports, module_of, within

# Modules of jaxmpc that the robot loads too.
ON_ROBOT = (
    "jaxmpc.__version__",
    "jaxmpc.files.errors",
    "jaxmpc.files.foreign",
    "jaxmpc.files.outputs",
    "jaxmpc.law",
    "jaxmpc.files.sealed",
    "jaxmpc.terminal.layout",
    "jaxmpc.quantities",
)
ROBOT_MAY_IMPORT = ("can", "numpy", *ON_ROBOT)
# What the twin needs besides; it runs beside the robot's programs, never in them.
ON_TWIN = (
    "jaxmpc.world.arm",
    "jaxmpc.world.contact",
    "jaxmpc.world.friction",
    "jaxmpc.world.quantise",
    "jaxmpc.world.sensor",
    "jaxmpc.world.tissue",
)
TWIN_MAY_IMPORT = (
    "mujoco",
    "msgspec",
    "jaxmpc.experiment.tables",
    "jaxmpc.files.toml",
    "jaxmpc.world.heart.motion",
    *ON_TWIN,
)
# Connects design and simulation to the robot's checks, for the verb and for the tuner.
FREEZING = "jaxmpc.export.freezing"
STRAIGHTLINE = "deploy/runtime/straightline.py"
UNSAFE_MODULES = ("marshal", "pickle", "shelve", "yaml")
JAX = {"equinox", "jax", "jaxlib", "jaxtyping", "optax"}


def refusal(path: str, found: Import) -> str | None:
    """Why this file must not import that, or None."""
    name, module = found.name, module_of(path)
    standard = name.partition(".")[0] in sys.stdlib_module_names
    if name.startswith("."):
        return "imports are absolute"
    if within(name, UNSAFE_MODULES):
        return "it can run foreign code"
    if within(module, ("jaxmpc.law",)):
        # The functions of plain floats stand there, once for everybody.
        floats = ("math",) if module == "jaxmpc.law.ops" else ()
        allowed = within(name, ("typing", "collections.abc", "jaxmpc.law", *floats))
        return None if allowed else "the law is arithmetic only"
    if within(module, ("deploy.twin",)):
        allowed = standard or within(name, ("deploy", *ROBOT_MAY_IMPORT, *TWIN_MAY_IMPORT))
        return None if allowed else "the twin needs only mujoco and the tables of an experiment besides"
    if within(module, ("deploy",)):
        if within(name, ("deploy.twin",)) and not (found.deferred and within(module, ("deploy.cli",))):
            return "the robot has no twin"
        # Behind an extra, for who signs or wants a signature; nothing else loads it.
        signing = found.deferred and module == "deploy.controller.signature" and within(name, ("cryptography",))
        allowed = standard or signing or within(name, ("deploy", *ROBOT_MAY_IMPORT))
        return None if allowed else "the robot has only numpy and python-can"
    if within(module, ON_ROBOT) and not found.deferred and not (standard or within(name, ROBOT_MAY_IMPORT)):
        return "the robot loads this module"
    if within(module, ON_TWIN) and not found.deferred:
        allowed = standard or within(name, (*ROBOT_MAY_IMPORT, *TWIN_MAY_IMPORT))
        return None if allowed else "the twin loads this module"
    if module == FREEZING and within(name, ("deploy.controller",)):
        return None
    if module.startswith("jaxmpc") and not within(module, ("jaxmpc.cli",)):
        above = within(name, ("sweeps", "tuning", "deploy", "jaxmpc.cli"))
        return "jaxmpc is below it" if above and module != "jaxmpc.__main__" else None
    if within(module, ("sweeps", "tuning")):
        others = {"sweeps", "tuning", "deploy", "jaxmpc.cli"} - {module.partition(".")[0]}
        return "it stands beside or above" if within(name, tuple(others)) else None
    return None


def unsafe_calls(path: str, tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Calls that would run text, start a shell or unpickle; `STRAIGHTLINE` executes what it has itself written."""
    banned = {"eval"} if path == STRAIGHTLINE else {"eval", "exec", "compile", "__import__"}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name) and node.func.id in banned:
            yield node.lineno, f"{node.func.id}()"
        for keyword in node.keywords:
            if keyword.arg in ("shell", "allow_pickle") and getattr(keyword.value, "value", None) is not False:
                yield node.lineno, f"{keyword.arg}="


def violations(path: str, source: str) -> list[str]:
    tree = ast.parse(source)
    wrong = [f"{path}:{i.line} imports {i.name}: {why}" for i in imports(tree) if (why := refusal(path, i))]
    return wrong + [f"{path}:{line} calls {call}" for line, call in unsafe_calls(path, tree)]


@pytest.mark.parametrize("path", SOURCES)
def test_source_keeps_to_its_layer(path: str) -> None:
    assert violations(path, (ROOT / path).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("jaxmpc/law/cascade.py", "import math"),
        ("jaxmpc/law/cascade.py", "from jaxmpc.files.errors import InputError"),
        ("deploy/runtime/linear.py", "def load():\n    import jax"),
        ("deploy/runtime/linear.py", "import jaxmpc"),
        ("deploy/runtime/linear.py", "from jaxmpc import design"),
        ("deploy/runtime/linear.py", "from jaxmpc.world import heart"),
        ("deploy/safety/clamp.py", "from jaxmpc.world.drive import angle_lsb"),
        ("deploy/runtime/linear.py", "import mujoco"),
        ("deploy/loop/loop.py", "from deploy.twin import world"),
        ("deploy/twin/world.py", "import jax"),
        ("deploy/twin/world.py", "from jaxmpc.world import motion"),
        ("deploy/runtime/linear.py", "from . import record"),
        ("deploy/runtime/linear.py", "exec('1')"),
        ("deploy/runtime/straightline.py", "eval('1')"),
        ("jaxmpc/world/contact.py", "import jax.numpy as jnp"),
        ("jaxmpc/world/contact.py", "if True:\n    import jax"),
        ("jaxmpc/files/sealed.py", "from jaxmpc.synthesis.params import Params"),
        ("jaxmpc/files/sealed.py", "numpy.load('f', allow_pickle=True)"),
        ("jaxmpc/synthesis/params.py", "class A:\n    def f(self):\n        from tuning import tune"),
        ("jaxmpc/evaluation.py", "import sweeps.run"),
        ("jaxmpc/export/freezing.py", "from deploy.loop import session"),
        ("jaxmpc/export/golden.py", "from deploy.controller.limits import Limits"),
        ("sweeps/run.py", "import tuning"),
        ("sweeps/run.py", "from jaxmpc.cli import main"),
        ("tuning/search/optimise.py", "from deploy.runtime.linear import Runtime"),
        ("sweeps/store.py", "import pickle"),
        ("sweeps/store.py", "from yaml import safe_load"),
        ("sweeps/store.py", "subprocess.run('ls', shell=True)"),
    ],
)
def test_a_wrong_source_is_refused(path: str, source: str) -> None:
    assert len(violations(path, source)) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("jaxmpc/law/cascade.py", "from jaxmpc.law import scalar\nfrom collections.abc import Sequence"),
        (
            "deploy/runtime/linear.py",
            "import numpy, can, json\nfrom deploy import record\nfrom jaxmpc.files.sealed import unseal",
        ),
        ("deploy/runtime/straightline.py", "exec(compile('1', '', 'exec'))"),
        ("jaxmpc/world/contact.py", "def f():\n    import jax"),
        ("sweeps/cli.py", "from sweeps.run import run"),
        ("sweeps/store.py", "import re\nre.compile('a')\nnp.load('f', allow_pickle=False)"),
    ],
)
def test_a_right_source_passes(path: str, source: str) -> None:
    assert violations(path, source) == []


def loaded(*arguments: str) -> set[str]:
    """Top-level names of everything that a fresh Python imports."""
    run = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True, cwd=ROOT
    )
    lines = [line for line in run.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}


def import_all(*prefixes: str) -> str:
    return "import " + ", ".join(m for m in map(module_of, SOURCES) if within(m, prefixes))


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(["-c", "import jaxmpc"], id="jaxmpc"),
        pytest.param(["-c", import_all("deploy")], id="deploy"),
        pytest.param(["-c", import_all(*ON_ROBOT)], id="shared"),
        pytest.param(["-m", "jaxmpc", "--help"], id="help"),
    ],
)
def test_no_jax_is_loaded(arguments: list[str]) -> None:
    assert loaded(*arguments).isdisjoint(JAX)


def test_a_loaded_jax_would_be_seen() -> None:
    assert loaded("-c", "import jaxmpc; jaxmpc.Params") >= {"jax", "equinox"}
