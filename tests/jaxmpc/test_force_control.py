"""The whole controller at one sample, put together by hand from its parts and C MuJoCo's arm."""

from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from jaxmpc import Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.law import cascade, entry, force_control, gain_backoff, identification, pulse, repetition, schedule
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.force_control import Command, Controller, ControllerState
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.law.gains import Gains, backed_off
from jaxmpc.law.measurement import Measurement
from jaxmpc.law.ops import FLOATS
from jaxmpc.world.arm import chain
from tests.jaxmpc.test_computed_torque import POSTURE, Mujoco

T_S, POLE, BANDWIDTH, FIXED_K2 = 1e-3, 0.8, 60.0, 40.0
WANTED = ((0.1,), (-0.2,), (-5.0,))


class Sample(NamedTuple):
    controller: Controller
    before: ControllerState
    q: np.ndarray
    qd: np.ndarray
    force: np.ndarray
    after: ControllerState
    command: Command


@pytest.fixture(scope="module")
def sample() -> Sample:
    """Of the published family, its axes between fixed and known gains, when all of its parts have something to do."""
    gains: Gains = jax.tree.map(float, scalars(design(Params.published("family")), preview=False))
    gains = gains._replace(force_filter=ForceFilter(T_S, 0.6, 200.0))
    nominal = Nominal(1.0, 0.0, NominalFriction((0.0,) * 4, (0.0,) * 4, 1e-3))
    measurement = Measurement(T_S, POLE)
    controller = Controller(chain(), nominal, tuple(POSTURE.tolist()), gains, FIXED_K2, measurement, BANDWIDTH)
    random, q = np.random.default_rng(2), POSTURE.copy()
    state = force_control.init(controller, tuple(q.tolist()), (0.0, 0.0, -5.0))
    for k in range(400):
        q = q + T_S * np.array([0.1, -0.2, 0.15, 0.3]) * np.cos(0.02 * k)
        force = random.normal((0.0, 0.0, -5.0), 0.3)
        axes = tuple(
            axis._replace(tissue=axis.tissue._replace(authority=w, log_stiffness=np.log(K), listening=0.7))
            for axis, w, K in zip(state.axes, (0.3, 0.7, 1.0), (500.0, 900.0, 1500.0), strict=True)
        )
        memory = gain_backoff.BackoffMemory(0.6, 0.8, 0.7)
        before = state._replace(axes=axes, guard=state.guard._replace(memory=memory))
        state, command = force_control.step(
            controller, before, tuple(q.tolist()), tuple(force.tolist()), WANTED, FLOATS
        )
    return Sample(controller, before, q, np.array(state.measured.velocity), force, state, command)


def close(found: Any, expected: Any) -> None:
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def by_hand(sample: Sample) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Guard, commands v, accelerations a, and what the tip's velocity tells of the heart."""
    gains, before, after = sample.controller.gains, sample.before, sample.after
    speed = Mujoco(sample.q, sample.qd).J @ sample.qd
    tissues = [axis.tissue for axis in after.axes]
    answers = [identification.answer(gains.schedule.identification, tissue) for tissue in tissues]
    dithers = [identification.dither(gains.schedule.identification, tissue) for tissue in tissues]
    filtered = [cascade.filter_force(gains, *each) for each in zip(before.axes, sample.force.tolist(), strict=True)]
    error = tuple(y - answer - w[0] for (_, y), answer, w in zip(filtered, answers, WANTED, strict=True))
    guard = gain_backoff.step(gains.guard, before.guard, error, FLOATS, (*dithers, *answers))
    learning = gains.schedule.repetition
    heart, sure = pulse.step(learning.finder, before.pulse, float(speed[2]), FLOATS)
    beat, v, a = repetition.beat_of(learning, heart, FLOATS), [], []
    for i, (axis, y) in enumerate(filtered):
        sureness = sure * tissues[i].authority
        learned, added = repetition.step(learning, axis.learned, beat, error[i], sureness, FLOATS)
        axis = axis._replace(tissue=tissues[i], learned=learned)
        known, K2 = schedule.now(gains, FIXED_K2, axis, FLOATS)
        known = backed_off(known, guard.memory.gain, FLOATS)
        following, command = cascade.respond(known, axis, y, (WANTED[i][0] + dithers[i] + added,))
        close(after.axes[i], following)
        v.append(command)
        a.append(command - K2 * speed[i])
    return guard, np.array(v), np.array(a), np.array(jax.tree.leaves(heart))


def test_each_part_is_given_what_is_its_own(sample: Sample) -> None:
    guard, v, a, heart = by_hand(sample)
    close(sample.after.guard, guard)
    close(np.array(jax.tree.leaves(sample.after.pulse)), heart)
    close(np.array(sample.command.v), v)
    close(np.array(sample.command.a), a)
    assert np.abs(v - a).max() > 0.1
    assert guard.memory.gain < 0.7


def torque_of(sample: Sample) -> tuple[Mujoco, np.ndarray]:
    """Computed torque (1)–(4) in numpy, on MuJoCo's matrices, for the acceleration that is asked for."""
    arm = Mujoco(sample.q, sample.qd)
    resting = -20.0 * (sample.q - POSTURE) - 9.0 * sample.qd
    inertia = np.linalg.inv(arm.J @ np.linalg.solve(arm.M, arm.J.T))
    w = np.array(sample.command.a) - arm.drift - arm.J @ resting
    y = np.array([cascade.filter_force(sample.controller.gains, *each)[1] for each in forces(sample)])
    return arm, arm.M @ resting + arm.J.T @ (inertia @ w + y) + arm.bias


def forces(sample: Sample) -> Any:
    return zip(sample.before.axes, sample.force.tolist(), strict=True)


def test_the_torque_is_the_computed_one_less_the_disturbance_of_the_momentum(sample: Sample) -> None:
    _, torque = torque_of(sample)
    residual = np.array(sample.after.momentum.residual)
    assert np.abs(residual).max() > 0.1
    np.testing.assert_allclose(sample.command.torque.torque, torque - residual, rtol=0, atol=1e-8)


def test_observers_and_guard_are_told_what_the_limits_let_pass(sample: Sample) -> None:
    """Of the torque that passes what holds the arm against gravity and tissue accelerates nothing: w = n + r."""
    change = np.array([2.0, -5.0, 1.0, 0.5])
    passed = tuple(np.array(sample.command.torque.torque) + change)
    told = force_control.applied(sample.after, sample.command, passed)
    arm, torque = torque_of(sample)
    lost = arm.J @ np.linalg.solve(arm.M, change)
    np.testing.assert_allclose([axis.v for axis in told.axes], sample.command.v + lost, rtol=0, atol=1e-8)
    assert told.guard.held_back == pytest.approx(lost @ lost, rel=1e-9)
    residual = np.array(told.momentum.residual)
    y = np.array([cascade.filter_force(sample.controller.gains, *each)[1] for each in forces(sample)])
    accelerating = torque - residual + change - arm.bias - arm.J.T @ y + residual
    np.testing.assert_allclose(told.momentum.accelerating, accelerating, rtol=0, atol=1e-8)


def test_contact_goes_on_with_what_was_asked_before(sample: Sample) -> None:
    """The active state holds it: p̂ = −(a + K₂ẋ), with the fixed damping, which is what acts at first."""
    a = (0.4, -0.3, 0.2)
    begun = entry.enter(sample.controller, sample.after, (0.0, 0.0, -1.0), a, FLOATS)
    v = a + FIXED_K2 * Mujoco(sample.q, sample.qd).J @ sample.qd
    np.testing.assert_allclose([axis.v for axis in begun.axes], v, rtol=1e-9)
    np.testing.assert_allclose([axis.p_hat for axis in begun.axes], -v, rtol=1e-9)
    assert begun.momentum.velocity == sample.after.measured.velocity
    assert max(np.abs(begun.momentum.residual)) == 0.0
    assert begun.guard.memory.gain == 1.0


def test_a_lost_force_is_predicted_with_the_gains_of_the_moment(sample: Sample) -> None:
    """Without a filter, which would predict it: the observer's own model of what the applied command does."""
    plain = sample.controller.gains._replace(force_filter=None)
    controller = sample.controller._replace(gains=plain)
    axes = tuple(axis._replace(filtered=None) for axis in sample.after.axes)
    found = entry.expected_force(controller, sample.after._replace(axes=axes), FLOATS)
    for axis, force in zip(axes, found, strict=True):
        known, _ = schedule.now(plain, FIXED_K2, axis, FLOATS)
        known = backed_off(known, sample.after.guard.memory.gain, FLOATS)
        y, ydot, last = axis.x_hat
        assert force == pytest.approx(y + known.phi[0] * ydot + known.gamma[0] * last, rel=1e-12)
    filtered = entry.expected_force(sample.controller, sample.after, FLOATS)
    expected = [axis.filtered.force + T_S * axis.filtered.rate for axis in sample.after.axes]
    np.testing.assert_allclose(filtered, expected, rtol=1e-12)


def test_a_gain_that_is_taken_back_slows_each_part_as_much_as_it_should() -> None:
    """At g = 1/4, √g = 1/2: the model's gain by √g, the feedback of the n-th of force, rate and input by √g³⁻ⁿ more.

    The input's estimate by g, the active state and its differences by √g more each.
    """
    whole = Gains(
        (1e-3, 0.99), (4.0, 8.0), (0.1, 2.0, 3.0, 5.0, 7.0, 11.0), (16.0, 12.0, 6.0), 16.0, (1.0,), (2.0, 3.0), 0.5, 9.0
    )
    less = backed_off(whole, 0.25, FLOATS)
    assert less == whole._replace(
        gamma=(8.0, 16.0),
        K=(0.1, 2.0, 3.0 / 4.0, 5.0 / 8.0, 7.0 / 16.0, 11.0 / 32.0),
        L=(16.0 / 8.0, 12.0 / 4.0, 6.0 / 2.0),
        input_gain=16.0 / 8.0,
        mpc_x=(2.0, 6.0),
        K_earlier=9.0 / 4.0,
    )
    assert backed_off(whole, 1.0, FLOATS) == whole
