"""Engines: chosen by name, saying what they can do, and as many programs of one in a process as wanted."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, evaluate
from jaxmpc.cli.doctor import engine_lines
from jaxmpc.closed_loops import close_loops
from jaxmpc.engine import mjx
from jaxmpc.engine.registry import ENGINES, choose, fastest, named
from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics
from jaxmpc.files.errors import InputError
from jaxmpc.law.ops import FLOATS
from jaxmpc.terminal import arguments
from jaxmpc.world.arm import chain
from jaxmpc.world.joint_acceleration import accelerate
from tests.jaxmpc.arm_tables import TABLE, changed

SLOPES = {"forward": jax.jacfwd, "reverse": jax.jacrev}
BRIEF = changed(with_physics(TABLE, "mjx"), duration=0.05, settle=0.02, stiffness=(810.0,), reference={"z": -1.0})


@pytest.mark.oracle
def test_what_the_scan_declares_it_can_differentiate() -> None:
    """Each mode that it has, on three samples, against the other; `test_arm_gradients.py` has those on the arm."""
    experiment = changed(with_physics(BRIEF, "linear"), duration=0.003, settle=0.0)
    spec, data = program_spec(experiment), scenario_data(experiment)
    engine, params = ENGINES[spec.engine], jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], Params())
    gains, K2, contacts, *_ = jax.jit(close_loops)(params, data.stiffness, data.path)

    def residual(factor: Any) -> Any:
        scaled = gains._replace(input_gain=factor * gains.input_gain)
        return jnp.sum(engine.simulate(spec, scaled, K2, contacts, data, "float64").metrics.rms)

    found = [float(jax.jit(SLOPES[mode](residual))(jnp.ones(()))) for mode in engine.modes]
    assert found[0] != 0.0
    np.testing.assert_allclose(found, found[0], rtol=1e-6)


@pytest.mark.slow
def test_stock_mjx_has_the_slopes_that_its_engine_declares() -> None:
    """In both modes through three samples, as the scan's loop takes them, against a central difference.

    They are programs of one process: the model of mjx must not belong to the trace of the first.
    """
    mjx._stock.cache_clear()
    spread = jnp.ones(4)

    def after(factor: Any) -> Any:
        def sample(state: Any, _: None) -> Any:
            q, qd = state
            torque = factor * jnp.array([1.0, -20.0, 2.0, 5.0]) - 3.0 * qd
            qdd = jnp.stack(mjx.accelerate(chain(), tuple(q), tuple(qd), tuple(torque), 0.0, tuple(spread), 1e-3, None))
            return (q + 1e-3 * qd, qd + 1e-3 * qdd), None

        begin = jnp.array([0.0, 0.7, 0.0, 2.2]), 0.1 * spread
        (q, qd), _ = jax.lax.scan(jax.checkpoint(sample), begin, None, length=3)
        return jnp.sum(q) + jnp.sum(qd)

    declared = [float(jax.jit(SLOPES[mode](after))(jnp.ones(()))) for mode in ENGINES["mjx"].modes]
    value, step = jax.jit(after), 1e-4
    # Quadratic in the step, of a function whose third slope is as large as its first.
    central = float(value(1.0 + step) - value(1.0 - step)) / (2.0 * step)
    assert abs(central) > 1e-3
    np.testing.assert_allclose(declared, central, rtol=1e-7)


@jax.jit  # a program instead of one for each operation
def stock(q: Any, qd: Any, torque: Any, viscous: Any, share: Any) -> Any:
    return mjx.accelerate(chain(), q, qd, torque, 0.0, viscous, share, None)


@pytest.mark.oracle
@pytest.mark.parametrize("share", [5e-4, 1e-3, 2e-3])
def test_stock_mjx_gains_what_the_chain_does_at_any_step(share: float) -> None:
    """Not at that of its own file alone, a millisecond."""
    q, qd, torque, viscous = (0.0, 0.7, 0.0, 2.2), (0.1, -0.2, 0.3, 0.1), (1.0, -20.0, 2.0, 5.0), (1.5, 0.9, 0.5, 0.25)
    met = [tuple(jnp.array([value]) for value in vector) for vector in (q, qd, torque)]
    found = stock(*met, tuple(map(jnp.asarray, viscous)), share)
    expected = accelerate(chain(), q, qd, torque, 0.0, viscous, share, FLOATS)
    np.testing.assert_allclose(np.ravel(found), expected, rtol=1e-9)


def test_an_engine_is_refused_what_it_does_not_know() -> None:
    spec = program_spec(BRIEF)
    assert choose(spec).name == "mjx"
    with pytest.raises(InputError, match="scan"):
        choose(spec._replace(engine="skan"))
    with pytest.raises(InputError, match="reverse"):
        choose(spec._replace(engine="kernel"), "reverse")


def test_the_kernel_takes_the_place_of_the_scan_on_a_gpu_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scan, stock = program_spec(TABLE), program_spec(BRIEF)
    assert fastest(scan) == scan
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert fastest(scan) == scan._replace(engine="kernel")
    assert fastest(stock) == stock


def test_stock_mjx_steps_as_mujoco_does_and_says_so() -> None:
    assert BRIEF.arm.integrator == "euler"
    with pytest.raises(InputError, match="euler"):
        changed(TABLE, physics="mjx")


def test_stock_mjx_is_refused_where_the_compiler_would_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "__version__", "0.11.2")
    monkeypatch.setattr(jax, "local_device_count", lambda: 2)
    with pytest.raises(InputError, match=r"physics = mjx.*0\.11\.2.*wam"):
        evaluate(Params(), BRIEF)


def test_an_engine_is_named_for_what_it_can_do_here(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, stock = program_spec(TABLE), program_spec(BRIEF)
    assert tuple(ENGINES) == arguments.ENGINES
    assert named(arm, None) == arm == named(arm, "scan", "reverse", traced=True)
    assert named(stock, None) == stock
    for spec, name, why in ((arm, "kernel", "gpu"), (arm, "mjx", "wam"), (stock, "scan", "mjx"), (arm, "skan", "scan")):
        with pytest.raises(InputError, match=rf"--engine = {name}: .*{why}"):
            named(spec, name)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert named(arm, "kernel") == fastest(arm)
    assert named(arm, "scan") == arm
    with pytest.raises(InputError, match="reverse"):
        named(arm, "kernel", "reverse")
    with pytest.raises(InputError, match="keeps samples"):
        named(arm, "kernel", traced=True)


def test_doctor_says_of_each_engine_where_it_would_run(monkeypatch: pytest.MonkeyPatch) -> None:
    title, *lines = engine_lines()
    assert title == "engines"
    assert [line.split()[0] for line in lines] == list(ENGINES)
    assert "sweep, tune, trials, simulate" in lines[0]
    assert "not here, it needs a gpu" in lines[1]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    lines = engine_lines()[1:]
    assert "worlds of their own" in lines[0]
    assert "sweep, trials, runs of tune on the arm: the fastest here" in lines[1]
    monkeypatch.setattr("jaxmpc.cli.doctor.find_spec", lambda name: None)
    assert "jaxmpc[sim]" in engine_lines()[0]
