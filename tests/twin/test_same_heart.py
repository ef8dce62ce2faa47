"""A flight is compared with a simulation on the stretch of the heart's motion that both met."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as changed

from deploy.controller.artifact import Artifact
from deploy.controller.file import to_bytes
from deploy.twin.flight import TwinFlight, fly
from deploy.twin.scenario import twin_settings
from jaxmpc import Experiment, Params, evaluate
from jaxmpc.world.heart.motion import displacement

pytestmark = pytest.mark.oracle
TABLE = changed(Experiment.published("table-1-wam").with_seed(1000), stiffness=(810.0,), duration=22.0, settle=8.0)
SECONDS, SETTLE = 16.0, 6.0


@pytest.fixture(scope="module")
def flight(cautious: Artifact, tmp_path_factory: pytest.TempPathFactory) -> TwinFlight:
    folder = tmp_path_factory.mktemp("flight")
    file: Path = folder / "controller.npz"
    file.write_bytes(to_bytes(cautious))
    settings = replace(twin_settings("table-1-wam", stiffness=810.0, gap=0.005, seed=1000), motion=TABLE.motion)
    return fly(file, settings, "0,0,-5@2", SECONDS, folder / "flight.npz")


def test_it_tells_where_in_the_hearts_motion_contact_began(flight: TwinFlight) -> None:
    """Under a spring, the heart is where the tip is less the force over the stiffness: a lag shows to a millisecond."""
    rows = slice(6000, 14_000)
    seen = flight.signals["tip"][rows] - flight.true_force[rows] / 810.0
    misses = []
    for lag in range(-20, 21):
        heart, _ = displacement(TABLE.motion, flight.began + flight.time[rows] + 1e-3 * lag)
        misses.append(np.std(seen - heart, axis=0).max())
    assert abs(int(np.argmin(misses)) - 20) <= 1
    assert min(misses) < 5e-5
    assert flight.began > 0.5


def test_it_leaves_what_the_simulation_leaves_there(flight: TwinFlight) -> None:
    """Other physics, integrator, noise and rounding cost under 3 %; another stretch of the motion alone up to 8 %."""
    trace = evaluate(Params.published("cautious"), TABLE, trace=True).trace
    assert trace is not None
    error = np.asarray(trace.force)[0] - np.asarray(trace.force_ref)[0, :, :, 0]
    first, last = (round(1e3 * (flight.began + time)) for time in (SETTLE, SECONDS))
    simulated = np.sqrt(np.mean(error[:, first:last] ** 2, axis=1))
    measured, _ = flight.rms(SETTLE)
    np.testing.assert_allclose(measured, simulated, rtol=0.03)
