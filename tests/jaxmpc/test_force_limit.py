"""A run that blows up is never OK, and what the arm can give stands in the simulation."""

from pathlib import Path

import numpy as np
import pytest

from jaxmpc import Experiment, Params, Status, evaluate
from jaxmpc.cli import main
from jaxmpc.loop.linear import HIGHEST_ERROR
from tests.jaxmpc.arm_tables import TABLE, changed

PRESSED = Experiment.from_dict({"duration": 4.05, "settle": 3.0, "stiffness": [810.0]})
"""5 N wanted at once."""


def test_a_force_beyond_its_limit_is_a_status_with_its_moment_and_its_metrics() -> None:
    free = evaluate(Params(), PRESSED)
    held = evaluate(Params(), changed(PRESSED, force_limit=4.0))
    assert (free.status.tolist(), held.status.tolist()) == ([Status.OK], [Status.FORCE_LIMIT])
    assert np.isnan(free.when[0])
    assert held.when[0] < 1.0
    for one, other in zip(held.metrics, free.metrics, strict=True):
        np.testing.assert_array_equal(one, other)


def test_ramps_and_settling_count_for_the_residual_too() -> None:
    """The step of the reference comes before anything is scored; the force itself may be as large as it likes."""
    ramp = ({"kind": "ramp", "to": -1.2 * HIGHEST_ERROR, "rate": 1e4},)
    stepped = Experiment.from_dict({**PRESSED.to_dict(), "reference": {"z": ramp}, "force_limit": 1000.0})
    found = evaluate(Params(), stepped)
    assert float(np.max(found.metrics.peak_error)) < 1.0
    assert found.status.tolist() == [Status.FORCE_LIMIT]


def test_simulate_says_why_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "pressed.toml"
    file.write_text("duration = 4.05\nsettle = 3.0\nstiffness = [810.0]\nforce_limit = 4.0\n")
    assert main(["simulate", str(file), "-o", str(tmp_path / "out")]) == 1
    assert "FORCE_LIMIT" in capsys.readouterr().out


def test_a_length_that_no_stretch_divides_ends_with_its_last_sample() -> None:
    """What lies beyond it must not be measured: a heart that jumps home would show in the peak."""
    whole = evaluate(Params(), changed(PRESSED, duration=4.125), trace=True)
    part = evaluate(Params(), PRESSED)
    peak = np.abs(np.asarray(whole.trace.force)[..., :4050]).max(axis=-1)  # type: ignore[union-attr]  # asked for
    np.testing.assert_array_equal(part.metrics.peak_force, peak)


@pytest.mark.oracle
def test_a_reference_left_out_on_the_arm_is_no_good_run() -> None:
    """5 N at once on a stiff tissue is more than the arm's torques can follow: its force swings out of bounds."""
    at_once = changed(TABLE, duration=5.0, settle=3.0, reference={"z": -5.0})
    found = evaluate(Params(), at_once)
    assert found.status.tolist()[1:] == [Status.FORCE_LIMIT] * 2
    assert (np.asarray(found.metrics.clamped)[1:] > 0.5).all()
    ramped = evaluate(Params(), changed(TABLE, duration=5.0, settle=3.0))
    assert ramped.status.tolist() == [Status.OK] * 3
    assert (np.asarray(ramped.metrics.clamped) == 0.0).all()


@pytest.mark.oracle
def test_a_narrow_limit_of_the_torques_acts_and_one_of_zero_does_not() -> None:
    brief = changed(TABLE, duration=5.0, settle=3.0)
    nominal, narrow, none = (
        evaluate(Params(), changed(brief, arm={"torque_step_limit": (limit,) * 4})) for limit in (10.0, 0.3, 0.0)
    )
    assert (np.asarray(narrow.metrics.clamped) > 0.01).all()
    assert (np.asarray(narrow.metrics.rms) != np.asarray(nominal.metrics.rms)).all()
    np.testing.assert_array_equal(none.metrics.rms, nominal.metrics.rms)
