"""The observer of the joints' momentum: on C MuJoCo's arm, against its textbook integral, scipy, and differences."""

from copy import copy
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.signal import TransferFunction
from scipy.signal import step as step_response

from jaxmpc import InputError, Params, design, evaluate
from jaxmpc.engine.base import scalars
from jaxmpc.experiment.build import robot_on_its_tissue, structure_of
from jaxmpc.law import momentum_observer
from jaxmpc.law.measurement import Measurement, MeasurementState, init, measure
from jaxmpc.law.momentum_observer import MomentumState, fastest
from jaxmpc.loop.arm import ArmLoop, ArmSignals, Cell, advance, start
from jaxmpc.world.arm import chain, model
from jaxmpc.world.joint_acceleration import accelerate
from jaxmpc.world.robot import HeartSample
from jaxmpc.xla import ops
from tests.jaxmpc.arm_tables import NO_COUNTS, TABLE, changed

T_S, CUTOFF = 1e-3, 180.0
DISTURBANCE = np.array([2.0, -1.5, 0.8, 0.5])
POSTURE = np.array([0.0, 0.7, 0.0, 2.2])


class Run(NamedTuple):
    residual: np.ndarray
    """r of the law (steps, 4) [N m]."""
    textbook: np.ndarray
    """The same by the integral [N m]."""


def on_mujoco(bandwidth: float, pole: float, swing: float, seconds: float, cancels: bool) -> Run:
    """The arm held in a posture by springs, sample by sample; a torque that nobody tells of begins at once.

    Everything that the observer is given comes from C MuJoCo: angles, mass matrix and bias, and torques a sample late.
    """
    compiled = copy(model())
    compiled.opt.timestep, compiled.dof_damping[:] = T_S, 0.0
    data, M = mujoco.MjData(compiled), np.zeros((compiled.nv, compiled.nv))
    data.qpos[:4] = POSTURE
    measurement, acting = Measurement(T_S, pole), np.zeros(4)
    mujoco.mj_forward(compiled, data)
    measured, late = init(tuple(POSTURE)), data.qfrc_bias[:4].copy()
    state = momentum_observer.init(measured.velocity)
    total, filtered, expected, before = np.zeros(4), np.zeros(4), [np.zeros(4)] * 2, np.zeros((4, 4))
    residuals, textbook, r, last = [], [], np.zeros(4), np.zeros(4)
    for k in range(round(seconds / T_S)):
        mujoco.mj_forward(compiled, data)
        mujoco.mj_fullM(compiled, data, M)
        mass, bias, angle = M[:4, :4].copy(), data.qfrc_bias[:4].copy(), data.qpos[:4].copy()
        measured = measure(measurement, measured, tuple(angle))
        velocity = np.array(measured.velocity)

        goal = POSTURE + swing * np.sin(2.0 * np.pi * 1.3 * T_S * k)
        wanted = mass @ (400.0 * (goal - angle) - 40.0 * velocity)
        state = momentum_observer.step(bandwidth, measurement, state, tuple(mass), tuple(velocity), tuple(wanted))
        residuals.append(state.residual)

        # r = K (p − Σ (f T + ΔM q̇)) with all of the sum kept, in numpy.
        total = total + T_S * filtered + ((mass - before) @ last if k else 0.0)
        r = bandwidth * (mass @ velocity - total)
        textbook.append(r)
        filtered = pole * filtered + (1.0 - pole) * 0.5 * (expected[-1] + expected[-2])
        expected, before, last = [*expected, wanted], mass, velocity

        data.qfrc_applied[:4] = late + DISTURBANCE
        late = wanted + bias - (np.array(state.residual) if cancels else 0.0)
        if not cancels:  # what nobody cancels is in n: w = n + r
            state = state._replace(accelerating=tuple(wanted + np.array(state.residual)))
            expected[-1] = wanted + np.array(state.residual)
        acting = data.qfrc_applied[:4]
        assert np.isfinite(acting).all()
        mujoco.mj_step(compiled, data)
    return Run(np.array(residuals), np.array(textbook))


def test_it_is_the_integral_of_the_textbook() -> None:
    """While the arm swings by 17°, so that its masses change; the sums round some 1e-16 of 20 N m s a sample."""
    found = on_mujoco(60.0, np.exp(-CUTOFF * T_S), 0.3, 1.0, cancels=True)
    assert np.abs(found.residual).max() > 1.0
    np.testing.assert_allclose(found.residual, found.textbook, rtol=0, atol=1e-9)


@pytest.mark.parametrize("cancels", [False, True])
@pytest.mark.parametrize("bandwidth", [20.0, 60.0, 100.0])
def test_a_constant_disturbance_is_found_whole(bandwidth: float, cancels: bool) -> None:
    found = on_mujoco(bandwidth, np.exp(-CUTOFF * T_S), 0.0, 2.0, cancels)
    # What is left is Coriolis and gravity between two samples, as the arm is pushed out of its posture and back.
    np.testing.assert_allclose(found.residual[-1], DISTURBANCE, rtol=0, atol=1e-3)


def test_its_time_constant_is_that_of_its_bandwidth() -> None:
    """Without a low-pass r is 1 − e^(−K t) but for the samples, half of K T_s; with one, of second order.

    Where r acts, a sample after it is known, it is late by exactly 1/K in the mean.
    """
    for bandwidth, cutoff in ((20.0, 0.0), (60.0, CUTOFF), (100.0, CUTOFF)):
        pole = float(np.exp(-cutoff * T_S)) if cutoff else 0.0
        share = on_mujoco(bandwidth, pole, 0.0, 0.5, cancels=True).residual / DISTURBANCE
        t = T_S * np.arange(len(share))
        poles = [1.0, cutoff, bandwidth * cutoff] if cutoff else [1.0, bandwidth]
        expected = step_response(TransferFunction([poles[-1]], poles), T=t)[1]
        np.testing.assert_allclose(share, expected[:, None] + np.zeros(4), rtol=0, atol=0.6 * bandwidth * T_S)
        late = T_S * (1.0 + np.sum(1.0 - share, axis=0))
        # The arm leaves its posture by a hundredth of a degree, and its masses change.
        np.testing.assert_allclose(late, 1.0 / bandwidth, rtol=0, atol=1e-5)


def radius_alone(bandwidth: float, T_s: float, cutoff: float, delay: int) -> float:
    """Largest |eigenvalue| of the observer on a mass of 1 kg m² whose torques act after so many samples [-]."""
    measurement = Measurement(T_s, float(np.exp(-cutoff * T_s)) if cutoff else 0.0)

    def sample(x: np.ndarray) -> np.ndarray:
        angle, speed, last, velocity, residual, expected, before, newest, older = x
        measured = measure(measurement, MeasurementState((last,), (velocity,)), (angle,)).velocity
        state = MomentumState((residual,), (expected,), (velocity,), (0.0,), (before,))
        state = momentum_observer.step(bandwidth, measurement, state, ((1.0,),), measured, (0.0,))
        torque = newest if delay == 1 else older
        moved = angle + T_s * speed + 0.5 * T_s * T_s * torque, speed + T_s * torque
        return np.array([*moved, angle, *measured, *state.residual, *state.expected, 0.0, -state.residual[0], newest])

    return float(np.abs(np.linalg.eigvals(np.stack([sample(one) for one in np.eye(9)], axis=1))).max())


@pytest.mark.parametrize(("delay", "any_filter"), [(1, 0.83), (2, 0.54)])
@pytest.mark.parametrize("T_s", [5e-3, 0.02])
def test_no_bandwidth_that_is_taken_swings_by_itself(T_s: float, delay: int, any_filter: float) -> None:
    """The free mass has both its poles at 1, which round to some 1e-8 of it."""
    most = fastest(T_s, delay)
    assert most == pytest.approx((0.5, 0.3)[delay - 1] / T_s)
    for cutoff in (0.0, 2.0, 20.0, CUTOFF, 1000.0):
        assert radius_alone(most, T_s, cutoff, delay) < 1.0 + 1e-6
        assert radius_alone(1.01 * any_filter / T_s, T_s, cutoff, delay) > 1.001


def test_a_bandwidth_too_large_for_the_samples_is_refused() -> None:
    """At 8 ms, where `margins` told of M_s = 2.74, an observer of 100 rad/s pressed with 234 N (RMS)."""
    bound = r"arm\.momentum_observer = 100\.0: must be at most {} rad/s at a sampling time of {} s and a delay of {}"
    for T_s, delay, most in ((0.008, 1, "62.5"), (0.005, 2, "60")):
        with pytest.raises(InputError, match=bound.format(most, T_s, delay)):
            changed(TABLE, sampling_time=T_s, delay=delay, arm={"momentum_observer": 100.0})
    assert changed(TABLE, sampling_time=0.005, arm={"momentum_observer": 100.0}).arm.momentum_observer == 100.0
    linear = changed(TABLE, physics="linear", sampling_time=0.01, arm={"momentum_observer": 100.0})
    assert linear.physics == "linear"


def test_one_way_to_cancel_friction() -> None:
    with pytest.raises(InputError, match=r"arm\.momentum_observer = 60\.0: must be 0 beside arm\.compensation = 0\.7"):
        changed(TABLE, arm={"compensation": 0.7, "momentum_observer": 60.0})


STILL = HeartSample((0.0,) * 3, (0.0,) * 3)


def swung(point: jax.Array, steps: int = 300) -> jax.Array:
    """Mean square of the force's error over a step of the wanted force, for ln K̂_s and ln K."""
    experiment = changed(
        TABLE,
        stiffness=(810.0,),
        sensor=NO_COUNTS,
        arm={
            "encoder_counts": 0,
            "torque_lsb": 0.0,
            "torque_limit": (200.0,) * 4,
            "joint_torque_limit": (0.0,) * 4,
            "torque_step_limit": (0.0,) * 4,
            "momentum_observer": 60.0,
        },
    )
    gains = scalars(design(Params(Khat_s=jnp.exp(point[0]))), preview=False)
    robot = robot_on_its_tissue(experiment)._replace(momentum_bandwidth=jnp.exp(point[1]))
    cell = Cell(gains, jnp.asarray(10.0), jax.tree.map(jnp.asarray, robot))
    loop = ArmLoop(chain(), structure_of(experiment.arm, experiment.tissue), accelerate)
    now = ArmSignals(STILL, (STILL,), (0.0,) * 3, ((0.0,), (0.2,), (-0.3,)), (1.0,) * 3, 1.0, 0.0, 0.0)

    def one(carry: Any, _: Any) -> tuple[Any, jax.Array]:
        carry, sample = advance(loop, cell, carry, now, ops)
        return carry, sum((y - wanted[0]) ** 2 for y, wanted in zip(sample.force, now.force_ref, strict=True))

    begin = jax.tree.map(jnp.asarray, start(loop, cell, ops))
    return jnp.mean(jax.lax.scan(one, begin, None, length=steps)[1])


@pytest.mark.oracle
def test_a_gradient_through_it_is_the_central_difference() -> None:
    point, step = jnp.log(jnp.array([900.0, 60.0])), 1e-5
    both = jax.jit(jax.value_and_grad(swung))  # one program
    shifts = step * np.eye(2)
    wanted = np.array([(both(point + each)[0] - both(point - each)[0]) / (2.0 * step) for each in shifts])
    largest = np.abs(wanted).max()
    assert np.abs(wanted[1]) > 1e-3 * largest
    np.testing.assert_allclose(both(point)[1], wanted, rtol=0, atol=1e-4 * largest)


@pytest.mark.oracle
def test_it_lowers_the_residual_of_the_text_design() -> None:
    """Measured 0.78 to 0.90, 0.75 to 0.81 and 0.66 to 0.78 of it at 375, 810 and 1900 N/m; Dahl's 70 % reach less."""
    rms = [
        np.asarray(evaluate(Params(), changed(TABLE, duration=12.0, arm=arm)).metrics.rms)
        for arm in ({}, {"momentum_observer": 100.0})
    ]
    assert (rms[1] < 0.95 * rms[0]).all()
    assert (rms[1][-1] < 0.85 * rms[0][-1]).all()
