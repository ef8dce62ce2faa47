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
    "checker": ("test_checker_torques", "test_checker_state"),
    "clamp": ("test_clamp",),
    "plausible": ("test_plausible",),
    "kinematics": ("test_safety_kinematics",),
    "least_rate": ("test_least_rate",),
}
ELSEWHERE = {"least_rate": "deploy.controller.least_rate"}
PLACE = "only holds a place"
ROUNDING = "both sides of that bound are refused or allowed alike, up to 1e-8 of it"
WHOLE = "with a share of 1 the way to the torque is gone at once, so that nothing changes"
FAR = "insurance: a rate cuts the way short only where a joint moves far, off the strip that rounding takes"
TAIL = "more or fewer terms of a sum that are smaller than 1e-9"
UNREACHED = "overwritten before it is read"
BEYOND = "8191 and 8192 units are beyond every motor's limit, whatever their sign"
SHRINK = "shrink = min(_share(last2, last3, within), most2 / max(abs(last2), most2), most3 / max(abs(last3), most3))"
EQUIVALENT = {
    "kinematics": {
        "length = 0.0 | 0.0 → 0.1": "both are refused",
        "@lru_cache(maxsize=4) | 4 → 5": "tools that are remembered",
        "return compile_straightline(lambda q, qd: _motion(length, q, qd), ((0.0,) * 4, (0.0,) * 4)).function"
        " | 0.0 → 0.1": PLACE,
    },
    "clamp": {
        "if share < 1.0: | 1.0 → 1.25": WHOLE,
        "if share < 1.0: | if share < 1.0 → if True": WHOLE,
        "if share < 1.0: | share < 1.0 → share <= 1.0": WHOLE,
        "share = 1.0 | 1.0 → 1.25": "a share above 1 is nowhere used",
        "if needs2 > within.motor2: | needs2 > within.motor2 → needs2 >= within.motor2": WHOLE,
        "if needs3 * share > within.motor3: | needs3 * share > within.motor3 → needs3 * share >= within.motor3": WHOLE,
        f"{SHRINK} | abs(last2) → last2": FAR,
        f"{SHRINK} | abs(last3) → last3": FAR,
        f"{SHRINK} | {SHRINK[9:]} → _share(last2, last3, within)": FAR,
        f"{SHRINK} | most2 / max(abs(last2), most2) → most2 * max(abs(last2), most2)": FAR,
        f"{SHRINK} | most3 / max(abs(last3), most3) → most3 * max(abs(last3), most3)": FAR,
        "part2 = go2 / (t2 - start2) if t2 != start2 else 1.0 | 1.0 → 1.25": "the other one is at most 1",
        "part3 = go3 / (t3 - start3) if t3 != start3 else 1.0 | 1.0 → 1.25": "the other one is at most 1",
    },
    "least_rate": {
        "least = (each + shrink * most + 4.0 * SLACK) / T_s | 4.0 → 5.0": ROUNDING,
        "least = (each + shrink * most + 4.0 * SLACK) / T_s"
        " | each + shrink * most + 4.0 * SLACK → each + shrink * most - 4.0 * SLACK": ROUNDING,
        "if rate < least: | rate < least → rate <= least": ROUNDING,
    },
    "plausible": {
        "equal: int = 1 | 1 → 2": UNREACHED,
        "repeated: int = 0 | 0 → 1": "the first sample takes one away, and not below 0",
        "age: tuple[int, int, int, int] = (0, 0, 0, 0) | 0 → 1": UNREACHED,
        "state: EncoderState, counts: Sequence[int | None], counts_per_turn: Sequence[int], T_s: float, "
        "unmoved: int = -1 | 1 → 2": "no motor has that number either",
        "reach = int(6.0 / step) + 2 | 2 → 3": TAIL,
        "reach = int(6.0 / step) + 2 | 6.0 → 7.5": TAIL,
        "reach = int(6.0 / step) + 2 | 6.0 / step → 6.0 * step": TAIL,
        "edges = [erf((count - 0.5) * step) for count in range(-reach, reach + 1)] | 1 → 2": TAIL,
        "edges = [erf((count - 0.5) * step) for count in range(-reach, reach + 1)] | count - 0.5 → count + 0.5": TAIL,
        "edges = [erf((count - 0.5) * step) for count in range(-reach, reach + 1)] | reach + 1 → reach - 1": TAIL,
    },
    "checker": {
        "motors.append((value - 0x4000 if value > 0x1FFF else value) * lsb) | 8191 → 8192": BEYOND,
        "motors.append((value - 0x4000 if value > 0x1FFF else value) * lsb) | value > 8191 → value >= 8191": BEYOND,
    },
}
"""What behaves like the original, as `line of source | before → after`, and why."""


def module_of(name):
    return ELSEWHERE.get(name, f"deploy.safety.{name}")


def checks_of(name):
    """The tests that take that module, the quickest to fail first by their order."""
    tests = [vars(load(HERE.parent / "deploy" / f"{file}.py")) for file in TESTS[name]]
    functions = [value for file in tests for key, value in file.items() if key.startswith("test_")]
    return [function for function in functions if list(inspect.signature(function).parameters) == [name]]


def mutants_of(name):
    """Each with what it is called in `EQUIVALENT`."""
    source = Path(import_module(module_of(name)).__file__).read_text(encoding="utf-8")
    lines = source.splitlines()
    return [
        (f"{lines[each.line - 1].strip()} | {each.before} → {each.after}", each) for each in mutation.mutants(source)
    ]


def survivors(name, chosen):
    checks = checks_of(name)
    return [
        f"{each.line}: {title}"
        for title, each in chosen
        if title not in EQUIVALENT[name] and mutation.survives(module_of(name), each, checks)
    ]


@pytest.mark.oracle
@pytest.mark.parametrize("name", TESTS)
def test_the_right_module_passes_and_a_sample_of_mutants_does_not(name):
    right = import_module(module_of(name))
    for check in checks_of(name):
        check(right)
    all_of_them = mutants_of(name)
    assert len(all_of_them) >= 25
    chosen = np.random.default_rng(12).choice(len(all_of_them), 25, replace=False)
    assert survivors(name, [all_of_them[i] for i in chosen]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTS)
def test_every_mutant_is_noticed(name):
    assert survivors(name, mutants_of(name)) == []


@pytest.mark.parametrize("name", TESTS)
def test_the_list_of_equivalent_ones_holds_nothing_else(name):
    known = {title for title, _ in mutants_of(name)}
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
