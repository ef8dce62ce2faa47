"""What swings: the filter against scipy's, the metrics of the joints and of the true force against stored runs."""

from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import scipy.signal

from jaxmpc import Experiment, Params, design, evaluate, metrics, swing
from jaxmpc.engine.scenario import scenario_data
from jaxmpc.experiment.reference import Reference
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.transmission import N1
from jaxmpc.world.heart.motion import Motion
from tests.jaxmpc.linear_loop import TEXT, step_by_step, world

pytestmark = pytest.mark.once

replace = msgspec.structs.replace
SECTIONS = scipy.signal.butter(4, swing.CORNER_HZ, "highpass", fs=1000.0, output="sos")


def above(force: Any) -> np.ndarray:
    """What scipy's Butterworth high-pass, at rest before, lets pass of a force (…, steps)."""
    passed: np.ndarray = scipy.signal.sosfilt(SECTIONS, np.asarray(force, np.float64), axis=-1)
    return passed


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-11), (np.float32, 1e-5)])
def test_the_filter_is_scipys(dtype: Any, tolerance: float) -> None:
    """White noise of 1 N upon −5 N; float32 keeps five of its digits."""
    force = (np.random.default_rng(0).normal(size=20_000) - 5.0).astype(dtype)
    filtering, state, found = swing.high_pass(dtype(1e-3), np), swing.rest(dtype(0.0)), []
    for value in force:
        passed, state = swing.step(filtering, state, value)
        found.append(passed)
    assert found[-1].dtype == dtype
    np.testing.assert_allclose(found, above(force), rtol=0.0, atol=5.0 * tolerance)


def test_its_gain_is_scipys() -> None:
    theta = np.geomspace(1e-2, 3.0, 50)
    _, expected = scipy.signal.sosfreqz(SECTIONS, theta)
    np.testing.assert_allclose(swing.gain(theta, 1e-3, np), np.abs(expected), rtol=1e-9)
    assert float(swing.gain(2.0 * np.pi * 0.012, 1e-3, np)) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("T_s", [0.01, 0.041])
def test_slow_samples_have_it_up_to_their_nyquist_frequency(T_s: float) -> None:
    theta = np.linspace(0.1, 3.1, 20)
    sections = scipy.signal.butter(4, swing.CORNER_HZ, "highpass", fs=1.0 / T_s, output="sos")
    _, expected = scipy.signal.sosfreqz(sections, theta)
    np.testing.assert_allclose(swing.gain(theta, T_s, np), np.abs(expected), rtol=1e-9)


@pytest.mark.parametrize("T_s", [0.05, 0.09])
def test_of_samples_that_hold_nothing_of_12_hz_nobody_knows_it(T_s: float) -> None:
    """Of samples 90 ms apart the filter let pass all that was below 5 Hz."""
    slow = Params(T_cl=2.0 * T_s, Q_p=0.01, K2=0.05 / T_s, Hp=10)
    still = Experiment(sampling_time=T_s, stiffness=(810.0,), duration=8.0, motion=Motion(scale=0.1))
    found = evaluate(slow, still).metrics
    assert np.isnan(found.swing).all()
    assert np.all(np.asarray(found.rms) > 0.1)
    assert np.isnan(swing.gain(1.0, T_s, np))


@pytest.mark.parametrize(
    ("duration", "settle", "samples"), [(12.05, 2.0, 10_000), (12.05, 3.0, 9050), (4.0, 3.0, 1000)]
)
def test_swinging_is_that_of_the_last_ten_seconds(duration: float, settle: float, samples: int) -> None:
    """And of a shorter run that after it has settled: contact begins with a blow of 5 N, which is no swing."""
    usual = Experiment.published("table-1")
    met = {"duration": duration, "settle": settle, "stiffness": (810.0,), "reference": Reference(z=-5.0)}
    outcome: Any = evaluate(Params(), replace(usual, **met), trace=True)
    passed = above(outcome.trace.true_force)
    late, found = passed[..., -samples:], np.asarray(outcome.metrics.swing)
    np.testing.assert_allclose(found, np.sqrt(np.mean(late**2, axis=-1)), rtol=1e-8)
    whole = np.sqrt(np.mean(passed**2, axis=-1))
    assert np.all(found[..., 2] < 0.1 * whole[..., 2])


def test_the_linear_loop_tells_it_only_when_asked() -> None:
    experiment = replace(Experiment.published("table-1"), duration=4.0, settle=3.0)
    gains, worlds = (jax.tree.map(lambda leaf: leaf[None], x) for x in (design(TEXT), world(TEXT, 810.0, 1, False)))
    contacts = jax.tree.map(lambda leaf: jnp.asarray(leaf)[:, None], worlds)
    scenes = [scenario_data(experiment, swinging) for swinging in (True, False)]
    asked, not_asked = (step_by_step(gains, contacts, scene.lsb, scene.signals)[0] for scene in scenes)
    assert np.isnan(not_asked.swing).all()
    assert np.isfinite(asked.swing).all()
    for name in set(asked._fields) - {"swing"}:
        np.testing.assert_array_equal(getattr(asked, name), getattr(not_asked, name), err_msg=name)


def test_metrics_of_joints_are_those_of_their_samples() -> None:
    """Clamps and torques count over the whole run, steps where an axis does; the largest torque is a negative one."""
    draw = np.random.default_rng(3)
    wanted, clamped, counts = draw.normal(size=(50, 4)), draw.random(50) < 0.3, np.arange(50) >= 20
    wanted[5, 1], wanted[30, 2] = -9.0, -7.0
    totals = metrics.no_joints(0.0)
    for k in range(1, 50):
        totals = metrics.add_joints(totals, bool(counts[k]), float(clamped[k]), wanted[k], wanted[k - 1], FLOATS)
    sums, extremes = metrics.no_sums(0.0), metrics.no_extremes(0.0)
    found = metrics.metrics(sums, extremes, 30, 50, None, totals, FLOATS)
    assert found.clamped == clamped[1:].sum() / 50
    assert found.joint_torque == 9.0
    assert found.torque_step == np.abs(np.diff(wanted, axis=0))[19:].max()


@pytest.mark.oracle
@pytest.mark.parametrize("physics", ["wam", "mjx"])
def test_metrics_of_the_arm_are_those_of_its_trace(physics: str) -> None:
    given, duration = Experiment.published("table-1-wam"), 11.0 if physics == "wam" else 4.0
    arm = replace(given.arm, integrator="leapfrog" if physics == "wam" else "euler")
    experiment = replace(given, stiffness=(810.0,), duration=duration, settle=3.0, physics=physics, arm=arm)
    outcome: Any = evaluate(Params(), experiment, trace=True)
    scored = experiment.signals.score[: experiment.steps].T

    def only(values: Any) -> np.ndarray:
        """Of the one stiffness."""
        return np.asarray(values)[0]

    trace, found = (type(part)(*map(only, part)) for part in (outcome.trace, outcome.metrics))
    true = trace.true_force - trace.force_ref[..., 0]
    rms = [np.sqrt(np.mean(row[counts] ** 2)) for row, counts in zip(true, scored, strict=True)]
    spans = [np.ptp(row[counts]) for row, counts in zip(true, scored, strict=True)]
    np.testing.assert_allclose(found.true_rms, rms, rtol=1e-9)
    np.testing.assert_allclose(found.true_peak_to_peak, spans, rtol=1e-9)
    late = above(trace.true_force)[:, 3000:]
    np.testing.assert_allclose(found.swing, np.sqrt(np.mean(late**2, axis=-1)), rtol=1e-7)
    np.testing.assert_allclose(found.joint_torque, [np.abs(trace.wanted).max()] * 3, rtol=1e-12)
    change = np.abs(np.diff(trace.wanted, axis=-1)).max(axis=0)[scored.any(axis=0)[1:]]
    np.testing.assert_allclose(found.torque_step, [change.max()] * 3, rtol=1e-9)
    # No limit acts: what is sent is what was wanted, rounded down to a count of the motor.
    assert (found.clamped == 0.0).all()
    assert 0.0 < np.abs(trace.torque - trace.wanted).max() < N1 * arm.torque_lsb
    # White noise of the sensor comes on top of what the loop leaves.
    assert (found.rms > found.true_rms).all()
