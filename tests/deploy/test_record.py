import math
import random
import struct
from typing import NamedTuple

import numpy as np
import pytest

from deploy.runtime.straightline import FUNCTIONS, OPS, compile_straightline
from jaxmpc.law.ops import FLOATS


class Pair(NamedTuple):
    first: object
    second: object


def bits(value):
    return struct.pack("<d", value)


def random_program(draw, n_inputs, n_steps):
    """A function that applies the same random operations to whatever numbers it is given."""
    steps = []
    for size in range(n_inputs, n_inputs + n_steps):
        constant = draw.choice([draw.uniform(-3, 3), 2, -0.5, 1e-3])
        steps.append((draw.choice("+-*/nc"), draw.randrange(size), draw.randrange(size), draw.choice("lr"), constant))

    def program(*inputs):
        values = list(inputs)
        for kind, i, j, side, constant in steps:
            a = values[i]
            b = constant if kind == "c" else values[j]
            if kind == "n":
                values.append(-a)
            elif kind == "c":
                values.append([a + b, b + a, a - b, b - a, a * b, b * a, a / b, b / a][int(4 * abs(b)) % 8])
            else:
                left, right = (a, b) if side == "l" else (b, a)
                values.append(
                    {"+": left.__add__, "-": left.__sub__, "*": left.__mul__, "/": left.__truediv__}[kind](right)
                )
        return tuple(values[-4:])

    return program


@pytest.mark.parametrize("seed", range(200))
def test_recording_gives_the_bits_of_the_source(seed):
    draw = random.Random(seed)
    program = random_program(draw, 3, 25)
    recorded = compile_straightline(program, (0.0, 0.0, 0.0))
    for _ in range(5):
        inputs = [draw.uniform(0.5, 2.0) * draw.choice([-1, 1]) for _ in range(3)]
        try:
            expected = program(*inputs)
        except ZeroDivisionError:
            continue
        if all(map(math.isfinite, expected)):
            assert list(map(bits, recorded.function(*inputs))) == list(map(bits, expected))


def test_order_of_operations_is_kept():
    recorded = compile_straightline(lambda a, b, c: ((a + b) + c, a + (b + c)), (0.0, 0.0, 0.0))
    assert recorded.function(1e16, -1e16, 1.0) == (1.0, 0.0)


def test_law_on_operands_equals_law_on_floats(law):
    from jaxmpc.law import cascade

    recorded = compile_straightline(lambda *a: cascade.step(law.gains, *a), (cascade.init(law.gains), 0.0, (0.0,) * 64))
    draw = random.Random(3)
    for _ in range(200):
        state = cascade.AxisState(tuple(draw.gauss(0, 1) for _ in range(3)), *(draw.gauss(0, 1) for _ in range(3)))
        y, wanted = draw.gauss(0, 1), [draw.gauss(0, 1) for _ in range(64)]
        assert recorded.function(state, y, wanted) == cascade.step(law.gains, state, y, wanted)


def test_identities_fold():
    def idle(x):
        opposite = -x
        return x * 1 + 0.0 * x, 1.0 * x - 0, 0 + x / 1, -opposite, x * 0.0, (0.0 + x) * 0 + 2.5

    recorded = compile_straightline(idle, (0.0,))
    assert recorded.operations == 0
    assert recorded.function(7.0) == (7.0, 7.0, 7.0, 7.0, 0.0, 2.5)


def test_signs_move_to_the_sums_that_take_them_up():
    def signed(x, y):
        return (
            x + -y,
            -x + y,
            x - -y,
            y + 3.0 * -x,
            -x * -y,
            -x / -y,
            x - 0.5 * -y,
            -x - 2.0,
            1.0 - -x,
            0.0 - -x,
            -1.0 * -y,
        )

    recorded = compile_straightline(signed, (0.0, 0.0))
    assert "(-" not in recorded.source
    assert recorded.operations == 11  # two have a product too; the last two are x and y
    for x, y in ((0.3, -2.0), (7.0, 0.7)):
        assert recorded.function(x, y) == signed(x, y)


def test_a_quotient_by_a_power_of_two_is_a_product():
    def shared(x):
        return x / 0.25, x / -64.0, x / 0.3, x / 2.0**-1074

    recorded = compile_straightline(shared, (0.0,))
    assert recorded.source.count("/") == 2  # 0.3 is none, and the last has no finite inverse
    assert recorded.function(0.7) == shared(0.7)


def test_what_is_used_once_has_no_name():
    recorded = compile_straightline(lambda x, y: (x * y + 1.0) * (x * y - x / y), (0.0, 0.0))
    assert recorded.source.count(" = ") == 2 + 2  # x, y; x y, and what is returned
    assert recorded.function(3.0, 2.0) == 7.0 * 4.5


def test_names_of_inputs_and_arguments_are_used_again():
    def many(pair, z):
        x, y = pair
        for _ in range(30):
            x, y = x * x - y, x + y * y * z
        return x, y

    recorded = compile_straightline(many, ((0.0, 0.0), 0.0))
    assert len(recorded.function.__code__.co_varnames) <= 6  # two arguments, three inputs, one between
    assert recorded.function((0.25, 0.5), 0.3) == many((0.25, 0.5), 0.3)


def test_sums_may_be_longer_than_python_nests():
    def long(*terms):
        total = 0.0
        for term in terms:
            total = total + term * 0.1
        return total

    terms = [math.sqrt(k) for k in range(1000)]
    assert compile_straightline(long, (0.0,) * 1000).function(*terms) == long(*terms)


def test_repeated_and_unused_operations_go():
    def wasteful(x, y):
        _ = x / y
        return (x + y) * (x + y), x + y, 2 * x * 3.0

    recorded = compile_straightline(wasteful, (0.0, 0.0))
    assert recorded.operations == 4
    assert recorded.source.count("+") == 1
    assert "/" not in recorded.source
    assert recorded.function(2.0, 0.0) == (4.0, 2.0, 12.0)


def test_zeros_of_different_sign_are_different_constants():
    recorded = compile_straightline(lambda x: (0.0 / x, -0.0 / x), (0.0,))
    assert [math.copysign(1, each) for each in recorded.function(1.0)] == [1, -1]


def test_nesting_in_and_out():
    def swap(pair, rest):
        return Pair(pair.second, [pair.first, rest[0]]), ()

    recorded = compile_straightline(swap, (Pair(0.0, (0.0, 0.0)), [0.0]))
    assert recorded.function(Pair(1.0, (2.0, 3.0)), [4.0]) == (((2.0, 3.0), (1.0, 4.0)), ())
    with pytest.raises(ValueError, match="unpack"):
        recorded.function(Pair(1.0, (2.0, 3.0)), [4.0, 5.0])


def test_numpy_numbers_on_either_side_are_constants():
    half = np.float64(0.5)
    recorded = compile_straightline(lambda x: (half * x, x * half, half - x), (0.0,))
    assert recorded.function(3.0) == (1.5, 1.5, -2.5)


def test_functions_are_recorded_once_and_of_constants_computed():
    def turning(x):
        return (
            OPS.sin(x) * OPS.cos(x),
            OPS.sin(x),
            OPS.sqrt(x * x + OPS.sqrt(2)),
            OPS.sin(0.5),
        )

    recorded = compile_straightline(turning, (0.0,))
    assert recorded.source.count("sin(") == 1
    assert recorded.operations == 6
    for x in (0.3, -2.0):
        expected = (math.sin(x) * math.cos(x), math.sin(x), math.sqrt(x * x + math.sqrt(2)), math.sin(0.5))
        assert recorded.function(x) == expected == turning(x)


def test_functions_of_the_law_are_those_of_its_floats():
    def bent(x, y):
        return OPS.exp(x), OPS.log(OPS.maximum(y, 1e-3)), OPS.minimum(0.5, x), OPS.maximum(x, y), OPS.minimum(2.0, 1.0)

    recorded = compile_straightline(bent, (0.0, 0.0))
    assert recorded.operations == 6  # an exponential is held first
    for x, y in ((0.3, -2.0), (-1.0, 4.0), (700.0, 0.1), (1e4, 1e4)):
        expected = (FLOATS.exp(x), math.log(max(y, 1e-3)), min(0.5, x), max(x, y), 1.0)
        assert recorded.function(x, y) == expected == bent(x, y)


def test_a_recording_reaches_nothing_else():
    assert set(compile_straightline(lambda x: x + 1.0, (0.0,)).function.__globals__) == {
        "__builtins__",
        "recorded",
        *FUNCTIONS,
    }
    assert compile_straightline(lambda x: x + 1.0, (0.0,)).function.__globals__["__builtins__"] == {}


@pytest.mark.parametrize("constant", [math.inf, -math.inf, math.nan])
@pytest.mark.parametrize("use", [lambda x, c: x * c, lambda x, c: c + x, lambda x, c: (x, c)])
def test_constants_that_are_not_finite_are_refused(constant, use):
    with pytest.raises(ValueError, match="not finite"):
        compile_straightline(lambda x: use(x, constant), (0.0,))


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda x: x if x == 0.0 else 1.0, "cannot be compared"),
        (lambda x: x or 1.0, "neither true nor false"),
        (lambda x: x + "1", "neither a number"),
        (lambda x: x * np.ones(2), "neither a number"),
        (lambda x: None, "neither a number"),
        (lambda x: x < 1.0, "not supported"),
        (lambda x: np.sin(x), "__array_ufunc__"),
    ],
)
def test_what_is_not_arithmetic_is_refused(use, message):
    with pytest.raises(TypeError, match=message):
        compile_straightline(use, (0.0,))


def test_operand_of_another_recording_is_refused():
    kept = []
    compile_straightline(lambda x: kept.append(x) or x, (0.0,))
    with pytest.raises(TypeError, match="another recording"):
        compile_straightline(lambda x: x + kept[0], (0.0,))
