"""The boundary tests of the safety layer must notice every small mistake in it."""

import importlib.util
import inspect
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent


def load(path):
    spec = importlib.util.spec_from_file_location(f"{path.stem}_for_mutants", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


mutation = load(HERE / "mutation.py")
TESTS = {
    "checker": "test_checker",
    "clamp": "test_clamp",
    "plausible": "test_plausible",
    "kinematics": "test_safety_kinematics",
}
EQUIVALENT = {name: {} for name in TESTS}
"""What behaves like the original, as `before → after`, and why."""


def checks_of(name):
    """The tests that take that module, the quickest to fail first by their order."""
    tests = load(HERE.parent / "deploy" / f"{TESTS[name]}.py")
    functions = [value for key, value in vars(tests).items() if key.startswith("test_")]
    return [function for function in functions if list(inspect.signature(function).parameters) == [name]]


def mutants_of(name):
    source = Path(import_module(f"deploy.safety.{name}").__file__).read_text(encoding="utf-8")
    return mutation.mutants(source)


def survivors(name, chosen):
    checks = checks_of(name)
    alive = [each for each in chosen if mutation.survives(f"deploy.safety.{name}", each, checks)]
    return [str(each) for each in alive if f"{each.before} → {each.after}" not in EQUIVALENT[name]]


@pytest.mark.parametrize("name", TESTS)
def test_the_right_module_passes_and_a_sample_of_mutants_does_not(name):
    right = import_module(f"deploy.safety.{name}")
    for check in checks_of(name):
        check(right)
    all_of_them = mutants_of(name)
    assert len(all_of_them) > 30
    chosen = np.random.default_rng(12).choice(len(all_of_them), 20, replace=False)
    assert survivors(name, [all_of_them[i] for i in chosen]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTS)
def test_every_mutant_is_noticed(name):
    assert survivors(name, mutants_of(name)) == []


@pytest.mark.parametrize("name", TESTS)
def test_the_list_of_equivalent_ones_holds_nothing_else(name):
    known = {f"{each.before} → {each.after}" for each in mutants_of(name)}
    assert set(EQUIVALENT[name]) <= known


def test_mutants_are_what_they_say():
    source = (
        "def f(x: int = 2) -> bool:\n    if x < 1 and x > 0:\n        return min(x, 3) - 1 == -x\n    return False\n"
    )
    found = {str(each) for each in mutation.mutants(source)}
    for expected in (
        "2: x < 1 → x <= 1",
        "2: x < 1 → x > 1",
        "2: x < 1 and x > 0 → x < 1 or x > 0",
        "2: x < 1 and x > 0 → x > 0",
        "2: if x < 1 and x > 0 → if False",
        "3: min(x, 3) → max(x, 3)",
        "3: min(x, 3) → x",
        "3: min(x, 3) - 1 → min(x, 3) + 1",
        "3: -x → x",
        "4: False → True",
    ):
        assert expected in found
    module = mutation.mutants("def f(x):\n    return x < 1\n")[0]
    assert ast_value(module.tree, 1) is True


def ast_value(tree, x):
    namespace = {}
    exec(compile(tree, "<mutant>", "exec"), namespace)
    return namespace["f"](x)
