import math
import statistics
import time

import numpy as np
import pytest

from deploy.controller.artifact import Artifact
from deploy.controller.golden import replay
from deploy.controller.runtimes import linear_runtime
from deploy.runtime.straightline import compile_straightline
from jaxmpc.law.gains import constant_reference


def make(arguments, **changes):
    values = arguments | changes
    force, force_ref, v = values.pop("golden")
    return Artifact(**({"preview": False} | values), golden_force=force, golden_force_ref=force_ref, golden_v=v)


@pytest.mark.parametrize("more", [(), (1e-2,), (1e-2, 1e-4)])
@pytest.mark.parametrize("preview", [False, True])
def test_runtime_equals_the_law_on_floats_to_the_last_bit(arguments, law, preview, more):
    gains = law.gains._replace(K=(*law.gains.K, *more))
    golden = law.trace(gains, 500, preview)
    artifact = make(arguments, gains=gains, golden=golden, preview=preview)
    assert replay(artifact) == (0.0, 0.0, 0.0)
    runtime = linear_runtime(artifact)
    runtime.init(golden[0][0])
    assert [runtime.step(*row) for row in zip(*golden[:2], strict=True)] == [tuple(row) for row in golden[2].tolist()]


def test_lists_and_arrays_give_the_same_plain_floats(arguments):
    runtime, again = linear_runtime(make(arguments)), linear_runtime(make(arguments))
    force = np.array([1.0, 2.0, 3.0])
    first = [runtime.step(force, force), runtime.step(force, force)]
    assert first == [again.step(force.tolist(), force.tolist()), again.step(force.tolist(), force.tolist())]
    assert {type(each) for v in first for each in v} == {float}


def test_axes_do_not_touch_one_another(arguments):
    runtime = linear_runtime(make(arguments))
    v = [runtime.step((1.0, 0.0, math.nan), (0.0, 0.0, 0.0)) for _ in range(5)]
    assert all(each[0] != 0.0 and each[1] == 0.0 and math.isnan(each[2]) for each in v)
    runtime.init((0.0, 0.0, 0.0))
    assert all(map(math.isfinite, runtime.step((1.0, 0.0, 1.0), (0.0, 0.0, 0.0))))


def test_observer_uses_what_was_applied(arguments, law):
    from jaxmpc.law import cascade

    gains, runtime = constant_reference(law.gains), linear_runtime(make(arguments))
    state = cascade.init(gains, -5.0)
    runtime.init((-5.0, -5.0, -5.0))
    for k in range(50):
        y = -5.0 + math.sin(k)
        state, v = cascade.step(gains, state, y, (-4.0,))
        assert runtime.step((y, y, y), (-4.0, -4.0, -4.0)) == (v, v, v)
        clamped = max(-20.0, min(20.0, v))
        assert k == 0 or clamped != v or abs(v) <= 20.0
        state = state._replace(v=clamped)
        runtime.applied((clamped, clamped, clamped))
    free = linear_runtime(make(arguments))
    free.init((-5.0, -5.0, -5.0))
    for k in range(50):
        y = -5.0 + math.sin(k)
        last = free.step((y, y, y), (-4.0, -4.0, -4.0))
    assert last[0] != v


def test_init_rests_at_the_measured_force(arguments, law):
    runtime = linear_runtime(make(arguments))
    runtime.init((-5.0, 0.0, 2.0))
    # In equilibrium nothing moves: r F − mₓ F − mᵤ F = 0 to the digits of the gains, and g u = L₁ F.
    v = runtime.step((-5.0, 0.0, 2.0), (-5.0, 0.0, 2.0))
    assert np.allclose(v, 0.0, atol=1e-3)


def test_wrong_number_of_forces_is_refused_and_changes_nothing(arguments):
    runtime, other = linear_runtime(make(arguments)), linear_runtime(make(arguments))
    with pytest.raises(ValueError, match="unpack"):
        runtime.step((1.0, 2.0), (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="unpack"):
        runtime.init((1.0, 2.0))
    with pytest.raises(ValueError, match="unpack"):
        runtime.applied((1.0, 2.0))
    assert runtime.step((1.0, 2.0, 3.0), (0.0,) * 3) == other.step((1.0, 2.0, 3.0), (0.0,) * 3)


def straight_line(operations):
    """A Python function of so many operations, half of them multiplications."""
    space = {}
    exec("def run(x):\n" + "    x = x * 0.5 + 1.0\n" * (operations // 2) + "    return x\n", space)
    return space["run"]


@pytest.mark.parametrize("preview", [False, True])
def test_a_step_costs_no_more_than_its_operations(arguments, law, preview):
    """Its absolute time is what `jaxmpc check` prints; here only a ratio within one run means anything."""
    golden = law.trace(law.gains, 2, preview)
    runtime = linear_runtime(make(arguments, golden=golden, preview=preview))
    force, force_ref = golden[0][1].tolist(), golden[1][1].tolist()
    plain = straight_line(3 * runtime.recorded.operations)
    took, floor = [], []
    for _ in range(20_000):
        start = time.perf_counter_ns()
        runtime.step(force, force_ref)
        middle = time.perf_counter_ns()
        plain(1.0)
        took.append(middle - start)
        floor.append(time.perf_counter_ns() - middle)
    # Measured 0.8; what allocates or looks up more than its operands shows.
    assert statistics.median(took) <= 1.5 * statistics.median(floor)


def test_replay_sees_a_gain_that_changed_by_a_millionth(arguments, law):
    gains = law.gains._replace(mpc_u=law.gains.mpc_u * (1 + 1e-6))
    assert 1e-9 < replay(make(arguments, gains=gains))[0] < 1e-3


@pytest.mark.parametrize("first", [1.0, -1.0])
@pytest.mark.parametrize("second", [1.0, -1.0])
def test_signs_that_move_to_a_sum_keep_its_value(first, second):
    def law(x, y):
        a, b = first * x, second * y
        return a - b, a + b, a - 2.0, 2.0 - a, a * b, a / b, a * 3.0

    assert compile_straightline(law, (1.0, 1.0)).function(5.0, 0.75) == law(5.0, 0.75)
