"""A controller that filters the measured force: judged, frozen and flown as one loop."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from deploy.loop.loop import STATES
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from jaxmpc import Experiment, Params, evaluate, margins
from jaxmpc.export.freezing import freeze_controller
from jaxmpc.export.golden import read_in
from jaxmpc.world.heart.motion import Motion
from tests.twin.flying import fly

TABLE = Experiment.published("table-1-wam")
FILTERED = msgspec.structs.replace(
    TABLE, stiffness=(810.0,), duration=15.0, sensor=msgspec.structs.replace(TABLE.sensor, kalman=1.0)
)
"""So slow a filter that it takes the text design's M_s from 1.67 to 2.39."""


def evaluated_and_frozen(file, params, experiment):
    """One simulation for both."""
    outcome = evaluate(params, experiment, trace=True)
    (run,) = read_in(experiment, outcome.trace._asdict())
    return outcome, freeze_controller(file, params, experiment, {"M_s": 5.0}, ideal=False, run=run)


@pytest.mark.oracle
def test_a_frozen_force_filter_flies_as_it_is_simulated(tmp_path):
    params = Params.published("text")
    simulated, frozen = evaluated_and_frozen(tmp_path / "c.npz", params, FILTERED)
    path = FILTERED.loop_path()
    assert frozen.gains.force_filter == path.force_filter
    assert (frozen.loop.velocity_cutoff, frozen.loop.sensor_cutoff) == (path.velocity_cutoff, path.sensor_cutoff)

    row = frozen.margins[0]
    assert row["M_s"] == pytest.approx(float(margins(params, 810.0, path=path).M_s), rel=1e-9)
    assert row["M_s"] == pytest.approx(float(simulated.margins.M_s[0]), rel=1e-9)
    assert row["M_s"] > 1.3 * float(margins(params, 810.0, path=TABLE.loop_path()).M_s)

    flight = fly(frozen, stiffness=810.0, seconds=15.0, motion=Motion(start=3.5), gap=0.012)
    assert flight.reason is Reason.FINISHED
    np.testing.assert_allclose(flight.residual(5.0), np.asarray(simulated.metrics.rms)[0], rtol=0.05)
    # The filter is what keeps the sensor's noise from the arm.
    signals = flight.signals()
    asked = signals["a"][signals["state"][:, 0] == STATES.index(OperatingState.CONTACT)][5000:]
    chatter = np.sqrt(np.mean(np.diff(asked, axis=0) ** 2, axis=0))
    np.testing.assert_allclose(chatter, np.asarray(simulated.metrics.chatter)[0], rtol=0.1)
    plain = evaluate(params, msgspec.structs.replace(FILTERED, sensor=TABLE.sensor)).metrics.chatter[0]
    assert np.all(np.asarray(plain) > 1.2 * chatter)


@pytest.mark.oracle
def test_a_controllers_own_filters_fly_as_the_experiments(tmp_path):
    """The same runs and the same file but for its words; the robot's runtime replays its golden trace."""
    text = Params.published("text")
    theirs = msgspec.structs.replace(FILTERED, duration=4.0, settle=3.0, velocity_lowpass=320.0)
    ours = msgspec.structs.replace(theirs, velocity_lowpass=180.0, sensor=TABLE.sensor)
    own = replace(text, velocity_cutoff=320.0, force_cutoff=theirs.force_cutoff)
    found, first = evaluated_and_frozen(tmp_path / "own.npz", own, ours)
    expected, other = evaluated_and_frozen(tmp_path / "other.npz", text, theirs)
    for name, values in found.metrics._asdict().items():
        np.testing.assert_allclose(values, getattr(expected.metrics, name), rtol=1e-7, err_msg=name)

    assert first.loop == other.loop
    np.testing.assert_allclose(first.gains.force_filter, other.gains.force_filter, rtol=1e-12)
    np.testing.assert_allclose(first.golden_v, other.golden_v, atol=1e-7)
    np.testing.assert_allclose(first.arm.golden_torque, other.arm.golden_torque, atol=1e-6)
    frozen = [[row["M_s"] for row in each.margins] for each in (first, other)]
    np.testing.assert_allclose(*frozen, rtol=1e-9)
