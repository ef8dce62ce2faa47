"""Presliding margins against the arm itself, linearised joint by joint in numpy, and against those without friction."""

import math

import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import scipy.linalg

from jaxmpc import Experiment, InputError, Params, design, margins
from jaxmpc.law import chain as arm
from jaxmpc.stability.controller import controller_response
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.presliding import on_spring, presliding_frequencies, presliding_peak
from jaxmpc.stability.response import tip_response
from jaxmpc.world import contact
from jaxmpc.world.arm import chain
from jaxmpc.world.loop_path import loop_path
from tests.jaxmpc.test_computed_torque import Mujoco

T_S = 1e-3
TUNED = Params(K2=100.0, Khat_s=970.0, Q_p=10.0, T_cl=2e-4)


def base(**changes: object) -> Experiment:
    experiment = Experiment.published("table-1-wam")
    return msgspec.structs.replace(experiment, arm=msgspec.structs.replace(experiment.arm, **changes))


def joints_peak(params: Params, experiment: Experiment, K_s: float, delay: int) -> float:
    """Largest eigenvalue of the sensitivity at v and at a: four joints on their springs, tissue, computed torque.

    With the exact model: the acceleration wanted is what the tip does but for springs, null space and delay. Of its
    eigenvalues, because the modes are skew, and M_s is one of each.
    """
    settings, links = experiment.arm, chain()
    at = arm.pose(links, settings.posture, math)
    J, M = np.array(arm.tip(links, at).jacobian), np.array(arm.mass_matrix(links, at)) + np.diag(links.armature)
    inertia = np.linalg.inv(J @ np.linalg.solve(M, J.T))
    K = np.diag(settings.coulomb) / settings.presliding + K_s * J.T @ J
    flow = np.zeros((12, 12))
    flow[:4, 4:8], flow[4:8, :4], flow[4:8, 8:] = np.eye(4), -np.linalg.solve(M, K), np.linalg.inv(M)
    held = scipy.linalg.expm(flow * T_S)
    delays, worst = np.exp(-2j * np.pi * np.geomspace(1.0, 400.0, 600) * T_S), 0.0
    for q, C in zip(delays, np.asarray(controller_response(design(params), jnp.asarray(delays))), strict=True):
        angles, _ = np.split(np.linalg.solve(np.eye(8) / q - held[:8, :8], held[:8, 8:]) * q**delay, 2)
        low = [(1.0 - np.exp(-cut * T_S)) / (1.0 - np.exp(-cut * T_S) * q) for cut in (180.0, 1000.0 * np.pi)]
        rates, force = low[0] * (1.0 - q) / T_S * angles, low[1] * K_s * J @ angles
        resting = -20.0 * angles - 9.0 * rates
        inner = M @ resting + J.T @ (force - inertia @ J @ resting)
        wanted = np.linalg.solve(np.eye(4) - inner, J.T @ inertia)
        F, D = -C * force @ wanted, float(params.K2) * J @ rates @ wanted
        for loop in (F + D, F @ np.linalg.inv(np.eye(3) + D)):
            worst = max(worst, float(np.abs(1.0 / np.linalg.eigvals(np.eye(3) + loop)).max()))
    return worst


@pytest.mark.parametrize("tool_mass", [0.3, 0.8])
def test_the_modes_are_those_of_an_arm_that_a_force_at_its_tip_has_moved(tool_mass: float) -> None:
    """C MuJoCo's: what springs at the joints do to the tip after a push, which leaves the null space at rest.

    Its tool has 0.3 kg; more of it is mass at the tip.
    """
    experiment = base(tool_mass=tool_mass)
    arm = Mujoco(np.array(experiment.arm.posture), np.zeros(4))
    springs = np.array(experiment.arm.coulomb) / experiment.arm.presliding
    M = arm.M + (tool_mass - 0.3) * arm.J.T @ arm.J
    angles = np.linalg.solve(M, arm.J.T)  # a column for a push along each axis
    back = arm.J @ np.linalg.solve(M, springs[:, None] * angles)
    squares = np.linalg.eigvals(back @ np.linalg.inv(arm.J @ angles)).real
    np.testing.assert_allclose(presliding_frequencies(experiment), np.sqrt(np.sort(squares)), rtol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s"), [(Params(), 1900.0), (Params(), 375.0), (TUNED, 1900.0)])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_three_modes_stand_for_the_arm(params: Params, K_s: float, factor: float) -> None:
    """But for the motion of the null space, which the modes leave out."""
    experiment = base(coulomb=tuple(factor * value for value in base().arm.coulomb))
    found = presliding_peak(params, [K_s], presliding_frequencies(experiment))
    assert float(found[0]) == pytest.approx(joints_peak(params, experiment, K_s, 1), rel=0.02)


@pytest.mark.oracle
def test_springs_cost_the_text_design_margin() -> None:
    stuck = presliding_frequencies(base())
    free, sticking = (float(presliding_peak(Params(), [1900.0], w)[0]) for w in (0.0 * stuck, stuck))
    assert free == pytest.approx(4.52, abs=0.01)
    assert sticking > 1.05 * free


@pytest.mark.oracle
def test_without_friction_it_is_the_margin_as_it_runs() -> None:
    free = presliding_frequencies(base(coulomb=(0.0, 0.0, 0.0, 0.0)))
    np.testing.assert_array_equal(free, 0.0)
    for params, K_s, delay in ((Params(), 375.0, 1), (Params(), 810.0, 2), (TUNED, 1900.0, 1), (TUNED, 375.0, 2)):
        found = presliding_peak(params, [K_s], free, loop_path(delay=delay))
        np.testing.assert_allclose(found, margins(params, [K_s], delay).M_s, rtol=1e-9)


def test_unstable_is_no_peak() -> None:
    assert np.isinf(presliding_peak(Params(Khat_s=200.0), [1900.0], [70.0, 60.0, 50.0])).all()
    with pytest.raises(InputError, match="delay"):
        presliding_peak(Params(), [1900.0], [70.0], loop_path(delay=3))


def test_tip_on_a_spring_is_that_of_the_matrix_exponential() -> None:
    """From sample to sample, and in the frequency response, with the command a fraction of a sample later."""
    omega, state = 300.0, contact.init(0.0)
    held = on_spring(contact_of(1900.0, 0.0, loop_path()), omega)
    state = state._replace(x=2e-3, xdot=0.1, pending=(3.0, 0.0))
    moved, _ = contact.move(held, state, 0.0)
    flow = np.array([[0.0, 1.0, 0.0], [-(omega**2), 0.0, 1.0], [0.0, 0.0, 0.0]])
    whole = scipy.linalg.expm(flow * T_S)
    np.testing.assert_allclose([moved.x, moved.xdot], (whole @ [2e-3, 0.1, 3.0])[:2], rtol=1e-12)
    for late, theta in ((0.0, 0.2), (0.4, 0.2), (0.4, 2.0)):
        z, newer = np.exp(1j * theta), scipy.linalg.expm(flow * (1.0 - late) * T_S)[:2, 2]
        expected, _ = np.linalg.solve(z * np.eye(2) - whole[:2, :2], newer + (whole[:2, 2] - newer) / z) / z
        measured = (1.0 - 1.0 / z) * expected / T_S
        np.testing.assert_allclose(tip_response(held, theta, late), [expected, measured], rtol=1e-9)
