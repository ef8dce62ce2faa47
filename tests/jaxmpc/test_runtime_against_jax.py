"""The frozen numpy controller against the traced law: same source, two ways to run it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deploy.controller.artifact import Artifact
from deploy.controller.freeze import freeze
from deploy.controller.golden import replay
from deploy.controller.judged_loop import JudgedLoop
from jaxmpc import Params, design
from jaxmpc.law import cascade

LOOP = JudgedLoop(1, True, 180.0, 0.0)
ROW = {"stiffness": 810.0, "M_s": 1.54, "gain_margin_db": 9.0, "gain_reduction_db": np.inf}
ROW |= {"phase_margin_deg": 40.0, "delay_margin_s": 1e-3, "spectral_radius": 0.99}


def jax_trace(gains, force, force_ref):
    """Commands of the jitted law in float64 over a trace (n, 3), after a reset to its first force."""
    with jax.enable_x64(True):
        held = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), gains)

        def step(state, row):
            wanted = row[1] if row[1].ndim == 2 else row[1][:, None] * jnp.ones(len(held.mpc_ref))
            return jax.vmap(lambda s, y, r: cascade.step(held, s, y, r))(state, row[0], wanted)

        start = jax.vmap(lambda y: cascade.init(held, y))(jnp.asarray(force[0]))
        _, v = jax.jit(lambda *rows: jax.lax.scan(step, start, rows))(jnp.asarray(force), jnp.asarray(force_ref))
        return np.asarray(v)


@pytest.mark.parametrize(
    ("architecture", "order", "delay"),
    [("mpc-aob", 1, 1), ("aob", 1, 1), ("mpc", 1, 1), ("mpc-aob", 3, 1), ("mpc-aob", 1, 2), ("mpc", 1, 2)],
)
@pytest.mark.parametrize("preview", [False, True])
def test_runtime_equals_the_traced_law_over_ten_thousand_random_steps(architecture, order, delay, preview, tmp_path):
    gains = design(Params(architecture=architecture, disturbance_order=order, designed_delay=delay))
    draw = np.random.default_rng(5)
    n, ahead = 10_000, (64,) if preview else ()
    force, force_ref = draw.normal(-5.0, 1.0, (n, 3)), draw.normal(-5.0, 1.0, (n, 3, *ahead))
    v = jax_trace(gains, force, force_ref)
    arrays = jax.tree.map(np.asarray, gains)
    floor, params = {"M_s": 2.0}, {"architecture": architecture}
    artifact = Artifact(arrays, 1e-3, 10.0, preview, LOOP, params, [ROW], floor, {}, force, force_ref, v)
    deviation, *_ = replay(artifact)
    assert deviation <= 1e-12
    short = tuple(each[:50] for each in (force, force_ref, v))
    frozen = freeze(tmp_path / "c.npz", arrays, 1e-3, 10.0, LOOP, params, [ROW], floor, short, {}, preview)
    assert frozen.gains.K == tuple(np.asarray(gains.K).tolist())
    assert len(frozen.gains.K) == 3 + order
    assert (frozen.gains.K_earlier is None) == (delay == 1)
    assert frozen.gains.L == tuple(np.asarray(gains.L).tolist())


def test_another_law_would_be_seen():
    gains = jax.tree.map(np.asarray, design(Params.published("text")))
    other = gains._replace(mpc_u=gains.mpc_u + 1e-8)
    force = np.random.default_rng(5).normal(-5.0, 1.0, (50, 3))
    v = jax_trace(gains, force, force)
    artifact = Artifact(other, 1e-3, 10.0, False, LOOP, {}, [ROW], {"M_s": 2.0}, {}, force, force, v)
    assert replay(artifact)[0] > 1e-9
