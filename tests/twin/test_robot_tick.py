"""What the tick is measured beside, C MuJoCo and matrices that share no formula with it, asks for the same torques."""

import numpy as np
import pytest

from benchmarks import robot_tick
from deploy.controller.golden import arm_inputs
from tests.deploy import made


@pytest.mark.parametrize("preview", [False, True], ids=["constant", "preview"])
def test_the_peer_of_the_tick_asks_for_the_same_torques(preview):
    artifact = made.arm_artifact(100, preview=preview)
    rows = [tuple(map(tuple, row)) for row in arm_inputs(artifact)]
    ticks = [make(artifact, rows) for make in (robot_tick.recorded, robot_tick.by_mujoco)]
    ours, theirs = ([tick(k) for k in range(100)] for tick in ticks)
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-10)  # rounding makes 1e-12 [N m]
