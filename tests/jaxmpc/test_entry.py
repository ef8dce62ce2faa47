"""How control begins in contact: at rest nothing is asked for, and what was asked before goes on without a step."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxmpc import Params, design
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains, constant_reference, force_share
from jaxmpc.stability.loop import contact_of
from jaxmpc.world import contact
from jaxmpc.world.loop_path import loop_path

ALONE = Params.published("mpc-alone")
LAWS = {
    "cascade": Params(),
    "observer": Params(architecture="aob"),
    "alone": ALONE,
    "alone, later": replace(ALONE, designed_delay=2),
}
every_law = pytest.mark.parametrize("params", LAWS.values(), ids=LAWS)


def on_floats(params: Params) -> Gains:
    gains: Gains = jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), design(params))
    return constant_reference(gains)


@every_law
def test_at_rest_the_wanted_force_asks_for_nothing(params: Params) -> None:
    gains = on_floats(params)
    _, v = cascade.step(gains, cascade.init(gains, -5.0), -5.0, (-5.0,))
    assert v == pytest.approx(0.0, abs=1e-9)


@every_law
def test_what_was_asked_before_contact_goes_on(params: Params) -> None:
    gains = on_floats(params)
    _, v = cascade.step(gains, cascade.going_on(gains, -1.0, 0.3), -1.0, (-1.0,))
    assert v == pytest.approx(0.3, abs=1e-9)


def test_gains_of_nothing_ask_for_nothing_more() -> None:
    """What finds the input that has it ask for v once more would divide by nothing."""
    designed = on_floats(ALONE)
    silent = designed._replace(mpc_ref=(0.0,) * len(designed.mpc_ref), mpc_x=(0.0, 0.0), mpc_u=0.0)
    for force, asked in ((-5.0, 0.0), (-1.0, 0.3)):
        _, v = cascade.step(silent, cascade.going_on(silent, force, asked), force, (force,))
        assert v == pytest.approx(asked, abs=1e-9)


@pytest.mark.parametrize("params", [LAWS["cascade"], LAWS["observer"]], ids=["cascade", "observer"])
def test_an_observer_takes_it_for_the_disturbance_bit_by_bit(params: Params) -> None:
    gains = on_floats(params)
    assert force_share(gains) == 1.0
    assert cascade.init(gains, -1.1).u == -1.1
    begun = cascade.going_on(gains, -1.1, 0.3)
    assert begun == cascade.init(gains, -1.1)._replace(p_hat=-0.3, v=0.3)


@pytest.mark.parametrize("params", [ALONE, LAWS["alone, later"]], ids=["a sample", "two samples"])
def test_mpc_alone_keeps_nothing_of_it(params: Params) -> None:
    """A push that was held before contact is gone there: the force comes back to the wanted one."""
    gains = on_floats(params)
    path = loop_path(delay=params.designed_delay)
    tissue = jax.tree.map(float, contact_of(810.0, float(params.K2), path))
    world = contact.init(-1.0 / 810.0)._replace(force=-1.0, pending=(0.3, 0.3))
    state = cascade.going_on(gains, -1.0, 0.3)
    for _ in range(3000):
        force, world = contact.sense(tissue, world, 0.0)
        state, v = cascade.step(gains, state, force, (-1.0,))
        world, _ = contact.move(tissue, world, v, 0.0)
    assert force == pytest.approx(-1.0, abs=1e-6)
    assert state.p_hat == 0.0
