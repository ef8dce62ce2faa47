"""The kernel, interpreted: the scan's numbers of every lane, however lanes are cut, packed and told apart."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from jaxmpc import Experiment, Params
from jaxmpc.closed_loops import close_loops
from jaxmpc.engine import kernel
from jaxmpc.engine.base import CellResults
from jaxmpc.engine.kernel import Kernel
from jaxmpc.engine.lane_ops import lane_ops
from jaxmpc.engine.lanes import at_sample, packed, recorded, unpacked
from jaxmpc.engine.pallas_triton import Shape
from jaxmpc.engine.scan import Scan
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.synthesis.structure import Delay
from tests.jaxmpc.arm_tables import TABLE, changed

# Steps that stretches do not divide, lanes that programs do not divide; one controller that runs away.
LINEAR = changed(Experiment.published("table-1"), duration=2.59, settle=1.0)
ARM = changed(
    TABLE,
    duration=0.26,
    settle=0.1,
    stiffness=(375.0, 550.0),
    reference={"z": 0.0},
    arm={"cable_hz": 150.0, "substeps": 2},
)
closed = jax.jit(close_loops)


def results(engine: Any, params: Params, experiment: Experiment, dtype: str) -> CellResults:
    spec, data = program_spec(experiment), scenario_data(experiment, swinging=True)
    loops = closed(params, data.stiffness, data.path)
    run = jax.jit(lambda loops: engine.simulate(spec, loops.gains, loops.K2, loops.contacts, data, dtype))
    found: CellResults = jax.tree.map(np.asarray, run(loops))
    return found


def varied(params: Params, **columns: Any) -> Params:
    return params.with_columns({name: np.asarray(values) for name, values in columns.items()})


def check_equal(kernel: CellResults, scan: CellResults, rtol: float) -> None:
    for name, found, expected in zip(scan.metrics._fields, kernel.metrics, scan.metrics, strict=True):
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol, err_msg=name)
    for name in ("diverged", "over_limit", "lost_contact", "backed_off"):
        np.testing.assert_array_equal(getattr(kernel, name), getattr(scan, name), err_msg=name)


@pytest.mark.oracle
@pytest.mark.parametrize("designed", [1, 2])
def test_linear_loop_is_the_scans_to_rounding(designed: Delay, monkeypatch: pytest.MonkeyPatch) -> None:
    """In float64 nothing but the order of operations differs: 1e-9 of a force is far above that."""
    monkeypatch.setattr(kernel, "AXIS", Shape(4, 1, samples=5))
    params = varied(Params(designed_delay=designed), Khat_s=[900.0, 1400.0, 60.0])
    # Five samples at a time, and where their number is no multiple of five one by one.
    experiment = changed(LINEAR, duration=2.588 + 0.001 * designed)
    found, expected = (results(engine, params, experiment, "float64") for engine in (Kernel(), Scan()))
    assert np.isfinite(expected.over_limit[2]).any()
    assert np.isinf(expected.over_limit[:2]).all()
    check_equal(found, expected, 1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("name", [pytest.param("text", marks=pytest.mark.slow), "family"])
def test_arm_is_the_scans_to_rounding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With cable, friction, quantisers, limits, guard, schedule and identification."""
    monkeypatch.setattr(kernel, "ARM", Shape(4, 1))
    params = varied(Params.published(name), K2=np.float64(Params.published(name).K2) * np.array([1.0, 1.1, 1.2]))
    found, expected = (results(engine, params, ARM, "float64") for engine in (Kernel(), Scan()))
    check_equal(found, expected, 1e-9)


@pytest.mark.parametrize(("lanes", "found"), [(30, (32, 1)), (40, (64, 2)), (90, (32, 1)), (320, (64, 2))])
def test_a_program_is_as_narrow_as_lets_fewer_lanes_idle(lanes: int, found: tuple[int, int]) -> None:
    """Of 30 lanes 34 would idle in one of 64; of 40 as many idle in two of 32; of many it is a few of a hundred."""
    assert kernel._as_wide_as_needed(Shape(64, 2), lanes)[:2] == found
    assert kernel._as_wide_as_needed(Shape(32, 1, 2), lanes) == Shape(32, 1, 2), "a warp is the least"


def test_a_thread_has_one_lane_in_float64() -> None:
    assert kernel._of_precision(Shape(64, 1, samples=5), "float32") == Shape(64, 1, samples=5)
    assert kernel._of_precision(Shape(64, 1, samples=5), "float64") == Shape(64, 2, samples=5)
    assert kernel._of_precision(Shape(256, 8, 2), "float64") == Shape(256, 8, 2)


def accesses(jaxpr: Any) -> int:
    """How often a program reads or writes several lanes of memory at once, in the kernels within it."""
    found = 0
    for equation in jaxpr.eqns:
        # A write gives what was there before.
        found += equation.primitive.name in ("get", "swap") and equation.outvars[0].aval.shape != ()
        found += sum(map(accesses, jaxprs_in_params(equation.params)))
    return found


def test_a_kernel_has_an_access_for_each_kind_of_constants_and_one_for_its_results() -> None:
    """Each one more costs the compiler a third of a second on the arm."""
    spec, data = program_spec(ARM), scenario_data(ARM)
    loops = closed(varied(Params(), K2=[10.0, 11.0]), data.stiffness, data.path)
    jaxpr = jax.make_jaxpr(lambda: Kernel().simulate(spec, loops.gains, loops.K2, loops.contacts, data, "float32"))()
    kinds = 2  # what is a controller's own, and what is a tissue's
    assert accesses(jaxpr.jaxpr) == kinds + 1


@pytest.mark.filterwarnings("ignore:The Pallas Triton backend is deprecated")
@pytest.mark.parametrize(
    ("experiment", "dtype", "instructions"),
    [
        (ARM, "float32", ("fma.rn.f32", "rcp.approx.ftz.f32", "sqrt.approx.ftz.f32")),
        (LINEAR, "float64", ("fma.rn.f64",)),
        pytest.param(ARM, "float64", ("fma.rn.f64",), marks=pytest.mark.oracle),
    ],
)
def test_a_gpu_is_given_the_instructions_that_its_compiler_does_not_find(
    experiment: Experiment, dtype: str, instructions: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the kernel is lowered for a GPU, of which there need be none."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    gpu = jax.sharding.AbstractDevice("NVIDIA H200", 132, "gpu")
    spec, data = program_spec(experiment), scenario_data(experiment)
    loops = closed(varied(Params(), K2=[10.0, 11.0]), data.stiffness, data.path)
    run = jax.jit(lambda: Kernel().simulate(spec, loops.gains, loops.K2, loops.contacts, data, dtype).metrics.rms)
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((1,), ("device",), abstract_device=gpu)):
        text = run.trace().lower(lowering_platforms=("cuda",)).as_text()
    assert set(re.findall(r"(?:fma|rcp|sqrt)\.[a-z.]+\d\d", text)) == set(instructions)


def test_samples_come_from_the_scan() -> None:
    spec, data = program_spec(LINEAR), scenario_data(LINEAR)
    loops = closed(varied(Params(), K2=[10.0]), data.stiffness, data.path)
    found = jax.eval_shape(
        lambda: Kernel().simulate(spec, loops.gains, loops.K2, loops.contacts, data, "float64", traced=True)
    )
    assert found.trace is not None


def test_each_lane_finds_its_own_constants() -> None:
    shape = motions, tissues, controllers = 2, 3, 5
    random = np.random.default_rng(3)
    lane = {
        "one": 2.5,
        "motion": random.normal(size=(motions, 1, 1)),
        "cell": random.normal(size=(motions, tissues, 1)),
        "tissue": random.normal(size=(tissues, 1)),
        "controller": random.normal(size=controllers),
        "both": random.normal(size=(tissues, controllers)),
        "all": random.normal(size=shape),
        "corner": random.normal(size=(motions, 1, controllers)),
    }
    arrays, layout = packed(lane, shape, jnp.float64)
    everywhere = np.arange(tissues * controllers)
    for group in range(motions):
        found = unpacked(layout, arrays, group, everywhere)
        for name, value in lane.items():
            expected = np.broadcast_to(value, shape)[group].ravel()
            np.testing.assert_array_equal(np.broadcast_to(found[name], expected.shape), expected, err_msg=name)
    stored = sum(array.size for array in arrays)
    assert stored == sum(np.size(value) for value in lane.values())


def test_each_sample_finds_its_own_signals() -> None:
    random = np.random.default_rng(4)
    signals = {"a": random.normal(size=(2, 7)), "b": random.normal(size=(2, 7, 2, 3)), "c": random.random((2, 7)) > 0.5}
    array, track = recorded(signals, jnp.float64)
    for group, step in ((0, 0), (1, 6), (1, 3)):
        found = at_sample(track, array, group, step)
        assert found["a"] == signals["a"][group, step]
        np.testing.assert_array_equal(np.array(found["b"]), signals["b"][group, step])
        assert bool(found["c"]) == signals["c"][group, step]


def test_sines_of_float32_are_numpys_to_its_last_digits() -> None:
    """Within two units in the last place of 1 (2.4e-7), over several turns, where the reduction is exact."""
    angles = np.linspace(-20.0, 20.0, 200_001).astype(np.float32)
    ops = lane_ops(jnp.float32)
    for function, exact in ((ops.sin, np.sin), (ops.cos, np.cos)):
        np.testing.assert_allclose(function(jnp.asarray(angles)), exact(angles.astype(np.float64)), rtol=0, atol=2.4e-7)


def test_slope_of_a_sine_is_its_cosine() -> None:
    ops, angles = lane_ops(jnp.float32), jnp.linspace(-3.0, 3.0, 1001, dtype=jnp.float32)
    slopes = jax.vmap(jax.grad(ops.sin))(angles)
    np.testing.assert_allclose(slopes, np.cos(np.asarray(angles, np.float64)), atol=2e-6)
