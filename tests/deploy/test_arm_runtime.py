"""The whole tick on the arm: against the law on floats to the last bit, and against tables and differences."""

import gc
import math
import sys

import numpy as np
import pytest

from deploy.controller.arm_model import published_tip
from deploy.controller.artifact import Artifact
from deploy.controller.golden import replay
from deploy.controller.runtimes import arm_runtime, flown_controller
from jaxmpc.files.errors import InputError
from jaxmpc.law import cascade, chain, force_control
from jaxmpc.law.gains import constant_reference
from jaxmpc.law.ops import FLOATS
from tests.deploy import made

Q, QD = (0.3, 0.8, -0.4, 1.9), (0.2, -0.1, 0.3, -0.2)
FORCE = (0.4, -0.2, -5.1)


@pytest.fixture
def runtime(arm_artifact):
    return arm_runtime(arm_artifact)


@pytest.fixture
def inputs(arm_artifact):
    arrays = (arm_artifact.arm.golden_q, arm_artifact.golden_force, arm_artifact.golden_force_ref)
    return list(zip(*(array.tolist() for array in arrays), strict=True))


def begun(runtime, inputs):
    """In contact after a few samples."""
    runtime.start(inputs[0][0])
    runtime.enter(inputs[0][1], inputs[0][0])
    for q, force, wanted in inputs[:10]:
        runtime.control(q, runtime.velocity(q), force, wanted)
    return inputs[10]


@pytest.mark.parametrize(
    ("gains", "more"),
    [(made.text_gains(), ()), (made.text_gains(), (1e-2, 1e-4)), (made.guarded_gains(), ())],
    ids=["text", "third order", "guarded"],
)
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("preview", [False, True])
def test_the_recorded_tick_is_the_law_on_floats_to_the_last_bit(preview, compensated, gains, more):
    artifact = made.arm_artifact(300, preview, compensated, gains=gains._replace(K=(*gains.K, *more)))
    assert replay(artifact) == (0.0, 0.0, 0.0)
    assert np.abs(artifact.arm.golden_applied - artifact.arm.golden_torque).max() > 0.1


def test_the_recorded_tick_with_the_momentum_observed_is_the_law_to_the_last_bit():
    observed, plain = made.arm_artifact(300, momentum_observer=60.0), made.arm_artifact(300)
    assert replay(observed) == (0.0, 0.0, 0.0)
    # The cascades see the same force: what is cancelled is in the torques alone, and rounds the change that a cut is.
    assert np.abs(observed.arm.golden_torque - plain.arm.golden_torque).max() > 1.0
    np.testing.assert_allclose(observed.golden_v, plain.golden_v, rtol=0, atol=1e-9)


def test_a_second_start_forgets_the_first(runtime, inputs):
    def ran():
        runtime.start(inputs[0][0])
        runtime.enter(inputs[0][1], inputs[0][0])
        return [runtime.control(q, runtime.velocity(q), force, wanted) for q, force, wanted in inputs]

    first = ran()
    runtime.servo(Q, QD, (1.0, 2.0, 3.0), FORCE)
    assert ran() == first


def test_after_a_sample_that_failed_all_is_forgotten(runtime, inputs):
    q, force, wanted = begun(runtime, inputs)
    before = runtime.p_hat
    with pytest.raises(ValueError, match="unpack"):
        runtime.control(q, runtime.velocity(q), (*force, 0.0), wanted)
    assert before != (0.0, 0.0, 0.0)
    assert runtime.p_hat == (0.0, 0.0, 0.0)


def test_velocities_follow_a_steady_turn_like_a_low_pass(runtime):
    runtime.start((0.0,) * 4)
    found = np.array([runtime.velocity((1e-3 * k, 0.0, -2e-3 * k, 0.0)) for k in range(1, 101)])
    expected = 1.0 - np.exp(-made.VELOCITY_CUTOFF * made.T_S * np.arange(1, 101))
    np.testing.assert_allclose(found, expected[:, None] * [1.0, 0.0, -2.0, 0.0], atol=1e-12)


def test_the_tip_is_where_the_published_table_puts_it(runtime):
    for q in np.random.default_rng(1).uniform(-2.0, 2.0, (50, 4)).tolist():
        np.testing.assert_allclose(runtime.tip(q), published_tip(q, made.TOOL), atol=1e-14)


def height_of_masses(q, believed):
    """Potential energy over g [kg m] from the tables in the Denavit-Hartenberg frames alone."""
    frame, total = np.eye(4), 0.0
    for i, angle in enumerate(q):
        a, alpha, d = ((0.0, -1, 0.0), (0.0, 1, 0.0), (0.045, -1, 0.55), (-0.045, 1, 0.0))[i]
        s, c = math.sin(angle), math.cos(angle)
        frame = frame @ np.array(
            [[c, 0.0, alpha * s, a * c], [s, 0.0, -alpha * c, a * s], [0.0, alpha, 0.0, d], [0.0, 0.0, 0.0, 1.0]]
        )
        total += believed.mass_scale * made.MASS[i] * (frame @ [*made.CENTRE[i], 1.0])[2]
    tool = (frame @ [0.0, 0.0, made.TOOL, 1.0])[2]
    return total + (believed.mass_scale * made.TOOL_MASS + believed.tool_error) * tool


def test_gravity_is_the_slope_of_the_potential_energy(runtime, arm_artifact):
    believed, h = arm_artifact.arm.nominal, 1e-6
    for q in np.random.default_rng(2).uniform(-2.0, 2.0, (20, 4)):
        slope = [
            (height_of_masses(q + h * e, believed) - height_of_masses(q - h * e, believed)) / (2.0 * h)
            for e in np.eye(4)
        ]
        # Central differences of something of size 20 lose 1e-9 to rounding.
        np.testing.assert_allclose(runtime.gravity(q.tolist()), made.GRAVITY * np.array(slope), atol=1e-7)


def believed_mass(arm, q):
    """Mass matrix that the controller believes in, from the torques of unit accelerations."""
    rest = np.array(chain.inverse_dynamics(arm.chain, chain.pose(arm.chain, q, math), (0.0,) * 4, (0.0,) * 4))
    rows = [
        np.array(chain.inverse_dynamics(arm.chain, chain.pose(arm.chain, q, math), (0.0,) * 4, tuple(e))) - rest
        for e in np.eye(4)
    ]
    return arm.nominal.mass_scale * np.array(rows) + np.diag(made.ARMATURE)


def slope_of_tip(q):
    h = 1e-6
    columns = [published_tip(q + h * e, made.TOOL) - published_tip(q - h * e, made.TOOL) for e in np.eye(4)]
    return np.array(columns).T / (2.0 * h)


def test_observers_are_told_what_a_clamp_means_at_the_tip(runtime, inputs, arm_artifact):
    q, force, wanted = begun(runtime, inputs)
    torque = runtime.control(q, runtime.velocity(q), force, wanted)
    change = np.array([0.3, -1.0, 0.2, 0.4])
    runtime.applied(tuple(np.add(torque, change).tolist()))
    J = slope_of_tip(np.array(q))
    M = believed_mass(arm_artifact.arm, q) + arm_artifact.arm.nominal.tool_error * J.T @ J
    expected = np.array(runtime.last_v) + J @ np.linalg.solve(M, change)
    # Central differences of the tip are good to 1e-9; a newton metre moves it by 1 m/s².
    np.testing.assert_allclose(runtime._applied, expected, atol=1e-7)
    runtime.applied(torque)
    runtime.control(q, runtime.velocity(q), force, wanted)


def test_untouched_torques_tell_the_observers_nothing(arm_artifact, inputs):
    told, silent = arm_runtime(arm_artifact), arm_runtime(arm_artifact)
    begun(told, inputs), begun(silent, inputs)
    for q, force, wanted in inputs[10:]:
        torque = told.control(q, told.velocity(q), force, wanted)
        told.applied(torque)
        assert silent.control(q, silent.velocity(q), force, wanted) == torque


def test_servo_asks_the_same_torque_as_control_for_the_same_acceleration(runtime, inputs):
    q, force, wanted = begun(runtime, inputs)
    qd = runtime.velocity(q)
    torque = runtime.control(q, qd, force, wanted)
    assert runtime.servo(q, qd, runtime.last_a, tuple(force)) == torque


@pytest.mark.parametrize(
    "cancelling", [{}, {"compensated": True}, {"momentum_observer": 100.0}, {"gains": made.gains_alone()}]
)
def test_entry_is_bumpless(cancelling):
    """The tip moves while a servo pushes against friction; then the cascades take over without a step."""
    runtime, pushing = arm_runtime(made.arm_artifact(**cancelling)), (0.5, -0.3, -2.0)
    q = np.array(made.POSTURE)
    runtime.start(q)
    for _ in range(50):
        q = q + 1e-4
        before = runtime.servo(q.tolist(), runtime.velocity(q.tolist()), pushing, FORCE)
    runtime.enter(FORCE, q.tolist())
    after = runtime.control(q.tolist(), runtime.velocity((q + 1e-4).tolist()), FORCE, FORCE)
    # The gains have eight digits, so r − m_x − m_u is not exactly 0, which 90 m/s²/N multiplies.
    np.testing.assert_allclose(runtime.last_a, pushing, atol=2e-3)
    if "compensated" not in cancelling:  # else the friction that is cancelled has gone on by one sample
        np.testing.assert_allclose(after, before, atol=5e-3)
    held = [runtime.control(q.tolist(), runtime.velocity(q.tolist()), FORCE, FORCE) for _ in range(5)]
    assert np.isfinite(held).all()


def test_entry_at_rest_is_the_law_at_rest(runtime, arm_artifact):
    runtime.start(Q)
    runtime.enter(FORCE, Q)
    torque = runtime.control(Q, runtime.velocity(Q), FORCE, (0.0, 0.0, -5.0))
    controller, compensated = flown_controller(arm_artifact)
    state = force_control.init(controller, Q, FORCE, compensated)
    wanted = ((0.0,), (0.0,), (-5.0,))
    _, command = force_control.step(controller, state, Q, FORCE, wanted, FLOATS)
    assert torque == command.torque.torque


def test_a_lost_force_is_bridged_by_the_prediction(arm_artifact, inputs):
    lost, given = arm_runtime(arm_artifact), arm_runtime(arm_artifact)
    q, _, wanted = begun(lost, inputs)
    begun(given, inputs)
    before = lost.p_hat
    torque = lost.control(q, lost.velocity(q), None, wanted)
    # A prediction that comes true corrects nothing.
    assert lost.p_hat == before
    assert given.control(q, given.velocity(q), lost.last_force, wanted) == torque
    y, ydot, delayed = begun_state(arm_artifact, inputs).x_hat
    gains = arm_artifact.gains
    assert lost.last_force[0] == y + gains.phi[0] * ydot + gains.gamma[0] * delayed


def begun_state(artifact, inputs):
    """Cascade of X where `begun` leaves it: the law itself."""
    gains = constant_reference(artifact.gains)
    state = cascade.init(gains, inputs[0][1][0])
    for _, force, wanted in inputs[:10]:
        state, _ = cascade.step(gains, state, force[0], (wanted[0],))
    return state


def test_the_guard_takes_the_gain_back_until_contact_is_made_anew():
    artifact = made.arm_artifact(300, gains=made.guarded_gains())
    runtime = arm_runtime(artifact)
    arrays = (artifact.arm.golden_q, artifact.golden_force, artifact.golden_force_ref)
    inputs = list(zip(*(array.tolist() for array in arrays), strict=True))

    def swung():
        runtime.enter(inputs[0][1], inputs[0][0])
        assert runtime.gain == 1.0
        torques = [runtime.control(q, runtime.velocity(q), force, wanted) for q, force, wanted in inputs]
        assert runtime.gain < 0.5
        return torques

    runtime.start(inputs[0][0])
    assert runtime.gain == 1.0
    first = swung()
    # The tissue is taken for one that is stiffer by 1/√g, on which an acceleration moves the force by that much more.
    gains, (y, ydot, delayed) = artifact.gains, runtime._memory[:3]
    assert runtime.prediction[0] == pytest.approx(
        y + gains.phi[0] * ydot + gains.gamma[0] / math.sqrt(runtime.gain) * delayed, rel=1e-15
    )
    gain = runtime.gain
    runtime.servo(Q, QD, (0.0,) * 3, FORCE)
    assert runtime.gain == gain
    runtime.start(inputs[0][0])
    assert swung() == first


def test_everything_that_comes_out_is_a_plain_float(runtime, inputs):
    q, force, wanted = begun(runtime, [tuple(map(np.array, row)) for row in inputs])
    q, force, wanted = q.tolist(), force.tolist(), wanted.tolist()
    runtime.start(np.array(q))
    out = [*runtime.velocity(q), *runtime.servo(q, QD, (0.1, 0.0, 0.0), force)]
    runtime.enter(force, q)
    out += [
        *runtime.control(q, runtime.velocity(q), force, wanted),
        *runtime.last_v,
        *runtime.last_a,
        *runtime.last_force,
    ]
    out += [*runtime.p_hat, *runtime.u, runtime.gain, *runtime.gravity(q), *runtime.tip(q)]
    assert {type(each) for each in out} == {float}


def test_a_force_that_is_not_finite_stays_on_its_axis_of_the_cascade(runtime, inputs):
    q, (x, y, _), wanted = begun(runtime, inputs)
    torque = runtime.control(q, runtime.velocity(q), (x, y, math.nan), wanted)
    assert all(map(math.isnan, torque))
    assert [math.isnan(p) for p in runtime.p_hat] == [False, False, True]


def test_a_linear_artifact_drives_no_arm(arguments):
    force, force_ref, v = arguments.pop("golden")
    linear = Artifact(**arguments, preview=False, golden_force=force, golden_force_ref=force_ref, golden_v=v)
    with pytest.raises(
        InputError, match=r"kind = linear: must be wam: a linear controller only replays\. Freeze it with"
    ):
        arm_runtime(linear)


def test_ticks_leave_nothing_behind(runtime, inputs):
    """A million of them do, too: `benchmarks/robot_tick.py` prints it."""
    ticks = [(tuple(q), tuple(force), tuple(wanted)) for q, force, wanted in inputs]

    def run(rounds):
        for _ in range(rounds):
            for q, force, wanted in ticks:
                torque = runtime.control(q, runtime.velocity(q), force, wanted)
                runtime.applied((torque[0], torque[1], torque[2], 0.0))

    begun(runtime, inputs)
    gc.collect()
    run(10)  # a collection empties Python's store of free numbers and tuples
    collections = [stage["collections"] for stage in gc.get_stats()]
    blocks = sys.getallocatedblocks()
    run(100)
    assert [stage["collections"] for stage in gc.get_stats()] == collections
    assert sys.getallocatedblocks() - blocks < 50


def test_a_torque_that_was_cut_once_is_not_told_again():
    """The momentum observer is told what the limits changed of the last sample alone."""
    artifact = made.arm_artifact(momentum_observer=60.0)
    runtime, q, force = arm_runtime(artifact), artifact.arm.posture, (0.0, 0.0, -1.0)
    runtime.start(q)
    runtime.enter(force, q)
    wanted = runtime.control(q, runtime.velocity(q), force, force)
    runtime.applied((wanted[0] - 1.0, *wanted[1:]))
    assert runtime._change != (0.0,) * 4
    runtime.applied(runtime.control(q, runtime.velocity(q), force, force))
    assert runtime._change == (0.0,) * 4
