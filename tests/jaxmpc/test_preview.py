"""A reference that is known ahead: guard and listening judge a force by what is wanted of it now."""

from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc import Experiment, Params, design, evaluate
from jaxmpc.engine.base import scalars
from jaxmpc.law import force_control, gain_backoff
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.reference import split, told
from jaxmpc.loop.linear import AxisSignals, advance, start
from jaxmpc.stability.loop import contact_of
from tests.deploy import made

AHEAD = tuple(1.0 + 0.005 * k for k in range(1, 65))
"""Of a force of 1 N that is to rise by 5 N/s, 1 to 64 ms ahead [N]."""


def test_a_force_on_a_ramp_is_no_error_to_guard_and_listening() -> None:
    arm = made.arm_arguments()["arm"]
    gains = made.scheduled_gains()._replace(guard=gain_backoff.constants(made.T_S, FLOATS))
    measurement = made.Measurement(made.T_S, 0.5)
    law = force_control.Controller(arm["chain"], arm["nominal"], made.POSTURE, gains, made.K2, measurement)
    force = (1.0, 1.0, 1.0)
    begun = force_control.init(law, made.POSTURE, force)
    following, _ = force_control.step(law, begun, made.POSTURE, force, (AHEAD,) * 3, FLOATS, present=force)
    assert following.guard is not None
    assert following.guard.swing == following.guard.drift == 0.0
    assert [axis.tissue.strain for axis in following.axes if axis.tissue is not None] == [0.0] * 3
    # Without `present` the first of the reference is that of the sample, as where nothing is known ahead.
    later, _ = force_control.step(law, begun, made.POSTURE, force, (AHEAD,) * 3, FLOATS)
    assert later.guard is not None
    assert later.guard.swing > 0.0


def test_on_the_linear_loop_neither() -> None:
    params, path = Params.published("family"), Experiment.published("table-1").loop_path()
    law = jax.tree.map(float, scalars(design(params), preview=True))
    world = jax.tree.map(float, contact_of(810.0, params.K2, path))
    wanted = tuple(force - 1.0 for force in AHEAD)
    carry, _ = advance(law, world, 0.0, start(law), AxisSignals(0.0, 0.0, wanted, 1.0, wanted=0.0), FLOATS)
    assert carry.controller.tissue is not None
    assert carry.controller.tissue.strain == 0.0


@pytest.mark.oracle
def test_the_guard_on_the_arm_sees_the_error_that_metrics_tell() -> None:
    """Its gain is that of the guard's own filters over the measured force less what is wanted at that sample."""
    fast = {"z": [{"kind": "sweep", "amplitude": 2.0, "start": 8.0, "stop": 15.0, "duration": 1.0}], "preview": True}
    strong = dict.fromkeys(("torque_limit", "joint_torque_limit", "torque_step_limit"), [200.0] * 4)
    experiment = Experiment.from_dict(
        {"physics": "wam", "duration": 1.0, "settle": 0.5, "reference": fast, "stiffness": [810.0], "arm": strong}
    )
    outcome: Any = evaluate(Params(guarded=True), experiment, trace=True)
    assert not np.any(outcome.trace.clamped)
    wanted, constants = experiment.signals.force_ref, gain_backoff.constants(1e-3, FLOATS)

    def gain_over(wanted: np.ndarray) -> list[float]:
        state, found = gain_backoff.init(), []
        for error in (np.asarray(outcome.trace.force)[0].T - wanted).tolist():
            state = gain_backoff.step(constants, state, tuple(error), FLOATS)
            found.append(state.memory.gain)
        return found

    gain = np.asarray(outcome.trace.gain)[0, 0]
    np.testing.assert_allclose(gain, gain_over(wanted[:1000]), rtol=1e-9)
    assert np.abs(gain - gain_over(wanted[1:1001])).max() > 5e-3  # of the next sample's


def test_rows_that_hold_what_is_ahead_tell_what_was_wanted_of_each() -> None:
    came = [[float(10 * axis + k) for k in range(1, 9)] for axis in range(3)]
    rows = [[axis[k : k + 3] for axis in came] for k in range(5)]
    found = told(rows)
    assert [len(axis) for row in found for axis in row] == [4] * 15
    assert found[0][1] == (11.0, 11.0, 12.0, 13.0)  # nothing tells what was wanted before
    assert found[3][2] == (23.0, 24.0, 25.0, 26.0)
    assert split(found[3], 3) == ((3.0, 13.0, 23.0), ((4.0, 5.0, 6.0), (14.0, 15.0, 16.0), (24.0, 25.0, 26.0)))
    assert split([(1.0,), (2.0,), (3.0,)], 1) == ((1.0, 2.0, 3.0), ((1.0,), (2.0,), (3.0,)))
