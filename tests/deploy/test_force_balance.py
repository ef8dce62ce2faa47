"""The force sensor against the motors: both sides of every bound."""

import random

import numpy as np
import pytest

from deploy.controller.runtimes import flown_controller
from deploy.safety.force_balance import (
    ASIDE,
    PUSH,
    SAMPLES,
    UNLEARNED,
    BalanceState,
    balance_step,
)
from deploy.safety.force_estimate import BANDWIDTH, ForceEstimate
from deploy.safety.reasons import Reason
from jaxmpc.law.chain import inverse_dynamics, mass_matrix, pose, tip, with_point_mass
from jaxmpc.law.ops import FLOATS
from tests.deploy.made import POSTURE, T_S

LEARNED_FROM, LEARNED_TO = 200, 400
"""Samples at 1 kHz."""
UP = (0.0, 0.0, 1.0)
NONE = (0.0, 0.0, 0.0)


def learned(air=2.0):
    """After an approach through air in which the motors tell of so much push [N]."""
    state = BalanceState()
    for k in range(LEARNED_TO):
        # What comes before the arm moves steadily is none of the air's.
        told = -air if k >= LEARNED_FROM else 1.0
        state, reason = balance_step(state, (0.0, 0.0, told), NONE, NONE, UP, True, T_S)
        assert reason is None
    return state


def after(state, estimate, force, cycles, approaching=False, normal=UP):
    """The reasons of so many cycles."""
    reasons = []
    for _ in range(cycles):
        state, reason = balance_step(state, estimate, force, NONE, normal, approaching, T_S)
        reasons.append(reason)
    return reasons


def test_the_air_is_learned_once_on_the_way_down():
    state = learned(2.0)
    assert state.air == pytest.approx(2.0)
    for _ in range(300):  # a press that the sensor does not tell of is never taken for air
        state, _ = balance_step(state, (0.0, 0.0, -6.0), NONE, NONE, UP, True, T_S)
    assert state.air == pytest.approx(2.0)
    assert BalanceState().air == BalanceState(samples=100, learned=1e3).air == UNLEARNED


@pytest.mark.parametrize("approaching", [False, True])
def test_a_push_beyond_the_reading_is_seen_above_its_bound_and_not_below(approaching):
    state = learned(2.0)
    assert set(after(state, (0.0, 0.0, -2.0 - PUSH + 0.01), NONE, 50, approaching)) == {None}
    reasons = after(state, (0.0, 0.0, -2.0 - PUSH - 0.01), NONE, 50, approaching)
    assert reasons == [None] * (SAMPLES - 1) + [Reason.FORCE_MODEL] * (51 - SAMPLES)


def test_what_is_read_is_no_push_beyond_it_and_less_push_than_read_is_none_either():
    state = learned(2.0)
    for _ in range(200):
        state, reason = balance_step(state, (0.0, 0.0, -12.0), (0.0, 0.0, -10.0), NONE, UP, False, T_S)
    assert reason is None
    assert set(after(learned(2.0), (0.0, 0.0, 9.0), (0.0, 0.0, -10.0), 100)) == {None}


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_across_the_normal_friction_counts_either_way(axis, sign):
    for size, expected in ((ASIDE - 0.01, {None}), (ASIDE + 0.01, {None, Reason.FORCE_MODEL})):
        estimate = [0.0, 0.0, 0.0]
        estimate[axis] = sign * size
        assert set(after(learned(), tuple(estimate), NONE, 20)) == expected


def test_the_normal_may_point_anywhere():
    state = learned(0.0)
    assert set(after(state, (-PUSH - 0.1, 0.0, 0.0), NONE, 9, normal=(1.0, 0.0, 0.0))) == {None, Reason.FORCE_MODEL}
    assert set(after(state, (PUSH + 0.1, 0.0, 0.0), NONE, 9, normal=(1.0, 0.0, 0.0))) == {None}


def test_a_single_outlier_is_none_and_a_lost_reading_changes_nothing():
    state = learned(0.0)
    for k in range(60):
        wild = k % SAMPLES != SAMPLES - 1
        state, reason = balance_step(state, (0.0, 0.0, -20.0 if wild else 0.0), NONE, NONE, UP, False, T_S)
        assert reason is None
    before = state.reading
    state, _ = balance_step(state, NONE, None, NONE, UP, False, T_S)
    assert state.reading == before


def test_the_reading_and_the_way_of_the_tip_are_made_as_slow_as_the_estimate():
    state = BalanceState()
    for _ in range(round(1.0 / (BANDWIDTH * T_S))):
        state, _ = balance_step(state, NONE, (0.0, 0.0, -1.0), (0.0, 0.0, -1.0), UP, False, T_S)
    assert state.reading[2] == pytest.approx(-(1.0 - np.exp(-1.0)), abs=0.02)
    assert state.slip == pytest.approx(state.reading[2])


@pytest.mark.parametrize("moving", [False, True])
def test_the_motors_tell_a_known_force_on_an_arm_that_moves(arm_artifact, moving):
    """An exact arm of the model's own masses, its torques worked out by inverse dynamics: no code of the estimate's."""
    model = arm_artifact.arm
    estimate = ForceEstimate(model, flown_controller(arm_artifact)[0].measurement._replace(velocity_pole=0.0))
    nominal = model.nominal
    chain = with_point_mass(model.chain, nominal.tool_error / nominal.mass_scale)
    force, t = np.array((1.0, -2.0, -6.0)), np.arange(0.0, 0.4, T_S)
    sway = np.array((0.05, 0.04, 0.06, 0.05)) * moving
    phase = np.array([random.Random(4).uniform(0.0, 6.0) for _ in range(4)])
    turn = 2.0 * np.pi * 2.0
    last = np.zeros(4)
    found = []
    for now in t:
        q = tuple((np.array(POSTURE) + sway * np.sin(turn * now + phase)).tolist())
        qd = tuple((turn * sway * np.cos(turn * now + phase)).tolist())
        qdd = (-turn * turn * sway * np.sin(turn * now + phase)).tolist()
        if now == 0.0:
            estimate.start(qd)
        found.append(estimate.step(q, qd, tuple(last.tolist())))
        at = pose(chain, q, FLOATS)
        own = nominal.mass_scale * np.array(inverse_dynamics(chain, at, qd, tuple(qdd)))
        jacobian = np.array(tip(chain, at).jacobian)
        last = own + np.array(model.chain.armature) * np.array(qdd) + jacobian.T @ force
        assert np.all(np.linalg.eigvalsh(np.array(mass_matrix(chain, at))) > 0.0)
    np.testing.assert_allclose(found[-1], force, atol=0.35 if moving else 1e-3)
    rising = np.array(found)[:, 2] / force[2]
    assert 0.4 < rising[round(1.0 / (BANDWIDTH * T_S))] < 0.85  # some 10 ms late


def test_the_force_that_is_read_is_told_as_late_as_what_the_motors_tell(arm_artifact):
    """Against the tip's place by differences; a force that is gone explains nothing some 10 ms later."""
    model, force = arm_artifact.arm, np.array((3.0, -2.0, -6.0))
    estimate, chain = ForceEstimate(model, flown_controller(arm_artifact)[0].measurement), model.chain
    q, step = np.array(POSTURE) + 0.1, 1e-6

    def place(q):
        return np.array(tip(chain, pose(chain, tuple(q.tolist()), FLOATS)).position)

    whole = [force @ (place(q + step * e) - place(q - step * e)) / (2.0 * step) for e in np.eye(4)]
    none, samples = (0.0,) * 4, round(1.0 / (BANDWIDTH * T_S))
    for reading, share in ((tuple(force.tolist()), 1.0 - np.exp(-1.0)), (None, np.exp(-1.0) * (1.0 - np.exp(-1.0)))):
        for _ in range(samples):
            estimate.step(tuple(q.tolist()), none, none, reading)
        np.testing.assert_allclose(estimate.read, share * np.array(whole), rtol=0.06, atol=1e-9)
    estimate.start(none)
    assert estimate.read == none
