"""Tangents in the kernel, interpreted: the scan's, central differences', and one by one what they are side by side."""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.closed_loops import ClosedLoops, close_loops
from jaxmpc.engine import kernel
from jaxmpc.engine.kernel import Kernel
from jaxmpc.engine.lane_ops import lane_ops
from jaxmpc.engine.pallas_triton import Shape
from jaxmpc.engine.pruned import pruned
from jaxmpc.engine.scan import Scan
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.engine.tangents import movable, moved, movers, pushed
from jaxmpc.xla import ops
from tests.jaxmpc.arm_tables import NO_COUNTS, TABLE, changed
from tuning.job.goals import OF_JOINTS

# Steps that stretches do not divide. No counts: through those a slope is the tuner's, and no difference finds it.
LINEAR = changed(Experiment.published("table-1"), duration=0.26, settle=0.1, sensor=NO_COUNTS, reference={"z": -1.0})
ARM = changed(
    TABLE,
    duration=0.13,
    settle=0.04,
    stiffness=(550.0,),
    reference={"z": 0.0},
    sensor=NO_COUNTS,
    arm={"encoder_counts": 0, "torque_lsb": 0.0, "torque_step_limit": (0.0,) * 4},
)
POINT = np.array([0.02, -0.03, 0.05])


class Loop:
    """Metrics of three controllers by the logarithms of three factors: on two gains and on the damping."""

    def __init__(self, experiment: Experiment, dtype: str = "float64"):
        self.dtype = dtype
        self.programs: dict[str, Any] = {}
        self.spec, self.data = program_spec(experiment), scenario_data(experiment, swinging=True)
        params = Params.published("text").with_columns({"lam": np.array([0.3, 0.4, 0.5])})
        self.loops = jax.jit(close_loops)(params, self.data.stiffness, self.data.path)

    def metrics(self, engine: Any, z: Any, spec: Any = None) -> Any:
        loops: ClosedLoops = self.loops
        a, b, c = jnp.exp(z)
        gains = loops.gains._replace(input_gain=a * loops.gains.input_gain, K=b * loops.gains.K)
        contacts = loops.contacts._replace(stiffness=c * loops.contacts.stiffness)
        return engine.simulate(spec or self.spec, gains, c * loops.K2, contacts, self.data, self.dtype).metrics

    def jacobian(self, engine: Any) -> Any:
        return self.program(engine)(POINT)[0]

    def program(self, engine: Any) -> Any:
        """The Jacobian and the metrics themselves; compiled once."""
        if engine.name not in self.programs:

            def twice(z: Any) -> tuple[Any, Any]:
                found = self.metrics(engine, z)
                return found, found

            self.programs[engine.name] = jax.jit(jax.jacfwd(twice, has_aux=True))
        return self.programs[engine.name]

    def differences(self, step: float) -> Any:
        """Central ones, of what the scan gives."""
        run = self.program(Scan())
        pairs = [(run(POINT + step * row)[1], run(POINT - step * row)[1]) for row in np.eye(3)]
        each = [jax.tree.map(lambda high, low: (high - low) / (2.0 * step), *pair) for pair in pairs]
        return jax.tree.map(lambda *columns: np.stack(columns, axis=-1), *each)


linear, arm = cache(lambda: Loop(LINEAR)), cache(lambda: Loop(ARM))


def check(found: Any, wanted: Any, tolerance: float) -> None:
    """Within so much of the largest slope of each metric."""
    for name, one, other in zip(found._fields, found, wanted, strict=True):
        largest = np.abs(other).max()
        assert np.isfinite(one).all(), name
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * largest + 1e-14, err_msg=name)


@pytest.mark.oracle
def test_slopes_of_the_linear_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scan's to rounding; central differences', whose own error is the step squared; three directions in twos."""
    monkeypatch.setattr(kernel, "AXIS_ALONG", Shape(4, 1, 4))
    loop = linear()
    found = loop.jacobian(Kernel())
    check(found, loop.jacobian(Scan()), 1e-10)
    check(found, loop.differences(1e-5), 1e-6)
    one = jax.jit(lambda z, along: jax.jvp(lambda z: loop.metrics(Kernel(), z), (z,), (along,)))(POINT, np.eye(3)[2])
    np.testing.assert_array_equal(one[0].rms, jax.jit(lambda z: loop.metrics(Kernel(), z))(POINT).rms)
    np.testing.assert_allclose(one[1].rms, found.rms[..., 2], rtol=1e-12)


@pytest.mark.oracle
def test_slopes_of_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """With friction, which is smooth. Torques and swing come to 1e-5 of their own by differences.

    Of all metrics one direction runs in a program, as on a GPU; more share one on the linear loop.
    """
    monkeypatch.setattr(kernel, "ARM_ALONG", Shape(4, 1, 1))
    loop = arm()
    found = loop.jacobian(Kernel())
    check(found, loop.jacobian(Scan()), 1e-9)
    check(found, loop.differences(1e-5), 1e-5)


@pytest.mark.oracle
def test_slopes_of_the_linear_loop_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the step that a GPU takes, put together with fewer instructions."""
    monkeypatch.setattr(kernel, "AXIS_ALONG", Shape(4, 1, 6))
    check(Loop(LINEAR, "float32").jacobian(Kernel()), linear().jacobian(Scan()), 1e-4)


@pytest.mark.slow
def test_slopes_of_the_arm_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    """Likewise, of near angles' sines too."""
    monkeypatch.setattr(kernel, "ARM_ALONG", Shape(4, 1, 1))
    check(Loop(ARM, "float32").jacobian(Kernel()), arm().jacobian(Scan()), 1e-2)


@pytest.mark.oracle
def test_slopes_that_are_wanted_are_those_of_all_and_others_are_no_number() -> None:
    """Fewer tangents are carried for them; values stay as they are."""
    loop, wanted = linear(), ("chatter", "peak_force")
    spec = loop.spec._replace(slopes=wanted)
    values, slopes = jax.jit(lambda z: jax.jvp(lambda z: loop.metrics(Kernel(), z, spec), (z,), (np.eye(3)[0],)))(POINT)
    jacobian, plain = loop.program(Scan())(POINT)
    check(values, plain, 1e-9)
    for name, slope in slopes._asdict().items():
        if name in wanted:
            other = getattr(jacobian, name)[..., 0]
            np.testing.assert_allclose(slope, other, rtol=0, atol=1e-9 * np.abs(other).max(), err_msg=name)
        else:
            assert np.isnan(slope).all() != (name in OF_JOINTS), name


@pytest.mark.oracle
@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_directions_of_little_share_a_run_of_it_alone(
    monkeypatch: pytest.MonkeyPatch, dtype: str, tolerance: float
) -> None:
    """All else comes from another; three directions in twos."""
    monkeypatch.setattr(kernel, "AXIS_ALONG", Shape(4, 1, 2))
    loop = Loop(LINEAR, dtype)
    spec = loop.spec._replace(slopes=("rms",))

    def twice(z: Any) -> tuple[Any, Any]:
        found = loop.metrics(Kernel(), z, spec)
        return found, found

    traced = jax.jit(jax.jacfwd(twice, has_aux=True)).trace(POINT)
    assert str(traced.jaxpr).count("pallas_call[") == 2, "one of what is wanted and its slopes, one of all else"
    slopes, values = traced.lower().compile()(POINT)
    wanted, plain = linear().program(Scan())(POINT)
    check(values, plain, tolerance)
    np.testing.assert_allclose(slopes.rms, wanted.rms, rtol=0, atol=tolerance * np.abs(wanted.rms).max())
    assert np.isnan(slopes.chatter).all()


@pytest.mark.slow
def test_directions_on_the_arm_share_a_run_of_what_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU, in float32; three directions in twos."""
    monkeypatch.setattr(kernel, "ARM_ALONG", Shape(4, 1, 2))
    loop = Loop(ARM, "float32")
    spec = loop.spec._replace(slopes=("rms",))

    def twice(z: Any) -> tuple[Any, Any]:
        found = loop.metrics(Kernel(), z, spec)
        return found, found

    slopes, values = jax.jit(jax.jacfwd(twice, has_aux=True))(POINT)
    wanted, plain = arm().program(Scan())(POINT)
    check(values, plain, 1e-2)
    np.testing.assert_allclose(slopes.rms, wanted.rms, rtol=0, atol=1e-2 * np.abs(wanted.rms).max())


def test_slopes_of_nothing_are_no_error() -> None:
    """As where the overshoot is all that a tuner is asked for, which no run tells."""
    loop = linear()
    spec = loop.spec._replace(slopes=())
    slopes = jax.eval_shape(jax.jacfwd(lambda z: loop.metrics(Kernel(), z, spec)), POINT)
    assert slopes.rms.shape[-1] == 3


def test_what_is_pruned_is_of_what_is_left() -> None:
    """What is left, what moves it, what it is chosen by; no more."""

    class Counting(NamedTuple):
        def taken_apart(self, now: Any) -> Any:
            return now

        def begin(self, lane: Any, ops: Any) -> Any:
            return {"chosen": 0.0 * lane, "other": lane, "state": lane, "total": lane}

        def step(self, lane: Any, run: Any, now: Any, ops: Any) -> Any:
            state = lane * run["state"] + now
            chosen = jnp.where(state > 0.5, run["chosen"] + 1.0, run["chosen"])
            return {"chosen": chosen, "other": run["other"] + now, "state": state, "total": run["total"]}, None

        def fold(self, lane: Any, run: Any, ops: Any) -> Any:
            return run | {"total": run["total"] + run["other"]}

        def found(self, run: Any) -> Any:
            return run["chosen"], run["total"], run["other"]

    whole, one = Counting(), jnp.ones(())

    def carried(*left: bool) -> Any:
        return pruned(whole, left, one, one, ops).carried

    # Leaves of what is carried come by their names: chosen, other, state, total.
    assert carried(True, False, False) == (True, False, True, False)
    assert carried(False, True, False) == (False, True, False, True)
    assert carried(False, False, True) == (False, True, False, False)
    only_chosen = pruned(whole, (True, False, False), one, one, ops)
    run, expected = only_chosen.begin(one, ops), whole.begin(one, ops)
    for now in (0.7, -2.0, 1.5):
        run, expected = only_chosen.step(one, run, now, ops)[0], whole.step(one, expected, now, ops)[0]
    assert only_chosen.found(only_chosen.fold(one, run, ops)) == (expected["chosen"],)


def test_only_what_moves_and_matters_has_a_tangent() -> None:
    """Carried: what a constant moves, what that moves in turn, what it moves through a choice alone, what is noise."""

    def begin(lane: Any) -> Any:
        return {"state": 1.0 * lane["gain"], "sum": 0.0, "chosen": 0.0, "noise": 0.0}

    def one(lane: Any, run: Any, now: Any) -> Any:
        chosen = jnp.where(run["state"] > 0.0, now, run["chosen"])
        state = lane["gain"] * run["state"] + run["noise"]
        return {"state": state, "sum": run["sum"] + state * state, "chosen": chosen, "noise": now}

    def fold(lane: Any, run: Any) -> Any:
        return run

    def found(run: Any) -> Any:
        return run["chosen"], run["state"], run["sum"]

    def needed(*wanted: bool) -> Any:
        return movable(begin, one, fold, found, (True,), {"gain": 1.0}, 1.0, wanted)

    # Leaves of what is carried come by their names: chosen, noise, state, sum.
    assert needed(True, True, True) == ((False, False, True, True), (False, True, True))
    assert needed(False, True, False) == ((False, False, True, False), (False, True, False))
    assert needed(True, False, True) == ((False, False, True, True), (False, False, True))
    assert needed(True, False, False) == ((False,) * 4, (False,) * 3)


def test_what_moves_something_is_what_it_has_a_slope_by() -> None:
    def program(x: Any, y: Any, z: Any) -> Any:
        return x * y, jnp.where(x > 0.0, y, 1.0), jnp.floor(x) * z, 0.0 * z

    closed = jax.make_jaxpr(program)(1.5, 2.5, 3.5)
    for i, moves in enumerate([(True, True, False), (False, True, False), (False, False, True), (False,) * 3]):
        assert movers(closed, tuple(i == j for j in range(4))) == moves


def test_slopes_by_signals_are_refused() -> None:
    loop = linear()

    def by_noise(noise: Any) -> Any:
        data = loop.data._replace(signals=loop.data.signals._replace(noise=noise))
        given = loop.loops
        return Kernel().simulate(loop.spec, given.gains, given.K2, given.contacts, data, "float64").metrics.rms

    noise = loop.data.signals.noise
    with pytest.raises(TypeError, match="scan"):
        jax.eval_shape(lambda noise: jax.jvp(by_noise, (noise,), (noise,)), noise)


@pytest.mark.oracle
def test_directions_of_controllers_that_differ_too() -> None:
    """Where a batch of points has each its own direction nothing is shared, and nothing else changes."""
    loop = Loop(changed(LINEAR, duration=0.02, settle=0.0, reference={"z": 0.0}))
    points = np.stack([POINT, 2.0 * POINT])

    def slopes(engine: Any) -> Any:
        def one(z: Any) -> Any:
            return jax.jvp(lambda z: loop.metrics(engine, z).rms, (z,), (jnp.ones(3),))[1]

        return jax.jit(jax.vmap(one))(points)

    np.testing.assert_allclose(slopes(Kernel()), slopes(Scan()), rtol=1e-9)


def test_what_moves_is_what_has_a_slope() -> None:
    def program(x: Any, y: Any) -> Any:
        return x * y, 0.0 * x, jnp.floor(x), jnp.where(x > 0.0, y, 1.0), ops.floor(x), jnp.where(y > 0.0, x, y), x > y

    closed = jax.make_jaxpr(program)(1.5, 2.5)
    assert moved(closed, (True, False)) == (True, False, False, False, True, True, False)
    assert moved(closed, (False, False)) == (False,) * 7


def test_pushed_is_jvp_of_what_moves() -> None:
    def function(x: Any, y: Any) -> Any:
        return {"a": x * y, "b": jnp.sin(y)}

    found, slopes = pushed(function, (2.0, 3.0), (False, True), [[1.0], [-2.0]])
    assert found == function(2.0, 3.0)
    np.testing.assert_allclose(slopes, np.outer([1.0, -2.0], [2.0, np.cos(3.0)]))
    assert pushed(function, (2.0, 3.0), (), []) == (found, [])


def test_slopes_of_extremes_are_those_of_one_of_them() -> None:
    lanes = lane_ops(jnp.float64)
    for function, wanted in ((lanes.maximum, (0.0, 1.0, 1.0)), (lanes.minimum, (1.0, 1.0, 0.0))):
        found = [float(jax.grad(function)(x, 2.0)) for x in (1.0, 2.0, 3.0)]
        np.testing.assert_array_equal(found, wanted)
    assert np.isfinite(jax.grad(lanes.minimum)(2.0, jnp.inf))
